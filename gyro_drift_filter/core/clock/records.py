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

"""What the clock knows: the sample period, the envelope of the stamps, delays and losses."""

from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import record

BLOCKS = 5
# Stamps that are kept: so many show the period although they are late by half of it on the mean.
STAMPS = 512

BlockPeriods = Annotated[NDArray[np.float64], np.float64, (BLOCKS,)]


class Clock(TypedDict):
    """The sample period, and where in time the filter stands.

    The envelope is a line of even steps of `mean_period` that starts at the point where the block
    did. `lateness` is measured from it, and steps are counted from there, missing samples among
    them.
    """

    period: float  # s, that the filter works with: `mean_period` but for small changes
    mean_period: float  # s
    mean_rate: float  # Hz, 1 / mean_period
    stamp: int  # ns, of the last stamped sample
    started: bool
    unstamped: float  # s, by which stamps tell less than LEAST_STAMPED_SHARE of the samples' time
    irregularity: float  # mean |step - period| / period
    irregularity_steps: int  # that it is the mean of, up to a limit
    burst_step: float  # s, mean of the steps over which samples may be missing; 0 before one
    burst_deviation: float  # mean deviation from it, relative to it
    lateness: float  # s, of the last stamp
    earliest: float  # s, the least lateness of this stretch and the one before
    # the stretch
    stretch_samples: int
    stretch_length: int  # samples that it takes at least
    stretch_end: int  # ns: it ends at a stamp from here on, or with STRETCH_SAMPLES
    stretch_least_lateness: float  # s
    least_steps: int  # where it was
    least_missing: int
    least_gap_steps: float
    stretch_longest_delay: float  # s, of those that are not suspicious or were made up for
    stretch_delay_sum: float  # s, of those that are not suspicious
    # the block
    anchored: bool  # whether it starts at a point of the envelope, not at any sample
    steps: int
    missing: int
    long_steps: int
    gap_steps: float  # s, by which the steps over gaps were longer than the period
    block_periods: BlockPeriods  # s
    blocks: int
    # the last stamps since the envelope was started anew
    stamps: Annotated[NDArray[np.int64], np.int64, (STAMPS,)]  # ns, the oldest one is overwritten
    kept: int  # stamps so far, those that were overwritten among them
    # delays
    mean_delay: float  # s
    longest_delay: float  # s, of late
    suspicious: float  # s: beyond it samples may be missing
    delay_limit: float  # s: beyond it they are
    lost_share: float  # of late, of the suspicions that were right
    # the suspicion
    verdict_samples: int  # until the verdict, 0 where there is no suspicion
    suspect_samples: int  # since the last step that raised it
    suspect_delay: float  # s, with that of the missing samples
    suspect_step: float  # s, by which the step was longer than the period
    suspect_least: float  # s, the least delay since
    suspect_missing: int  # samples that were counted at once
    suspect_gaps: int
    # the steps in a row that are equally long, each over missing samples
    long_run: int
    long_run_seconds: float  # s, of all of them
    gaps_before_run: int  # as counted before the first of them
    missing_before_run: int
    owed: float  # s, by which samples are behind the time that stamps tell
    # the steps in a row that are equally long, and too short by the period
    short_run: int
    short_run_seconds: float  # s, of all of them
    # counts
    gaps: int
    missing_samples: int
    restarts: int
    zero_stamps: int
    same_stamps: int
    backward_stamps: int
    overtaken: int  # of these, those of messages that were filtered at their place


CLOCK = record(Clock)
