"""Scale and misalignment of a gyroscope from recordings in which it was turned and laid down.

Weighted least squares over all that the recordings say, with the figures of data
sheets where they say nothing. What does not fit is trusted less, and told.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2

from gyro_drift_filter.calibrate.between_rests import Closures, RestsOfOneRecording, Session
from gyro_drift_filter.calibrate.errors import CalibrationError
from gyro_drift_filter.calibrate.rests import GRAVITY, find_rests, make_track
from gyro_drift_filter.calibrate.unknowns import (
    MATRIX,
    OFFSET,
    SCALE,
    UPPER,
    Residuals,
    prior,
    start,
    upper,
)
from gyro_drift_filter.core.parameters import AXES, Parameters
from gyro_drift_filter.errors import ParameterError

Floats = NDArray[np.float64]

# Nominal scales that are tried first: a turn by hand of a quarter tells those apart.
SCALES = np.geomspace(0.5, 2.0, 15)
ROUNDS = 12
# A residual beyond what one in a thousand is does not fit.
MISFIT = 0.999
# All errors are taken as larger where the residuals are so large by chance once in a hundred.
UNLIKELY = 0.99
# An entry that is known to this only is told: two degrees in a turn.
KNOWN = 0.005
# No hand turns a sensor faster than this, in rad/s: 2000 deg/s are the end of the usual range.
FASTEST = 35.0
# The turns of a sensor with its axes in order close to this.
OPEN = float(np.radians(10.0))
GRAVITIES = 7.0, 13.0  # m/s^2: an accelerometer's size of gravity, its faults included


@dataclass(frozen=True)
class Samples:
    """A recording of n samples.

    Attributes:
        stamps: (n,) in ns.
        rates: (n, 3) in rad/s.
        accelerations: (n, 3) in m/s^2; NaN where unknown.
    """

    stamps: NDArray[np.int64]
    rates: Floats
    accelerations: Floats


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
class Calibration:
    """What was found.

    Attributes:
        matrix: (3, 3) for rate = matrix (raw - bias).
        deviation: (3, 3) its standard error.
        covariance: (9, 9) of its entries row by row.
        accelerometer: Its nine numbers; None where there is no acceleration.
        before: How the legs close with the raw rates, the bias off.
        after: How they close with the matrix.
        legs: (n, 3) of each leg: index of the recording, start and length in s.
        rests: Number of rests.
        sides: Number of orientations of the rests that differ by 20 deg and more.
        rest_seconds: Time at rest in all.
        unknown: In words what was not excited, and how far it is known.
        warnings: What else to know.
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


def calibrate(recordings: Sequence[Samples], *, turns: bool = False) -> Calibration:
    """Find the matrix of a gyroscope from recordings of it, each with its own bias.

    Args:
        recordings: One or more.
        turns: Whether full turns by hand led back to the same edge.

    Raises:
        CalibrationError: They tell nothing of it; the text says what to do.
    """
    sessions = []
    for samples in recordings:
        track = make_track(samples.stamps, samples.rates, samples.accelerations)
        sessions.append(Session(track, find_rests(track)))
    parts = [RestsOfOneRecording(k, session, turns) for k, session in enumerate(sessions)]
    _check_sessions(sessions, parts, turns)
    unknowns = _solve(parts)
    covariance = _covariance(parts, unknowns)
    return _result(sessions, parts, unknowns, covariance)


def _check_sessions(
    sessions: Sequence[Session], parts: Sequence[RestsOfOneRecording], turns: bool
) -> None:
    measured = [session for session in sessions if session.track.accelerations is not None]
    if not measured and not turns:
        raise CalibrationError(
            'no acceleration in the recording: turns are measured by gravity. Without it, turn the '
            'sensor by whole turns against an edge (--turns), or name a reference (--reference)'
        )
    sizes = [
        np.linalg.norm(rest.acceleration) for session in measured for rest in session.rests.rests
    ]
    if sizes and not GRAVITIES[0] < np.median(sizes) < GRAVITIES[1]:
        raise CalibrationError(
            f'the acceleration at rest is {np.median(sizes):.3g} where gravity is {GRAVITY:.3g} '
            'm/s^2: is it in another unit?'
        )
    rates = [np.linalg.norm(leg.raw, axis=1).max() for part in parts for leg in part.legs]
    if rates and np.median(rates) > FASTEST:
        raise CalibrationError(
            f'the sensor turned at {np.median(rates):.0f} rad/s by its rates: are they in deg/s?'
        )
    if not any(part.legs for part in parts):
        raise CalibrationError(
            'the sensor was not turned: there is one rest only. Lay it down on each of its sides, '
            'with a rest of 3 s on each'
        )


def _solve(parts: Sequence[RestsOfOneRecording]) -> Floats:
    """Return the likeliest unknowns; what does not fit gets an excess variance in its part."""
    unknowns = start()
    costs = []
    for scale in SCALES:
        trial = unknowns.copy()
        trial[MATRIX], trial[SCALE] = scale * np.eye(3).ravel(), scale
        # The size of the error of most legs, whatever some do.
        angles = np.concatenate([part.closures(trial).angles for part in parts])
        costs.append(np.median(angles) + 1e-3 * abs(np.log(scale)))
    scale = SCALES[int(np.argmin(costs))]
    unknowns[MATRIX], unknowns[SCALE] = scale * np.eye(3).ravel(), scale
    for _ in range(ROUNDS):
        # The covariance of the residuals depends on the unknowns weakly: it is held, then renewed.
        both = _Residuals(parts)
        found = least_squares(
            lambda x, both=both: both(x).values,
            unknowns,
            jac=lambda x, both=both: both(x).jacobian,
            x_scale='jac',
            ftol=1e-6,
            max_nfev=20,
        ).x
        step = np.abs(found[MATRIX] - unknowns[MATRIX]).max()
        unknowns = found
        if not _trust_less(parts, unknowns) and step < 1e-6:
            break
    return np.asarray(unknowns)


class _Residuals:
    """All residuals; of the last unknowns they are kept, as values and dependence are asked for."""

    def __init__(self, parts: Sequence[RestsOfOneRecording]) -> None:
        self._parts = parts
        self._last: tuple[bytes, Residuals] | None = None

    def __call__(self, unknowns: Floats) -> Residuals:
        key = unknowns.tobytes()
        if self._last is None or self._last[0] != key:
            found = [prior(unknowns), *(part.residuals(unknowns) for part in self._parts)]
            values, jacobians = zip(*found, strict=True)
            self._last = key, Residuals(np.concatenate(values), np.vstack(jacobians))
        return self._last[1]


def _trust_less(parts: Sequence[RestsOfOneRecording], unknowns: Floats) -> bool:
    """Give what does not fit an excess variance; return whether that has changed much."""
    misfits = [part.misfits(unknowns) for part in parts]
    squares, variances, counts = (np.concatenate(values) for values in zip(*misfits, strict=True))
    counted = counts > 0
    # By the median, as what does not fit is no measure of what does.
    typical = chi2.median(np.maximum(counts, 1))
    level = max(1.0, float(np.median((squares / typical)[counted])))
    off = counted & (squares > level * chi2.ppf(MISFIT, np.maximum(counts, 1)))
    excess = np.where(off, variances, 0.0)
    changed, first = False, 0
    for part in parts:
        new = excess[first : first + len(part.excess)]
        changed |= bool(((new > 0.0) != (part.excess > 0.0)).any())
        part.excess, first = new, first + len(new)
    return changed


def _covariance(parts: Sequence[RestsOfOneRecording], unknowns: Floats) -> Floats:
    """Return the covariance of the unknowns, (UNKNOWNS, UNKNOWNS)."""
    residuals = [part.residuals(unknowns) for part in parts]
    values = np.concatenate([r.values for r in residuals])
    measured = sum(r.jacobian.T @ r.jacobian for r in residuals)
    known = prior(unknowns).jacobian
    information = measured + known.T @ known
    # What the prior alone tells is not fitted to the residuals.
    fitted = np.trace(np.linalg.solve(information, measured))
    freedom = len(values) - fitted
    square, inflation = float(values @ values), 1.0
    if freedom > 0.5 and square > chi2.ppf(UNLIKELY, freedom):
        inflation = square / freedom
    return np.asarray(np.linalg.inv(measured / inflation + known.T @ known))


def _result(
    sessions: Sequence[Session],
    parts: Sequence[RestsOfOneRecording],
    unknowns: Floats,
    covariance: Floats,
) -> Calibration:
    closures = []
    for x in (_with_identity(unknowns), unknowns):
        of_parts = [part.closures(x) for part in parts]
        closures.append(
            Closures(
                np.concatenate([c.angles for c in of_parts]),
                np.concatenate([c.turned for c in of_parts]),
            )
        )
    before, after = closures
    matrix = unknowns[MATRIX].reshape(3, 3)
    _check_matrix(matrix, after)
    deviations = np.sqrt(np.diag(covariance))
    deviation = deviations[MATRIX].reshape(3, 3)
    accelerometer = None
    if any(part.measured for part in parts):
        entries = np.zeros((3, 3))
        entries[np.triu_indices(3)] = deviations[UPPER]
        accelerometer = Accelerometer(
            unknowns[OFFSET], deviations[OFFSET], upper(unknowns), entries
        )
    legs = [leg for part in parts for leg in part.legs]
    rests = [rest for session in sessions for rest in session.rests.rests]
    return Calibration(
        matrix,
        deviation,
        covariance[MATRIX, MATRIX],
        accelerometer,
        before,
        after,
        np.array([[leg.track, leg.time, leg.seconds] for leg in legs]),
        len(rests),
        _sides(parts, unknowns),
        float(sum(rest.seconds for rest in rests)),
        tuple(_unknown(deviation)),
        tuple(_warnings(sessions, parts)),
    )


def _check_matrix(matrix: Floats, after: Closures) -> None:
    why = ''
    try:
        Parameters(calibration_matrix=tuple(matrix.ravel().tolist()))
    except ParameterError as error:
        why = str(error)
    if len(after.angles) and np.median(after.angles) > OPEN:
        why = f'{np.degrees(np.median(after.angles)):.0f} deg are left of each'
    if why:
        raise CalibrationError(
            f'no calibration makes the turns close: {why}. Has an axis a wrong sign, are axes '
            'swapped, or the stamps wrong?'
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


def _unknown(deviation: Floats) -> list[str]:
    """Return in words what was not excited: by the axis that it has to be turned about."""
    out = []
    for column, turned in enumerate(AXES):
        parts = [
            f'{"the scale of " + turned if row == column else f"{AXES[row]} against {turned}"} is '
            f'known to {100.0 * deviation[row, column]:.1g} % only'
            for row in range(3)
            if deviation[row, column] > KNOWN
        ]
        if parts:
            out.append(f'turn it about {turned}, too: {", ".join(parts)}')
    return out


def _warnings(sessions: Sequence[Session], parts: Sequence[RestsOfOneRecording]) -> list[str]:
    out = []
    for session, part in zip(sessions, parts, strict=True):
        if session.rests.moved:
            out.append(
                'the sensor moved in what looked like rest, which is left out: '
                + _times(session.rests.moved)
            )
        if part.broken:
            out.append(
                'turns with a gap or a rate at the end of its range are left out: '
                + _times(part.broken)
            )
        if session.track.even:
            out.append('the stamps are those of arrival: samples are taken as evenly spaced')
        bad = (
            [
                leg.time
                for leg, excess in zip(part.legs, part.excess[-len(part.legs) :], strict=True)
                if excess > 0.0
            ]
            if part.legs
            else []
        )
        if bad:
            out.append(f'turns that do not fit the others, and count for less: {_times(bad)}')
    return out


def _times(times: Sequence[float]) -> str:
    listed = ', '.join(f'{time:.1f}' for time in times[:6])
    return f'at {listed} s' + (f' and {len(times) - 6} more' if len(times) > 6 else '')
