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

"""What raw values show of a sensor.

All of it is stuck, one axis is frozen or dead, the accelerometer hangs, a rate is at the end of the
range, or units are wrong.
"""

from enum import IntEnum
from typing import Annotated, TypedDict

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, inlined_kernel, kernel
from gyro_drift_filter.core.matrices import cross_product, vector_length
from gyro_drift_filter.core.range_end import RangeEnd, note_range_end
from gyro_drift_filter.core.rest.noise import has_noise_of
from gyro_drift_filter.core.rest.records import Rest
from gyro_drift_filter.core.sample import Sample, are_equal, is_usable, is_zero, smallest_change
from gyro_drift_filter.core.zeros import LivingRates, note_living_rates

# 2,000 deg/s, the range of the fastest common gyroscopes, in rad/s.
RANGE = 35.0

# Ten times gravity, in m/s^2: a knock exceeds it, but no robot is accelerated so for long.
LARGEST_STEADY_ACCELERATION = 98.0

# A sensor whose values all stay the same for so long is stuck, in s: drivers repeat the last ones
# when the bus hangs. From so many equal samples on it says nothing of the bias.
STUCK_SECONDS = 1.0
STUCK_SAMPLES = 20
# A coarse gyroscope at rest does the same. So the noise has to exceed a step, or the body to move:
# another axis turns by so many steps, of which each axis of any gyroscope shows a hundredth, or the
# acceleration changes by so many m/s^2, which no robot does without turning.
CROSS_STEPS = 100.0
LEAST_PUSH = 1.0
# Zeros on all axes so many times in a row are no drop-out of a sample or two.
LONG_ZEROS = 20


class AxisFault(IntEnum):
    """What is wrong with one axis beside others that live."""

    NONE = 0
    FROZEN = 1  # it has measured, and stands still to the last bit
    DEAD = 2  # it has never shown anything else


class Stays(TypedDict):
    """How often the values of three axes have been those of the message before."""

    first: int  # number of the message before those that count
    same: int  # messages with all of them the same
    stayed: CountPerAxis  # messages with this one the same


class SensorChecks(TypedDict):
    """The last values as they came, how often they have come, and what was found."""

    measured: PerAxis  # angular velocity of the last sample, rad/s; NaN before the first
    linear_acceleration: PerAxis  # m/s^2, of the last sample
    equal: CountPerAxis  # how often the rate has come before in a row
    range_end: RangeEnd
    resolution: PerAxis  # smallest change of it, rad/s; 0 before the first
    living: CountPerAxis  # 1 where it has changed at all, else 0
    comes_alive: bool  # an axis does with this sample
    rates: Stays
    accelerations: Stays
    gives_zeros: bool  # all rates have been zero for long: the driver takes slow ones for none
    living_rates: LivingRates
    # all rates have come before for `STUCK_SECONDS`, which a living sensor does not give
    stuck: bool
    equal_accelerations: int  # how often all accelerations have come before in a row
    turned_gravity: PerAxis  # m/s^2, what they would be by now, by how the body has turned
    turned_seconds: float  # within which it has
    accelerometer_hangs: bool  # it shows nothing of that turn
    # while a rate stays the same: all rates when it began to, rad/s, and whether others have moved
    rates_then: Annotated[NDArray[np.float64], np.float64, (3, 3)]
    others_moved: CountPerAxis  # 0 or 1
    # while all of them do
    acceleration_then: PerAxis  # m/s^2
    pushed: bool
    fault: CountPerAxis  # members of AxisFault
    # counts
    beyond_range: int  # samples that no gyroscope measures: degrees, not radians?
    beyond_gravity: int  # samples with an acceleration that no body has for long: counts or mg?
    times_stuck: int
    unusable: CountPerAxis


@kernel
def start_checks(checks: SensorChecks) -> None:
    """Set a zeroed record up."""
    for axis in range(3):
        checks['measured'][axis] = np.nan


@inlined_kernel
def note_values(checks: SensorChecks, sample: Sample, period: float, rest: Rest) -> None:
    """Take the values of a sample in, `period` s after those before."""
    rate, acceleration = sample['angular_velocity'], sample['linear_acceleration']
    checks['comes_alive'] = False
    same_rates = _note_rates(checks, sample, rest)
    _note_accelerations(checks, acceleration)
    for axis in range(3):
        checks['fault'][axis] = AxisFault.NONE
        if checks['equal'][axis] > 0:
            checks['fault'][axis] = _find_fault(checks, axis, rate, period, rest)
    frozen = same_rates and _find_frozen(checks, acceleration, period)
    stuck = frozen or _is_long(_equal_all(checks), period)
    if stuck and not checks['stuck']:
        checks['times_stuck'] += 1
    checks['stuck'] = stuck
    if not (abs(rate[0]) <= RANGE and abs(rate[1]) <= RANGE and abs(rate[2]) <= RANGE):
        _count_unlikely(checks, sample)


@kernel
def _note_accelerations(checks: SensorChecks, acceleration: PerAxis) -> None:
    """Note which accelerations (3,) in m/s^2 are those of the sample before."""
    stays, same, is_beyond = checks['accelerations'], True, False
    for axis in range(3):
        # NaN, for who has no accelerometer, is the same as NaN.
        force, before = acceleration[axis], checks['linear_acceleration'][axis]
        if force != before and (force == force or before == before):
            same = False
        else:
            stays['stayed'][axis] += 1
        checks['linear_acceleration'][axis] = force
        if abs(force) > LARGEST_STEADY_ACCELERATION:
            is_beyond = True
    if is_beyond:
        checks['beyond_gravity'] += 1
    if same:
        stays['same'] += 1
        checks['equal_accelerations'] += 1
    else:
        checks['equal_accelerations'] = 0
        checks['accelerometer_hangs'] = False
        forget_turn(checks)


@kernel
def equal_rates(checks: SensorChecks) -> int:
    """Return how often all rates have come before in a row."""
    equal = checks['equal']
    return int(min(equal[0], equal[1], equal[2]))


@kernel
def _equal_all(checks: SensorChecks) -> int:
    """Return how often all rates and accelerations have come before in a row."""
    return min(equal_rates(checks), int(checks['equal_accelerations']))


@kernel
def are_rates_stale(checks: SensorChecks, fastest: float) -> bool:
    """Return whether rates that have come before are not measured: a bus hangs.

    The accelerations are held as long, or the body turns at `fastest` (rad/s), which a gyroscope
    shows by another count each time. A coarse one gives the same rates in slow motion for long.
    """
    resolution = checks['resolution']
    step = max(resolution[0], resolution[1], resolution[2])
    held = checks['equal_accelerations'] >= equal_rates(checks)
    return bool(held or fastest > CROSS_STEPS * step)


@kernel
def has_fault(checks: SensorChecks) -> bool:
    """Return whether an axis does not measure beside others that do."""
    fault = checks['fault']
    return bool(fault[0] + fault[1] + fault[2] > 0)


@kernel
def may_hang(checks: SensorChecks) -> bool:
    """Return whether the last values may be those of a sensor, or of an axis, that hangs."""
    return bool(_is_frozen(checks) or checks['stuck'] or _equal_all(checks) >= STUCK_SAMPLES)


@kernel
def _is_frozen(checks: SensorChecks) -> bool:
    """Return whether any axis is frozen."""
    fault, frozen = checks['fault'], AxisFault.FROZEN
    return bool(fault[0] == frozen or fault[1] == frozen or fault[2] == frozen)


@kernel
def note_turn(
    checks: SensorChecks, rate: PerAxis, bias: PerAxis, known: bool, seconds: float, period: float
) -> None:
    """Note by how much the body turns within `seconds` at a rate in rad/s, less the bias.

    With the body gravity turns in its axes. An accelerometer hangs if not a bit of it has changed
    for `STUCK_SECONDS`, and gravity should have changed by `LEAST_PUSH`: within `STUCK_SECONDS`
    where the bias is not `known`, as that turns gravity, too. `period` is that of messages, in s.
    """
    if checks['equal_accelerations'] == 0:
        return
    gravity, force = checks['turned_gravity'], checks['linear_acceleration']
    if not known and checks['turned_seconds'] >= STUCK_SECONDS:
        forget_turn(checks)
    checks['turned_seconds'] += seconds
    a = (rate[0] - bias[0]) * seconds
    b = (rate[1] - bias[1]) * seconds
    c = (rate[2] - bias[2]) * seconds
    # Of the turn the first two orders, which are enough for one sample.
    dx, dy, dz = cross_product(gravity[0], gravity[1], gravity[2], a, b, c)
    x, y, z = cross_product(dx, dy, dz, a, b, c)
    gravity[0] += dx + 0.5 * x
    gravity[1] += dy + 0.5 * y
    gravity[2] += dz + 0.5 * z
    if _is_long(checks['equal_accelerations'], period):
        change = vector_length(gravity[0] - force[0], gravity[1] - force[1], gravity[2] - force[2])
        if change > LEAST_PUSH:
            checks['accelerometer_hangs'] = True


@kernel
def forget_turn(checks: SensorChecks) -> None:
    """Forget by how much the body has turned: it stands, or nobody knows."""
    checks['turned_seconds'] = 0.0
    for axis in range(3):
        checks['turned_gravity'][axis] = checks['linear_acceleration'][axis]


@kernel
def measures_exact_rest(checks: SensorChecks, period: float) -> bool:
    """Return whether all is the same for `STUCK_SECONDS`, the rates 0, and gravity there.

    A simulator without noise measures a rest so. A bus that hangs repeats what came last, or gives
    zeros alone.
    """
    stands = is_zero(checks['measured']) and not is_zero(checks['linear_acceleration'])
    return stands and _is_long(_equal_all(checks), period)


@kernel
def _is_long(equal: int, period: float) -> bool:
    return bool(equal >= STUCK_SAMPLES and equal * period >= STUCK_SECONDS)


@kernel
def _find_fault(
    checks: SensorChecks, axis: int, rate: PerAxis, period: float, rest: Rest
) -> AxisFault:
    """Look at an axis whose rate is that of the sample before; return what is wrong with it."""
    equal, then = checks['equal'][axis], checks['rates_then'][axis]
    resolution = checks['resolution']
    if equal == 1:
        checks['others_moved'][axis] = 0
        for other in range(3):
            then[other] = rate[other]
    for other in range(3):
        step = max(resolution[axis], resolution[other])
        if abs(rate[other] - then[other]) > CROSS_STEPS * step:
            checks['others_moved'][axis] = 1
    if not _is_long(equal, period):
        return AxisFault.NONE
    if resolution[axis] > 0.0 and has_noise_of(rest, axis, resolution[axis]):
        return AxisFault.FROZEN
    if checks['others_moved'][axis] == 0:
        return AxisFault.NONE
    return AxisFault.FROZEN if checks['living'][axis] else AxisFault.DEAD


@kernel
def _find_frozen(checks: SensorChecks, acceleration: PerAxis, period: float) -> bool:
    """Look at rates of which all are those before; return whether no living sensor gives them."""
    equal, then = checks['equal'], checks['acceleration_then']
    if equal[0] == 1 or equal[1] == 1 or equal[2] == 1:
        checks['pushed'] = False
        for axis in range(3):
            then[axis] = acceleration[axis]
    for axis in range(3):
        if abs(acceleration[axis] - then[axis]) > LEAST_PUSH:
            checks['pushed'] = True
    is_long = _is_long(equal_rates(checks), period)
    return is_long and bool(_is_frozen(checks) or checks['pushed'])


@kernel
def _note_rates(checks: SensorChecks, sample: Sample, rest: Rest) -> bool:
    """Note the rates; return whether all are those of the sample before."""
    rate, measured, equal = sample['angular_velocity'], checks['measured'], checks['equal']
    same = are_equal(rate, measured)
    stays = checks['rates']
    if same:
        stays['same'] += 1
        lasts = equal_rates(checks) >= LONG_ZEROS
        living = checks['living']
        if is_zero(rate) and lasts and living[0] and living[1] and living[2]:
            checks['gives_zeros'] = True
    else:
        note_living_rates(checks['living_rates'], rate)
    for axis in range(3):
        if rate[axis] == measured[axis]:
            equal[axis] += 1
            stays['stayed'][axis] += 1
        else:
            equal[axis] = 0
        at_limit = False
        if is_usable(rate[axis]):
            change = _note_change(checks, axis, rate[axis])
            at_limit = note_range_end(checks, axis, rate[axis], change, same, rest)
        checks['range_end']['at_limit'][axis] = at_limit
        measured[axis] = rate[axis]
    return same


@kernel
def _note_change(checks: SensorChecks, axis: int, rate: float) -> float:
    """Note by how much a rate has changed, in rad/s, and return it.

    Until an axis has changed at all, its rate itself counts, which is a number of steps, too.
    """
    change: float = rate - checks['measured'][axis]
    if checks['living'][axis] == 0:
        if abs(change) > 0.0:
            checks['living'][axis] = 1
            checks['comes_alive'] = True
        else:
            change = rate
    if is_usable(change):
        checks['resolution'][axis] = smallest_change(checks['resolution'][axis], abs(change))
    return change


@kernel
def _count_unlikely(checks: SensorChecks, sample: Sample) -> None:
    """Count rates of which one is NaN or beyond what gyroscopes measure."""
    rate, beyond = sample['angular_velocity'], False
    for axis in range(3):
        if not is_usable(rate[axis]):
            checks['unusable'][axis] += 1
        if abs(rate[axis]) > RANGE:
            beyond = True
    if beyond:
        checks['beyond_range'] += 1
