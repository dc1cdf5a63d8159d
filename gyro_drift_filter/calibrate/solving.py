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

"""The likeliest unknowns of a calibration, and how far they are known."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np
from scipy.optimize import least_squares
from scipy.special import chdtri  # of chi-square; scipy.stats takes half a second to load

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.calibrate.between_rests import RestsOfOneRecording
from gyro_drift_filter.calibrate.reference import Mount, ReferenceOfOneRecording
from gyro_drift_filter.calibrate.unknowns import (
    LATE,
    MATRIX,
    TURNED,
    Residuals,
    prior,
    same_frame,
    set_scale,
    start,
)

# Nominal scales that are tried first: so many lie near enough together for half a turn by hand, and
# so many times more of them for three whole turns.
LARGEST_SCALE, TRIALS, FINER = 2.0, 15, 3
# Whole turns close with several scales, of which that nearest to 1 is likeliest: with one that is
# off by a factor of e, turns have to close better by so many rad.
PLAUSIBLE = 0.3
ROUNDS = 12
SETTLED, NEAR = 1e-6, 1e-2  # of entries, rad and s
# A residual beyond what one in a thousand is does not fit.
MISFIT = 0.999
# All errors are taken as larger where the residuals are so large by chance once in a hundred.
UNLIKELY = 0.99


@dataclass(frozen=True)
class Evidence:
    """All that there is.

    Attributes:
        rests: The rests of each recording that has any, and the turns between them.
        references: The reference of each recording that has one.
        up: (3,) the vertical in the sensor's axes, where a reference that never tilts needs it.
    """

    rests: Sequence[RestsOfOneRecording]
    references: Sequence[ReferenceOfOneRecording]
    up: Floats | None

    @property
    def has_turns(self) -> bool:
        """Whether there are turns between rests."""
        return any(part.legs for part in self.rests)


@dataclass(frozen=True)
class Solution:
    """What was found.

    Attributes:
        unknowns: (UNKNOWNS,) the likeliest.
        covariance: (UNKNOWNS, UNKNOWNS) of them.
        mount: How the reference is fixed to the sensor; None without one.
    """

    unknowns: Floats
    covariance: Floats
    mount: Mount | None


def solve(evidence: Evidence, progress: Callable[[int, int], None]) -> Solution:
    """Return the likeliest unknowns; `progress` is told the number of matrices tried, and 0.

    Raises:
        CalibrationError: A reference does not turn as the sensor does.
    """
    unknowns, mount = start(), None
    numbers = count(1)

    def tried() -> None:
        progress(next(numbers), 0)

    if evidence.has_turns:
        _try_scales(evidence.rests, unknowns, tried)
        unknowns = _settle(Evidence(evidence.rests, (), None), unknowns, None, tried)
    if evidence.references:
        guesses = [reference.guess(evidence.up) for reference in evidence.references]
        mount, unknowns[LATE] = Mount(guesses[0].rotation), guesses[0].late
        if not evidence.has_turns:
            scale = float(np.clip(guesses[0].scale, 1.0 / LARGEST_SCALE, LARGEST_SCALE))
            set_scale(unknowns, scale)
        for reference in evidence.references:
            reference.divide(mount, unknowns[LATE])
        unknowns = _settle(evidence, unknowns, mount, tried)
    return Solution(unknowns, _covariance(evidence, unknowns), mount)


def _try_scales(
    rests: Sequence[RestsOfOneRecording], unknowns: Floats, tried: Callable[[], None]
) -> None:
    """Set the nominal scale by which most turns close best."""
    costs = []
    trials = TRIALS * FINER if any(part.turns for part in rests) else TRIALS
    scales = np.geomspace(1.0 / LARGEST_SCALE, LARGEST_SCALE, trials)
    for scale in scales:
        set_scale(unknowns, scale)
        angles = np.concatenate([part.closures(unknowns).angles for part in rests])
        costs.append(np.median(angles) + PLAUSIBLE * abs(np.log(scale)))
        tried()
    set_scale(unknowns, scales[int(np.argmin(costs))])


def _settle(
    evidence: Evidence, unknowns: Floats, mount: Mount | None, tried: Callable[[], None]
) -> Floats:
    """Return the least squares; what does not fit is trusted less from round to round.

    A matrix that vanishes along an axis, as nothing tells of turns about it, moves on for ever.
    """
    step = np.inf
    for _ in range(ROUNDS):
        near = step < NEAR
        if mount is not None:
            mount.turn(unknowns)
            for reference in evidence.references:
                reference.renew(unknowns, near=near)
        residuals = _Residuals(evidence, tried)
        found = least_squares(
            lambda x, both=residuals: both(x).values,
            unknowns,
            jac=lambda x, both=residuals: both(x).jacobian,
            x_scale='jac',
            ftol=1e-6,
            max_nfev=20,
        ).x
        moved = np.abs(found - unknowns)
        step, unknowns = max(moved[MATRIX].max(), moved[TURNED].max(), moved[LATE]), found
        changed = evidence.has_turns and _trust_less(evidence.rests, unknowns)
        if changed:
            continue
        settled = step < SETTLED and (near or mount is None)
        if settled or (mount is None and _vanishes(unknowns)):
            break
    if mount is not None:
        mount.turn(unknowns)
    return np.asarray(unknowns)


def _vanishes(unknowns: Floats) -> bool:
    """Tell whether a matrix is smaller along some axis than that of any sensor."""
    singular = np.linalg.svd(unknowns[MATRIX].reshape(3, 3), compute_uv=False)
    return bool(singular.min() < 1.0 / LARGEST_SCALE)


class _Residuals:
    """All residuals; of the last unknowns they are kept, as values and dependence are asked for."""

    def __init__(self, evidence: Evidence, tried: Callable[[], None]) -> None:
        self._evidence, self._tried = evidence, tried
        self._last: tuple[bytes, Residuals] | None = None

    def __call__(self, unknowns: Floats) -> Residuals:
        key = unknowns.tobytes()
        if self._last is None or self._last[0] != key:
            found = _known(self._evidence, unknowns)
            found += [part.residuals(unknowns) for part in self._evidence.rests]
            found += [part.residuals(unknowns) for part in self._evidence.references]
            values, jacobians = zip(*found, strict=True)
            self._last = key, Residuals(np.concatenate(values), np.vstack(jacobians))
            self._tried()
        return self._last[1]


def _known(evidence: Evidence, unknowns: Floats) -> list[Residuals]:
    """Return what is known beforehand."""
    if evidence.has_turns or any(reference.level for reference in evidence.references):
        return [prior(unknowns)]
    return [prior(unknowns), same_frame(unknowns)]


def _trust_less(parts: Sequence[RestsOfOneRecording], unknowns: Floats) -> bool:
    """Give what does not fit an excess variance; return whether that has changed."""
    misfits = [part.misfits(unknowns) for part in parts]
    squares, variances, counts = (np.concatenate(values) for values in zip(*misfits, strict=True))
    counted = counts > 0
    # By the median, as what does not fit is no measure of what does.
    typical = chdtri(np.maximum(counts, 1), 0.5)
    level = max(1.0, float(np.median((squares / typical)[counted])))
    off = counted & (squares > level * chdtri(np.maximum(counts, 1), 1.0 - MISFIT))
    excess = np.where(off, variances, 0.0)
    changed, first = False, 0
    for part in parts:
        new = excess[first : first + len(part.excess)]
        changed |= bool(((new > 0.0) != (part.excess > 0.0)).any())
        part.excess, first = new, first + len(new)
    return changed


def _covariance(evidence: Evidence, unknowns: Floats) -> Floats:
    """Return the covariance of the unknowns, (UNKNOWNS, UNKNOWNS)."""
    known = sum(r.jacobian.T @ r.jacobian for r in _known(evidence, unknowns))
    for reference in evidence.references:
        jacobian = reference.residuals(unknowns).jacobian
        known = known + jacobian.T @ jacobian
    if not evidence.rests:
        return np.asarray(np.linalg.inv(known))
    residuals = [part.residuals(unknowns) for part in evidence.rests]
    values = np.concatenate([r.values for r in residuals])
    measured = sum(r.jacobian.T @ r.jacobian for r in residuals)
    # What else tells is not fitted to these residuals.
    freedom = len(values) - np.trace(np.linalg.solve(measured + known, measured))
    square, inflation = float(values @ values), 1.0
    if freedom > 0.5 and square > chdtri(freedom, 1.0 - UNLIKELY):
        inflation = square / freedom
    return np.asarray(np.linalg.inv(measured / inflation + known))
