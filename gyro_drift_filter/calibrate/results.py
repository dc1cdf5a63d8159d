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

"""What a calibration has found, and in words what to know of it."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate import CalibrationError
from gyro_drift_filter.calibrate.between_rests import Closures, RestsOfOneRecording
from gyro_drift_filter.calibrate.exchange import Noise
from gyro_drift_filter.calibrate.rests import LARGEST_TILT, Rests
from gyro_drift_filter.calibrate.sensitivity import AccelerationSensitivity
from gyro_drift_filter.calibrate.solving import Evidence, Solution
from gyro_drift_filter.calibrate.unknowns import (
    LATE,
    MATRIX,
    MISALIGNMENT,
    OFFSET,
    SCALE_DEVIATION,
    TURNED,
    UPPER,
    upper,
)
from gyro_drift_filter.core.parameters import AXES, Parameters
from gyro_drift_filter.errors import ParameterError
from gyro_drift_filter.phrases import plain

# An entry that is known to this only is told: two degrees in a turn.
KNOWN = 0.005
POSES = 'the twelve poses of docs/calibration.md'
# The recordings tell something of an entry where its standard error is below this share of that of
# data sheets: a sensor that is turned on one side of a table alone does not get there.
HARDLY_KNOWN = 0.5
# A sensor that has turned about an axis by less in all, in rad, has not been turned over by it.
TURNED_ABOUT = float(np.pi)
# The turns of a sensor with its axes in order close to this.
OPEN = float(np.radians(10.0))


@dataclass(frozen=True)
class Accelerometer:
    """What was found of the accelerometer on the way: acceleration = matrix (raw - bias).

    Attributes:
        bias: (3,) in m/s^2.
        bias_deviation: (3,) its standard error.
        matrix: (3, 3) upper triangular.
        matrix_deviation: (3, 3) its standard error.
    """

    bias: Floats
    bias_deviation: Floats
    matrix: Floats
    matrix_deviation: Floats


@dataclass(frozen=True)
class ReferenceFit:
    """How the reference relates to the sensor.

    Attributes:
        rotation: (4,) from the axes of the reference's body to those of the sensor, x, y, z, w.
        rotation_deviation: (3,) its standard error about the sensor's axes, in rad.
        late: By how much its stamps are late, in s.
        late_deviation: Its standard error in s.
        noise: Deviation of an orientation in rad.
        level: Whether it never tilts, and was compared about the vertical alone.
    """

    rotation: Floats
    rotation_deviation: Floats
    late: float
    late_deviation: float
    noise: float
    level: bool


@dataclass(frozen=True)
class Calibration:
    """What was found.

    Attributes:
        matrix: (3, 3) for rate = matrix (raw - bias).
        deviation: (3, 3) its standard error.
        covariance: (9, 9) of its entries row by row.
        accelerometer: Its nine numbers; None where there is no acceleration.
        before: How the legs close with the raw rates, the bias off.
        after: How they close with the matrix.
        legs: (n, 3) of each turn between rests, and each span of a reference: index of the
            recording, start and length in s.
        rests: Number of rests.
        sides: Number of orientations of the rests that differ by 20 deg and more.
        rest_seconds: Time at rest in all.
        unknown: In words what is not known well, how far it is, and what to do.
        warnings: What else to know.
        reference: How the reference relates to the sensor; None without one.
        sensitivity: What accelerations add to the rates; None where they are not seen to.
        noise: Of the sensor at rest.
    """

    matrix: Floats
    deviation: Floats
    covariance: Floats
    accelerometer: Accelerometer | None
    before: Closures
    after: Closures
    legs: Floats
    rests: int
    sides: int
    rest_seconds: float
    unknown: tuple[str, ...]
    warnings: tuple[str, ...]
    reference: ReferenceFit | None
    sensitivity: AccelerationSensitivity | None
    noise: Noise


def make_result(
    all_rests: Sequence[Rests],
    evidence: Evidence,
    solution: Solution,
    sensitivity: AccelerationSensitivity,
) -> Calibration:
    """Return the result of a solution.

    Raises:
        CalibrationError: It is no calibration of a gyroscope.
    """
    parts, unknowns = evidence.rests, solution.unknowns
    before, after = (_closures(evidence, x) for x in (_with_identity(unknowns), unknowns))
    matrix = unknowns[MATRIX].reshape(3, 3)
    _check_matrix(matrix, after, evidence, unknowns)
    deviations = np.sqrt(np.diag(solution.covariance))
    deviation = deviations[MATRIX].reshape(3, 3)
    warnings = what_is_wrong(all_rests, parts)
    _check_known_at_all(matrix, deviation, warnings)
    accelerometer = None
    if any(part.measured for part in parts):
        entries = np.zeros((3, 3))
        entries[np.triu_indices(3)] = deviations[UPPER]
        accelerometer = Accelerometer(
            unknowns[OFFSET], deviations[OFFSET], upper(unknowns), entries
        )
    legs = [(leg.track, leg.time, leg.seconds) for part in parts for leg in part.legs]
    for reference in evidence.references:
        legs += [(reference.number, *span) for span in reference.spans]
    rests = [rest for found in all_rests for rest in found.rests]
    return Calibration(
        matrix=matrix,
        deviation=deviation,
        covariance=solution.covariance[MATRIX, MATRIX],
        accelerometer=accelerometer,
        before=before,
        after=after,
        legs=np.array(legs),
        rests=len(rests),
        sides=_sides(parts, unknowns),
        rest_seconds=float(sum(rest.seconds for rest in rests)),
        unknown=tuple(_unknown(deviation, parts, unknowns)),
        warnings=tuple(warnings),
        reference=_fit(evidence, solution, deviations),
        sensitivity=sensitivity if sensitivity.is_found else None,
        noise=_noise(all_rests, parts),
    )


def _closures(evidence: Evidence, unknowns: Floats) -> Closures:
    found = [part.closures(unknowns) for part in evidence.rests]
    found += [reference.closures(unknowns) for reference in evidence.references]
    return Closures(
        np.concatenate([closures.angles for closures in found]),
        np.concatenate([closures.turned for closures in found]),
    )


def _fit(evidence: Evidence, solution: Solution, deviations: Floats) -> ReferenceFit | None:
    if solution.mount is None:
        return None
    return ReferenceFit(
        solution.mount.rotation,
        deviations[TURNED],
        float(solution.unknowns[LATE]),
        float(deviations[LATE]),
        float(np.mean([reference.deviation for reference in evidence.references])),
        any(reference.level for reference in evidence.references),
    )


def _noise(all_rests: Sequence[Rests], parts: Sequence[RestsOfOneRecording]) -> Noise:
    """Return the noise of the noisiest axes; the walk of the bias is rough, as rests are few."""
    rate = np.mean([found.rate_density for found in all_rests], axis=0).max()
    acceleration = np.mean([found.acceleration_density for found in all_rests], axis=0)
    walks = [part.bias_walk for part in parts if part.legs]
    return Noise(
        float(rate**0.5),
        float(np.mean(walks)) ** 0.5 if walks else None,
        float(acceleration.max() ** 0.5) if np.isfinite(acceleration).all() else None,
        1.0 / all_rests[0].track.period,
    )


def _check_matrix(matrix: Floats, after: Closures, evidence: Evidence, unknowns: Floats) -> None:
    why = ''
    try:
        Parameters(calibration_matrix=tuple(matrix.ravel().tolist()))
    except ParameterError as error:
        why = str(error)
    if len(after.angles) and np.median(after.angles) > OPEN:
        why = f'{np.degrees(np.median(after.angles)):.0f} deg are left of each'
    if why:
        end = '' if why.endswith('?') else '.'
        advice = _advice(evidence, unknowns)
        raise CalibrationError(f'no calibration fits the turns: {why}{end} {advice}')


def _advice(evidence: Evidence, unknowns: Floats) -> str:
    """Return what to ask or do where no calibration fits."""
    by_gravity = not (evidence.references or any(part.turns for part in evidence.rests))
    if by_gravity and _sides(evidence.rests, unknowns) == 1:
        return (
            'All rests are on one side, as those of a robot that drives, so gravity tells nothing '
            f'of the turns between them: lay the sensor down in {POSES}'
        )
    return (
        'Has an axis a wrong sign, are axes swapped, or the stamps wrong? `gyro_drift doctor` tells'
    )


def _with_identity(unknowns: Floats) -> Floats:
    out = unknowns.copy()
    out[MATRIX] = np.eye(3).ravel()
    return out


def _sides(parts: Sequence[RestsOfOneRecording], unknowns: Floats) -> int:
    """Return how many orientations are there, that gravity tells apart by 20 deg."""
    sides: list[Floats] = []
    for part in parts:
        for vector in part.gravity(unknowns) if part.measured else ():
            direction = vector / np.linalg.norm(vector)
            if all(direction @ side < np.cos(np.radians(20.0)) for side in sides):
                sides.append(direction)
    return len(sides)


def _check_known_at_all(matrix: Floats, deviation: Floats, warnings: Sequence[str]) -> None:
    scale = float(np.abs(np.linalg.det(matrix)) ** (1.0 / 3.0))
    sheets = np.where(np.eye(3) > 0.0, SCALE_DEVIATION, MISALIGNMENT)
    if (deviation > HARDLY_KNOWN * scale * sheets).all():
        raise CalibrationError(
            'the recording tells too little: no entry is known twice as well as from a data sheet. '
            f'Lay the sensor down in {POSES}' + ''.join(f'; {text}' for text in warnings)
        )


def _unknown(
    deviation: Floats, parts: Sequence[RestsOfOneRecording], unknowns: Floats
) -> list[str]:
    """Return in words what is not known well, by what would tell it."""
    legs = [leg for part in parts for leg in part.legs]
    turned = sum((np.abs(leg.angles.sum(axis=0)) for leg in legs), np.zeros(3))
    left = [angle for part in parts for angle in part.closures(unknowns).angles]
    opened = float(np.median(left)) if left else 0.0
    entries: dict[str, list[str]] = {}
    for column, axis in enumerate(AXES):
        for row in range(3):
            if deviation[row, column] <= KNOWN:
                continue
            if turned[column] < TURNED_ABOUT:
                advice = f'turn it about {axis}, too'
            elif opened > LARGEST_TILT:
                advice = (
                    'lay it on something firm, and let go of it: turns leave '
                    f'{np.degrees(opened):.2g} deg open, as if it was held'
                )
            else:
                advice = f'lay it down in more poses, best in {POSES}'
            known = f'is known to {plain(100.0 * deviation[row, column], 1)} % only'
            entries.setdefault(advice, []).append(f'{name_of_entry(row, column)} {known}')
    return [f'{advice}: {", ".join(known)}' for advice, known in entries.items()]


def name_of_entry(row: int, column: int) -> str:
    """Return in words what an entry of the matrix is."""
    if row == column:
        return f'the scale of {AXES[row]}'
    return f'{AXES[row]} against {AXES[column]}'


def what_is_wrong(all_rests: Sequence[Rests], parts: Sequence[RestsOfOneRecording]) -> list[str]:
    """Return in words what of the recordings could not be used, or not as it is."""
    out = what_is_left_out(all_rests, parts)
    if any(found.track.even for found in all_rests):
        out.append('the stamps are those of arrival: samples are taken as evenly spaced')
    for part in parts:
        legs = zip(part.legs, part.excess[len(part.excess) - len(part.legs) :], strict=True)
        if bad := [leg.time for leg, excess in legs if excess > 0.0]:
            out.append(f'turns that do not fit the others, and count for less: {_times(bad)}')
    return out


def what_is_left_out(all_rests: Sequence[Rests], parts: Sequence[RestsOfOneRecording]) -> list[str]:
    """Return in words which rests and turns could not be used."""
    out = [
        f'the sensor moved in what looked like rest, which is left out: {_times(moved)}'
        for found in all_rests
        if (moved := found.moved)
    ]
    out += [
        f'the clock of the stamps was set back by {by:.2f} s at {when:.1f} s after the start: a '
        'turn across it is left out, and what is behind it counts'
        for found in all_rests
        for when, by in found.track.set_back
    ]
    for part in parts:
        if part.gaps:
            out.append(f'turns with a gap are left out: {_times(part.gaps)}')
        if part.clipped:
            out.append(
                'turns with a rate at the end of its range are left out, so turn it more slowly: '
                + _times(part.clipped)
            )
    return out


def _times(times: Sequence[float]) -> str:
    listed = ', '.join(f'{time:.1f}' for time in times[:6])
    return f'at {listed} s' + (f' and {len(times) - 6} more' if len(times) > 6 else '')
