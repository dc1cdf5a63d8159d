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

"""Scale and misalignment of a gyroscope from recordings in which it was turned and laid down.

Weighted least squares over all that the recordings say, with the figures of data sheets where they
say nothing. What does not fit is trusted less, and told.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.calibrate import CalibrationError
from gyro_drift_filter.calibrate.between_rests import RestsOfOneRecording
from gyro_drift_filter.calibrate.reference import Reference, ReferenceOfOneRecording
from gyro_drift_filter.calibrate.rests import Rests, find_rests
from gyro_drift_filter.calibrate.results import Calibration, make_result, what_is_left_out
from gyro_drift_filter.calibrate.sensitivity import find_sensitivity
from gyro_drift_filter.calibrate.solving import Evidence, solve
from gyro_drift_filter.calibrate.track import make_track
from gyro_drift_filter.gravity import GRAVITY

# No hand turns a sensor faster than this, in rad/s: 2000 deg/s are the end of the usual range.
FASTEST = 35.0
_NO_WHOLE_TURN = (
    '--turns says that the sensor was turned by whole turns, but no two rests that follow each '
    'other are on the same side with a whole turn between them: turn it on the table by one turn '
    'or more, push it back against the same edge and let it rest for four seconds; or leave out '
    '--turns, if it was laid on its sides'
)
GRAVITIES = 7.0, 13.0  # m/s^2: an accelerometer's size of gravity, its faults included


@dataclass(frozen=True)
class Samples:
    """A recording of n samples.

    Attributes:
        stamps: (n,) in ns.
        rates: (n, 3) in rad/s.
        accelerations: (n, 3) in m/s^2; NaN where unknown.
        reference: Orientations from elsewhere, where there are any.
    """

    stamps: Integers
    rates: Floats
    accelerations: Floats
    reference: Reference | None = None


def calibrate(
    recordings: Sequence[Samples],
    *,
    turns: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Calibration:
    """Find the matrix of a gyroscope from recordings of it, each with its own bias.

    Args:
        recordings: One or more.
        turns: Whether full turns by hand led back to the same edge.
        progress: Called with the number of matrices tried, and 0, as their total is not known.

    Raises:
        CalibrationError: They tell nothing of it; the text says what to do.
    """
    all_rests = [
        find_rests(make_track(samples.stamps, samples.rates, samples.accelerations))
        for samples in recordings
    ]
    sensitivity = find_sensitivity(all_rests)
    rests, references = [], []
    for number, (samples, found) in enumerate(zip(recordings, all_rests, strict=True)):
        if found.rests:
            rests.append(RestsOfOneRecording(number, found, sensitivity, turns=turns))
        if samples.reference is not None:
            references.append(
                ReferenceOfOneRecording(number, found.track, samples.reference, found.rate_density)
            )
    evidence = Evidence(rests, references, _up(all_rests))
    _check(all_rests, evidence, turns=turns)
    return make_result(all_rests, evidence, solve(evidence, progress), sensitivity)


def _up(all_rests: Sequence[Rests]) -> Floats | None:
    """Return the mean direction (3,) of gravity at rest."""
    means = [rest.acceleration for found in all_rests for rest in found.rests]
    up = np.mean(means, axis=0) if means else np.full(3, np.nan)
    return np.asarray(up / np.linalg.norm(up)) if np.isfinite(up).all() else None


def _check(all_rests: Sequence[Rests], evidence: Evidence, *, turns: bool) -> None:
    """Look whether there is anything to be found.

    Raises:
        CalibrationError: There is not.
    """
    measured = [found for found in all_rests if found.track.accelerations is not None]
    if not (measured or turns or evidence.references):
        raise CalibrationError(
            'no acceleration in the recording: turns are measured by gravity. Without it, turn the '
            'sensor by whole turns against an edge (--turns), or name a reference (--reference)'
        )
    sizes = [np.linalg.norm(rest.acceleration) for found in measured for rest in found.rests]
    if sizes and not GRAVITIES[0] < np.median(sizes) < GRAVITIES[1]:
        raise CalibrationError(
            f'the acceleration at rest is {np.median(sizes):.3g} where gravity is {GRAVITY:.3g} '
            'm/s^2: is it in another unit? `gyro_drift doctor` tells'
        )
    rates = [leg.fastest for part in evidence.rests for leg in part.legs]
    if rates and np.median(rates) > FASTEST:
        raise CalibrationError(
            f'the sensor turned at {np.median(rates):.0f} rad/s by its rates: are they in deg/s '
            'or mrad/s? `gyro_drift doctor` tells'
        )
    if not (evidence.rests or evidence.references):
        raise CalibrationError(
            'no rest found: lay the sensor down on a table that stands firm, let go of it for four '
            'seconds, turn it onto another side, and so on'
        )
    if why := _why_no_turn(evidence, turns=turns):
        raise CalibrationError('; '.join([why, *what_is_left_out(all_rests, evidence.rests)]))


def _why_no_turn(evidence: Evidence, *, turns: bool) -> str:
    """Return in words which turn is missing: a whole one, if it was to be `turns`, or any."""
    if turns and evidence.rests and not any(part.has_whole_turns for part in evidence.rests):
        return _NO_WHOLE_TURN
    if evidence.has_turns or evidence.references:
        return ''
    if any(part.gaps or part.clipped for part in evidence.rests):
        return 'no turn can be used'
    return (
        'the sensor was not turned: there is one rest only. Lay it down on each of its sides, with '
        'a rest of four seconds on each'
    )
