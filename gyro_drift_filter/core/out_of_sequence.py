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

"""Messages that come after later ones, and what it takes to filter them at their place.

A link without guarantees (UDP, best effort) and nodes with several threads deliver some messages
after the next one. That one comes behind a long step then, as if samples had been lost. So the
state is kept before a sample behind a long step, and so are this sample and the next few. A stamp
between the kept state and the last sample is that of a message that others have overtaken. The
filter then goes back to the kept state and takes all of these samples in again, in the order of
their stamps. So it ends where it had been if they had come in order, to the last bit but for two
counts. What was published for those that came too early stays as it was.

Stamps that scatter by near a period go backward as well, while messages come in the order of the
measurements. They hardly ever go back by as much as half a period; a message that was overtaken is
a whole one behind, give or take the jitter. So where most backward stamps of late were of the first
kind, the order in which messages come is the one to trust.

Tracking filters call this an out-of-sequence measurement. To process again what came since is the
exact way; `robot_localization` does so where `smooth_lagged_data` is set.
"""

from gyro_drift_filter.accelerate import inlined_kernel, kernel
from gyro_drift_filter.core.clock.records import Clock
from gyro_drift_filter.core.records import KEPT_SAMPLES, FilterRecord, History, State
from gyro_drift_filter.core.sample import Sample

# In periods. Where a message is missing, the steps of stamps that are off by up to 40 % of the
# period are no shorter.
STEP_OVER_GAP = 1.2
# In periods: what goes back by less is nearer to the sample before than to the one before that.
STEP_BACK = 0.5
# One number counts backward stamps: up for one that goes back by less, down for another, and no
# further than the second limit, as one in ten of those that scatter goes back by more. From the
# first limit on stamps are taken to scatter: jitter does not bring it there for swapped messages.
SCATTERED, MOST_SCATTERED = 3, 8


@kernel
def note_backward(history: History, clock: Clock, stamp: int, gap_limit: float) -> None:
    """Note by how much a backward stamp (ns) goes back, up to `gap_limit` (s)."""
    back = (clock['stamp'] - stamp) * 1e-9
    if back <= gap_limit:
        change = 1 if back < STEP_BACK * clock['period'] else -1
        history['scattered'] = min(max(history['scattered'] + change, 0), MOST_SCATTERED)


@kernel
def is_overtaken(history: History, stamp: int) -> bool:
    """Return whether a backward stamp (ns) is that of a message that kept ones have overtaken."""
    if not 0 < history['count'] < KEPT_SAMPLES or history['scattered'] >= SCATTERED:
        return False
    return bool(stamp > history['state']['clock']['stamp'])


@inlined_kernel
def keep_sample(history: History, state: State, sample: Sample, gap_limit: float) -> None:
    """Keep what it takes to go back behind a sample, before it is taken in.

    A message fills no gap of more than `gap_limit` s: the filter starts anew behind that.
    """
    clock, count = state['clock'], history['count']
    elapsed = (sample['stamp'] - clock['stamp']) * 1e-9
    if not 0.0 <= elapsed <= gap_limit:
        history['count'] = 0
        return
    # Behind any gap there is room for half of the samples at least.
    if elapsed > STEP_OVER_GAP * clock['period'] and (count == 0 or 2 * count >= KEPT_SAMPLES):
        history['state'] = state
        count = 0
    elif count == 0:
        return
    elif count == KEPT_SAMPLES:
        history['count'] = 0
        return
    history['samples'][count] = sample
    history['count'] = count + 1


@kernel
def insert_sample(history: History, sample: Sample) -> int:
    """Keep a sample that was overtaken; return its place among the kept ones."""
    samples, place = history['samples'], history['count']
    while place > 0 and samples[place - 1]['stamp'] > sample['stamp']:
        samples[place] = samples[place - 1]
        place -= 1
    samples[place] = sample
    history['count'] += 1
    return int(place)


@inlined_kernel
def recall_result(filter_: FilterRecord) -> None:
    """Put the last sample's result back where that of an overtaken one stands in its place."""
    history = filter_['history']
    if history['displaced']:
        filter_['state']['result'] = history['result']
        history['displaced'] = False


@kernel
def forget_history(filter_: FilterRecord) -> None:
    """Never go back behind this moment for a message that was overtaken."""
    recall_result(filter_)
    filter_['history']['count'] = 0


@kernel
def go_back(filter_: FilterRecord) -> None:
    """Put the state back to the kept one, and count a message that was overtaken."""
    clock = filter_['state']['clock']
    backward_stamps, overtaken = clock['backward_stamps'], clock['overtaken']
    filter_['state'] = filter_['history']['state']
    clock['backward_stamps'], clock['overtaken'] = backward_stamps + 1, overtaken + 1
