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

"""What the rests of a recording say: noise of the rates, size of gravity."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.identify.blocks import row_medians, runs_of
from gyro_drift_filter.identify.quiet import SampleSpan
from gyro_drift_filter.identify.series import LARGEST_PART, Values, stacked
from gyro_drift_filter.messages.input_rules import CALM, IN_DEGREES, LARGEST_NOISE
from gyro_drift_filter.phrases import plain

# Data sheets allow an accelerometer 3 % of scale and 0.08 g of offset: together it shows gravity to
# a tenth.
_ACCELEROMETER = 0.1
# What accelerometers publish in place of m/s^2: how large gravity is there.
_UNITS = (
    (1.0, 'g', 'multiply by 9.80665'),
    (1000.0, 'thousandths of g', 'multiply by 0.00980665'),
    (100.0 * GRAVITY, 'cm/s^2', 'divide by 100'),
    (1000.0 * GRAVITY, 'mm/s^2', 'divide by 1000'),
)
_UNIT_MARGIN = 0.2
# Where gravity was taken off, nothing is left at rest but the accelerometer's own error.
_NO_GRAVITY = 0.15 * GRAVITY
# Rounded to counts that are three times the deviation of the noise, most values are one count, so
# that up to half a count of the bias is never seen.
_COARSE = 3.0
# The filter finds the end of a rest up to half a second behind it, as motion begins gently.
_END_SECONDS = 0.5
# Noise is the median of the deviations over pieces of a second, so that a knock is none of it.
_PIECE_SECONDS = 1.0
_LEAST_SAMPLES = 20
# Of a piece at least so much has to be numbers.
_LEAST_SHARE = 0.5
_RUN = 100


@dataclass(frozen=True)
class AtRest:
    """What was seen in r rests.

    Attributes:
        stretches: Where they are.
        samples: How many samples they have together.
        noise: (3,) deviation of the rates within a second, in rad/s; NaN without a rest so long.
        forces: (r, 3) mean acceleration in m/s^2.
        force_noise: (3,) as `noise`, of the accelerations in m/s^2.
    """

    stretches: tuple[SampleSpan, ...]
    samples: int
    noise: Floats
    forces: Floats
    force_noise: Floats


def stretches_of(flags: Values, shortened: int) -> tuple[SampleSpan, ...]:
    """Return where flags (n,) are not 0, each shortened at its end by so many samples.

    What is very short then is left out, and what is longer than a part is cut.
    """
    found = []
    for begin in range(0, len(flags), LARGEST_PART):
        part = np.asarray(flags[begin : begin + LARGEST_PART]) != 0
        found += [
            SampleSpan(first, stop - shortened)
            for first, stop in (runs_of(part) + begin).tolist()
            if stop - shortened - first >= _LEAST_SAMPLES
        ]
    return tuple(found)


def look_at_rests(
    resting: Values, rates: tuple[Values, ...], accelerations: tuple[Values, ...], period: float
) -> AtRest:
    """Return what was seen in the rests of a recording.

    Args:
        resting: (n,) not 0 where the filter takes the sensor to rest.
        rates: Three columns (n,) in rad/s.
        accelerations: Three columns (n,) in m/s^2.
        period: Of the samples in s.
    """
    stretches = stretches_of(resting, round(_END_SECONDS / period))
    size = max(round(_PIECE_SECONDS / period), _LEAST_SAMPLES)
    deviations, means = [np.full((1, 6), np.nan)], []
    for stretch in stretches:
        columns = stacked((*rates, *accelerations), slice(stretch.first, stretch.stop))
        # Where a value is missing, the others are as good as with it.
        values = np.ma.masked_invalid(columns)
        means.append(values[:, 3:].mean(axis=0).filled(np.nan))
        pieces = values[: len(values) // size * size].reshape(-1, size, 6)
        is_known = pieces.count(axis=1) > _LEAST_SHARE * size
        deviations.append(np.where(is_known, pieces.std(axis=1, ddof=1).filled(np.nan), np.nan))
    noise = row_medians(np.concatenate(deviations).T)
    forces = np.array(means).reshape(-1, 3)
    return AtRest(stretches, sum(map(len, stretches)), noise[:3], forces, noise[3:])


def judge_unrested_noise(
    rates: tuple[Values, ...], accelerations: tuple[Values, ...]
) -> Finding | None:
    """Say whether it is for its noise in deg/s that no rest was found; None where it is not.

    Most gyroscopes have too much of it for a rest then. Noise is what differs from sample to
    sample, where the accelerometer is calm: no motion is that fast and as calm.

    Rates and accelerations are three columns (n,) each, in rad/s and m/s^2.
    """
    samples = _some((*rates, *accelerations))
    runs = samples[: len(samples) // _RUN * _RUN].reshape(-1, _RUN, 6)
    shaken = runs[:, :, 3:].std(axis=1).max(axis=1)
    calm = (shaken > 0.0) & (shaken < CALM) & np.isfinite(runs).all(axis=(1, 2))
    if not len(runs) or 2 * calm.sum() < len(runs):
        return None
    noise = np.median(np.diff(runs[calm, :, :3], axis=1).std(axis=1), axis=0) / math.sqrt(2.0)
    if noise.min() <= LARGEST_NOISE:
        return None
    return fault(
        'noise in degrees',
        f'the rates have a noise of {noise.min():.2g} rad/s beside a calm accelerometer, too much '
        'for a rest to be found, as in deg/s or mrad/s',
        IN_DEGREES,
        {'noise': noise.tolist()},
    )


def judge_accelerometer(seen: AtRest, accelerations: tuple[Values, ...]) -> Finding:
    """Say whether accelerations, three (n,), show gravity in m/s^2: at rest, or else at all."""
    name = 'accelerometer'
    forces, where = seen.forces, 'at rest'
    if not len(forces):
        forces, where = _some(accelerations), 'over the recording'
    sizes = np.linalg.norm(forces, axis=1)
    sizes = sizes[np.isfinite(sizes)]
    if not len(sizes) or not sizes.any():
        return unknown(
            name,
            'no linear acceleration is reported: signs, axes and units can not be told',
            'publish the accelerometer in the same message; rests are found better with it, too',
        )
    size = float(np.median(sizes))
    values: dict[str, Any] = {'gravity': size, 'gravity_each_rest': sizes.tolist()}
    if size < _NO_GRAVITY and abs(size - 1.0) > _UNIT_MARGIN:
        return fault(
            'gravity',
            f'gravity is missing: {size:.2f} m/s^2 {where}',
            'publish what the accelerometer measures, gravity included (REP-145)',
            values,
        )
    for gravity, unit, remedy in _UNITS:
        if abs(size / gravity - 1.0) < _UNIT_MARGIN:
            return fault(
                'unit of acceleration',
                f'linear acceleration is in {unit}, not in m/s^2: gravity is {size:.4g} {where}',
                f'{remedy} in the driver (REP-103)',
                values,
            )
    if not len(seen.forces) and abs(size / GRAVITY - 1.0) > _UNIT_MARGIN:
        return unknown(
            name,
            f'the accelerations are {plain(size)} m/s^2 on the median, without a rest: a motion '
            'may be as strong, or the scale may be wrong',
            'record the sensor at rest for some seconds, too',
            values,
        )
    worst = float(sizes[np.argmax(np.abs(sizes - GRAVITY))])
    if len(seen.forces) and abs(worst / GRAVITY - 1.0) > _ACCELEROMETER:
        return fault(
            'scale of acceleration',
            f'the accelerometer shows gravity as {sizes.min():.2f} to {sizes.max():.2f} m/s^2 '
            'at rest: off by more than a tenth',
            'calibrate it, or look at the measuring range that the driver converts by',
            values,
        )
    return sound(name, f'gravity is {size:.2f} m/s^2 {where}', values)


def _some(columns: tuple[Values, ...]) -> Floats:
    """Return some ten thousand samples (k, columns), in runs from all over columns (n,)."""
    n = len(columns[0])
    starts = range(0, n, max(n // 100, _RUN))
    return np.concatenate([stacked(columns, slice(k, k + _RUN)) for k in starts])


def judge_resolution(count_size: Floats, seen: AtRest) -> Finding:
    """Say whether counts of this size (3,) in rad/s, 0 where none are seen, are fine enough."""
    name = 'resolution'
    values: dict[str, Any] = {'resolution': count_size.tolist(), 'noise': seen.noise.tolist()}
    if not count_size.any():
        return sound(name, 'the rates have no counts to be seen', values)
    counts = f'a count is {np.degrees(count_size.max()):.3g} deg/s'
    if not np.isfinite(seen.noise).all():
        text = f'{counts}; without a rest of a second its noise is not known'
        return unknown(name, text)
    coarse = [axis for axis in range(3) if count_size[axis] > _COARSE * seen.noise[axis]]
    if coarse:
        return fault(
            name,
            f'counts are coarse: {counts}, more than three times the noise of '
            f'{", ".join(AXES[axis] for axis in coarse)}',
            'choose a smaller measuring range, or take the low-pass or rounding of the driver off: '
            'half a count of the bias stays hidden',
            values,
        )
    return sound(
        name,
        f'{counts}, the noise {np.degrees(seen.noise.max()):.3g} deg/s',
        values=values,
    )
