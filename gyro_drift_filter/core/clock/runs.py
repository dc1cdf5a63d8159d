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

"""Steps of one length in a row, by which a driver has another period than before."""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.clock.losses import EQUALLY_LONG
from gyro_drift_filter.core.clock.periods import LEAST_STAMPED_SHARE
from gyro_drift_filter.core.clock.records import Clock

# So many steps in a row are no losses, as a link does not lose every second sample so evenly, and
# no jitter, which does not bring so many samples before their time.
RUN = 20
# The mean period is off by this share at most, once it is learned: what a driver is late by that
# much is not held up. What is held up for longer than `MOST_OWED` s does not come any more.
LARGEST_DRIFT, MOST_OWED = 0.003, 10.0


@kernel
def note_long_run(clock: Clock, elapsed: float, missing: int) -> float:
    """Note a step in s, with so many samples missing in it; return the driver's new period, or 0.

    The driver has another period in s where samples were found to be missing before each of the
    last ones. They were not, and are no longer counted.
    """
    run, seconds = clock['long_run'], clock['long_run_seconds']
    if missing == 0:
        clock['long_run'] = 0
        return 0.0
    if run == 0 or not _is_as_long(elapsed, run, seconds):
        run, seconds = 0, 0.0
        clock['gaps_before_run'] = clock['gaps'] - 1
        clock['missing_before_run'] = clock['missing_samples'] - missing
    clock['long_run'] = run + 1
    clock['long_run_seconds'] = seconds + elapsed
    if clock['long_run'] < RUN:
        return 0.0
    clock['gaps'] = clock['gaps_before_run']
    clock['missing_samples'] = clock['missing_before_run']
    return float(clock['long_run_seconds'] / RUN)


@kernel
def note_time_owed(clock: Clock, elapsed: float) -> None:
    """Note a step in s: by how much samples are behind the time that the stamps tell.

    Also those that are taken for missing are owed, as they may have been held up.
    """
    owed = clock['owed'] + (1.0 - LARGEST_DRIFT) * elapsed - clock['mean_period']
    clock['owed'] = min(max(owed, 0.0), MOST_OWED)


@kernel
def note_short_run(clock: Clock, elapsed: float) -> float:
    """Note a step in s; return the driver's new period, or 0.

    Stamps may be late, but not early. So the driver has a shorter period in s where more samples
    have come than the stamps tell time for, each of the last ones after a step of one length.
    Stamps that tell next to no time stand still.
    """
    period, run, seconds = clock['mean_period'], clock['short_run'], clock['short_run_seconds']
    short = LEAST_STAMPED_SHARE * period <= elapsed <= (1.0 - EQUALLY_LONG) * period
    if clock['blocks'] == 0 or clock['owed'] > 0.0 or not short:
        clock['short_run'] = 0
        return 0.0
    if run == 0 or not _is_as_long(elapsed, run, seconds):
        run, seconds = 0, 0.0
    clock['short_run'] = run + 1
    clock['short_run_seconds'] = seconds + elapsed
    return float(clock['short_run_seconds'] / RUN) if clock['short_run'] >= RUN else 0.0


@kernel
def _is_as_long(elapsed: float, run: int, seconds: float) -> bool:
    """Return whether a step in s is as long as those of a run, which are so many `seconds`."""
    return abs(elapsed * run - seconds) <= EQUALLY_LONG * seconds
