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

"""Whether rates and accelerations are those of one motion.

An accelerometer with other axes than the gyroscope, or one that is late, contradicts it, and what
explains that best is a bias. So gravity shows no bias then, and a warning of `/diagnostics` says
why. But a bias of an earlier run may be what is wrong: motion replaces it once. Where nothing is
known of the bias the normalised innovations of the wide prior tell. Where it is known,
`in_motion.py` adapts to any velocity, and one that no robot has tells.
"""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.in_motion import lose_direction
from gyro_drift_filter.core.bias.records import Bias, is_remembered
from gyro_drift_filter.core.bias.shared import start_motion_bias, start_wide_prior
from gyro_drift_filter.core.bias.shift import forget_shift

# Without a bias: motion in s until anything counts, as a large bias contradicts sound accelerations
# until it has been found.
LEAST_MOTION = 25.0
# They contradict each other once the mean normalised innovation squared is above the first one,
# that of two deviations, until it is below the second one. A velocity lasts, so that it is at most
# some 1 for one body's motion, whatever its bias.
LARGEST_INNOVATION_SQUARE, USUAL_INNOVATION_SQUARE = 4.0, 1.0
# With a bias: once may come of rates that were garbage for a while. So many times are counted in
# motion, and forgotten as `in_motion.py` says.
LEAST_CONTRADICTIONS = 2


@kernel
def note_contradiction(state: Bias) -> None:
    """Note whether rates contradict accelerations, beside a bias that is known.

    Where that begins, and where it ends, what gravity has shown in motion is taken back. A bias of
    an earlier run that motion has replaced is restored.
    """
    motion = state['motion']
    contradicts = motion['contradictions'] >= LEAST_CONTRADICTIONS
    if contradicts == state['contradicts']:
        return
    state['contradicts'] = contradicts
    forget_shift(motion)
    if is_remembered(state) and state['corrected'] > 0:
        state['restored'] = True
        _assume_bias(state)
    _start_motion_bias_anew(state)


@kernel
def note_contradiction_without_bias(state: Bias) -> None:
    """Note whether rates contradict accelerations, where nothing but motion shows the bias.

    What was learned of them is forgotten then, until they agree, as it would go on to contradict
    sound ones, and what motion has shown is taken back.
    """
    wide_prior = state['wide_prior']
    square, enough = wide_prior['innovation_square'], wide_prior['moving_seconds'] >= LEAST_MOTION
    largest = USUAL_INNOVATION_SQUARE if state['contradicts'] else LARGEST_INNOVATION_SQUARE
    if enough and square > largest:
        state['contradicts'] = True
        start_wide_prior(wide_prior, state['assumed_bias'], state['assumed_variance'])
        wide_prior['pending_process_noise'] = state['process_noise']
        lose_direction(wide_prior)
    elif enough and square < USUAL_INNOVATION_SQUARE:
        state['contradicts'] = False
    if state['contradicts']:
        _assume_bias(state)
        _start_motion_bias_anew(state)


@kernel
def _assume_bias(state: Bias) -> None:
    """Go back to the bias that motion has corrected."""
    state['corrected'] = 0
    for axis in range(3):
        state['bias'][axis] = state['assumed_bias'][axis]
        state['variance'][axis] = state['assumed_variance'][axis]


@kernel
def _start_motion_bias_anew(state: Bias) -> None:
    """Begin to follow the bias in motion from that at rest."""
    motion = state['motion']
    start_motion_bias(motion, state['bias'], state['variance'])
    motion['pending_process_noise'] = state['process_noise']
    lose_direction(motion)
