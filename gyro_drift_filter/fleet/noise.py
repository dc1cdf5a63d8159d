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

"""What the rests of a recording say of the noise, where they are long enough for it."""

from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.allan import Allan, allan_deviation
from gyro_drift_filter.identify.preprocess import Preprocessed, preprocess
from gyro_drift_filter.identify.quiet import SHORTEST_QUIET, find_quiet
from gyro_drift_filter.identify.series import Values
from gyro_drift_filter.identify.timing import learn_timing


@dataclass(frozen=True)
class AxisNoise:
    """Of one axis: its Allan deviation, and in rad/s^2 the mean slope of its bias."""

    allan: Allan
    trend: float


def identify_noise(
    stamps: Integers,
    rates: tuple[Values, ...],
    accelerations: tuple[Values, ...],
    log_times: Values | None = None,
) -> tuple[AxisNoise | None, ...]:
    """Return what is known of each axis: as `identify` does, without the models that it fits.

    Args:
        stamps: (n,) in ns.
        rates: Three columns (n,) in rad/s.
        accelerations: Three columns (n,) in m/s^2.
        log_times: (n,) in ns, which tell where the clock of the stamps was set.
    """
    nothing = (None, None, None)
    try:
        timing = learn_timing(stamps, log_times)
        spans = find_quiet(timing, rates, accelerations).spans
    except IdentificationError:
        return nothing
    if sum(map(len, spans)) * timing.period < SHORTEST_QUIET:
        return nothing
    begins = [timing.seconds_at(stamps, span.first) for span in spans]
    ends = [begin + len(span) * timing.period for begin, span in zip(begins, spans, strict=True)]
    found: list[AxisNoise | None] = []
    for rate in rates:
        try:
            clean = preprocess(rate, spans, timing.period, begins)
            allan = allan_deviation(clean.cleaned, timing.period)
            found.append(AxisNoise(allan, _mean_slope(clean, begins[0], ends[-1])))
        except IdentificationError:
            found.append(None)
    return tuple(found)


def _mean_slope(clean: Preprocessed, begin: float, end: float) -> float:
    """Return by how much the bias changes from the first rest to the last one, over their time."""
    powers = np.arange(1, len(clean.trend) + 1)
    at: Floats = np.array([begin, end])[:, None] - clean.trend_centre
    values = (np.array(clean.trend) * at**powers).sum(axis=1)
    return float((values[1] - values[0]) / (end - begin))
