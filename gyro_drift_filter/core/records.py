# Copyright 2026 gyro_drift_filter maintainers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""All that a filter consists of, as one record that kernels take."""

from collections.abc import MutableSequence
from typing import Annotated, TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, record
from gyro_drift_filter.core.bias.motion_filter import MotionWorkspace
from gyro_drift_filter.core.bias.records import Bias
from gyro_drift_filter.core.clock.periodogram import ClockWorkspace
from gyro_drift_filter.core.clock.records import Clock
from gyro_drift_filter.core.methods import MethodCoefficients, MethodStates, MethodWorkspace
from gyro_drift_filter.core.polling import Polling
from gyro_drift_filter.core.quantisation import Quantisation
from gyro_drift_filter.core.rest.records import RestLengths
from gyro_drift_filter.core.sample import SAMPLE, Result, Sample
from gyro_drift_filter.core.sensor_checks import SensorChecks
from gyro_drift_filter.core.settings import SETTINGS, Settings

# Threads and queues exchange neighbours: more than four messages hardly ever overtake one. Twice as
# many samples are kept, as a second gap may follow the one that they are kept from.
KEPT_SAMPLES = 8


class Coefficients(TypedDict):
    """What is derived from the settings and the sample period."""

    period: float  # s, that the others were derived for; 0 before that, and where settings changed
    methods: MethodCoefficients
    rest: RestLengths


class Counts(TypedDict):
    """Counts of samples, and sums over them."""

    samples: int
    duplicates: int  # messages that had come before
    refused: int
    outliers: CountPerAxis
    # up to the last sample, beside those that were not measured (`methods.was_not_measured`)
    outliers_in_a_row: CountPerAxis
    # `Result.reason` of the last outlier, of several in a row that of the first one
    outlier_reason: CountPerAxis
    outlier_method: CountPerAxis  # its number in `METHODS`, as each method has its own reasons
    last_outlier: CountPerAxis  # `samples` when it came
    # Normalised innovation squared of the samples that were accepted: sum and number.
    nis_sum: PerAxis
    nis_samples: CountPerAxis
    # Of the same samples: squared difference between sample and filtered rate, over R.
    residual_sum: PerAxis


COEFFICIENTS = record(Coefficients, in_cache_lines=True)


class State(TypedDict):
    """What the filter has learned: a snapshot holds it, `Filter.reset` leaves a part of `bias`."""

    clock: Clock
    counts: Counts
    checks: SensorChecks
    quantisation: Quantisation
    methods: MethodStates
    linear_acceleration: PerAxis  # the last usable one, m/s^2, where rates are sensitive to it
    taken: PerAxis  # rates as the method took them, of the last sample, rad/s
    coasted: CountPerAxis  # samples in a row without a usable rate
    filtered: PerAxis  # by the method, of the last sample: with the bias in, rad/s
    bias: Bias
    result: Result  # of the last sample
    polling: Polling


STATE = record(State, in_cache_lines=True)


class History(TypedDict):
    """A state that the filter can go back to, and the samples since, in the order of stamps."""

    state: State
    count: int  # of the samples; 0 where there is nothing to go back to
    samples: Annotated[MutableSequence[Sample], SAMPLE, (KEPT_SAMPLES,)]
    scattered: int  # of late, backward stamps by less than half a period, less the others
    displaced: bool  # the result in the filter's state is that of a sample before the last one
    result: Result  # then, of the last one


class Workspace(TypedDict):
    """What is needed within one step, or can be had anew from the state; not in a snapshot."""

    methods: MethodWorkspace
    clock: ClockWorkspace
    motion: MotionWorkspace
    result: Result  # of a sample that was overtaken


HISTORY = record(History, in_cache_lines=True)
WORKSPACE = record(Workspace, in_cache_lines=True)


class FilterRecord(TypedDict):
    """A filter."""

    settings: Annotated[Settings, SETTINGS, ()]
    coefficients: Coefficients
    state: State
    history: History
    workspace: Workspace


FILTER = record(FilterRecord, in_cache_lines=True)
