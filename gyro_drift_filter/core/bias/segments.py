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

"""The last segments of one rest, and whether they lie together where no bias can have come."""

from gyro_drift_filter.accelerate import kernel
from gyro_drift_filter.core.bias.carried_gravity import TiltEvidence, carry_on_with
from gyro_drift_filter.core.bias.records import RECENT, Bias, RestSegment
from gyro_drift_filter.core.bias.shared import keep_shared, restore_shared
from gyro_drift_filter.core.bias.slow_turn import GATE
from gyro_drift_filter.core.gate import is_beyond_gate
from gyro_drift_filter.core.rest.noise import segment_variance
from gyro_drift_filter.core.rest.segment import segment_mean

# A segment is accepted within `GATE` deviations of where the bias can be. Several segments in a
# row, up to `RECENT`, have to lie closer, as they reveal a turn of the bias's size.
RECENT_GATE = 3.0


@kernel
def note_segment(state: Bias) -> None:
    """Put the segment before the others of this rest."""
    recent = state['recent']
    count = min(state['recent_count'], RECENT - 1)
    for i in range(count, 0, -1):
        recent[i] = recent[i - 1]
    state['recent_count'] = count + 1
    last = recent[0]
    for axis in range(3):
        last['mean'][axis] = segment_mean(state['rest'], axis)
        last['noise'][axis] = segment_variance(state['rest'], axis)
        last['bias'][axis] = state['bias'][axis]
        last['variance'][axis] = state['variance'][axis]
    keep_shared(state['motion'], last['in_motion'], state['process_noise'])
    last['process_noise'] = last['largest_process_noise'] = 0.0


@kernel
def unreachable_segments(state: Bias) -> int:
    """Return how many of the last segments have a mean that no bias can have reached, or 0."""
    recent = state['recent']
    for axis in range(3):
        total = noise = 0.0
        process_noise = state['largest_process_noise']
        for i in range(state['recent_count']):
            segment, count = recent[i], i + 1.0
            total += segment['mean'][axis]
            noise += segment['noise'][axis]
            process_noise += segment['largest_process_noise']
            distance = total / count - segment['bias'][axis]
            spread = segment['variance'][axis] + process_noise + noise / (count * count)
            gate = GATE if i == 0 else RECENT_GATE
            if is_beyond_gate(distance, gate, spread):
                return i + 1
    return 0


@kernel
def is_reachable_from_before_tilt(state: Bias) -> bool:
    """Return whether the bias can have come to the segment from before what may be a tilt.

    About the vertical from where it is known now, as a tilt does not turn about that.
    """
    rest, before = state['rest'], state['before_tilt']
    if not state['carried']['undecided']:
        return False
    process_noise = state['largest_process_noise']
    process_noise_since = process_noise + before['largest_process_noise']
    along = along_variance = 0.0
    for axis in range(3):
        mean, noise = segment_mean(rest, axis), segment_variance(rest, axis)
        variance = before['variance'][axis] + process_noise_since + noise
        if is_beyond_gate(mean - before['bias'][axis], GATE, variance):
            return False
        gravity = segment_mean(rest, 3 + axis)
        along += gravity * (mean - state['bias'][axis])
        along_variance += gravity * gravity * (state['variance'][axis] + process_noise + noise)
    return not is_beyond_gate(along, GATE, along_variance)


@kernel
def take_back(state: Bias, count: int) -> None:
    """Unlearn the last `count` segments."""
    if count == 1:
        state['recent_count'] = 0
        return
    state['carried']['undecided'] = False
    recent = state['recent']
    before = recent[count - 1]
    for i in range(count):
        segment = recent[i]
        state['process_noise'] += segment['process_noise']
        state['largest_process_noise'] += segment['largest_process_noise']
        segment['process_noise'] = segment['largest_process_noise'] = 0.0
        for axis in range(3):
            segment['bias'][axis] = before['bias'][axis]
            segment['variance'][axis] = before['variance'][axis]
    _restore(state, before)
    for i in range(count):
        keep_shared(state['motion'], recent[i]['in_motion'], state['process_noise'])


@kernel
def note_accepted(state: Bias) -> None:
    """Note what gravity says of a segment that was learned: a tilt may yet show, or it is none."""
    carried, last, before = state['carried'], state['recent'][0], state['before_tilt']
    evidence = carried['evidence']
    if evidence == TiltEvidence.STANDS or evidence == TiltEvidence.TOO_SLOW:
        carried['undecided'] = False
        carry_on_with(carried, state['bias'])
        return
    if carried['undecided']:
        before['process_noise'] += last['process_noise']
        before['largest_process_noise'] += last['largest_process_noise']
    elif evidence == TiltEvidence.UNDECIDED:
        state['before_tilt'] = last
        carried['undecided'] = True
        carried['undecided_seconds'] = 0.0
    if evidence == TiltEvidence.UNDECIDED:
        for axis in range(3):
            carried['undecided_rate'][axis] = last['mean'][axis]


@kernel
def take_back_tilt(state: Bias) -> None:
    """Unlearn what may be of a tilt."""
    before = state['before_tilt']
    state['process_noise'] += before['process_noise']
    state['largest_process_noise'] += before['largest_process_noise']
    _restore(state, before)
    state['recent_count'] = 0
    state['carried']['undecided'] = False


@kernel
def _restore(state: Bias, before: RestSegment) -> None:
    """Put the bias back to where it was before a segment; its process noise has been added up."""
    for axis in range(3):
        state['bias'][axis] = before['bias'][axis]
        state['variance'][axis] = before['variance'][axis]
    restore_shared(state['motion'], before['in_motion'], state['process_noise'])
