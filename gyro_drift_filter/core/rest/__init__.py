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

"""Where the sensor is at rest, judged against its own noise on all axes at once.

Gyroscope and accelerometer give six signals. Each is averaged over hundredths of a second, "values"
below, so that all sample rates are alike, and cut into blocks of an eighth of a second. Blocks that
are still are gathered into segments of up to two seconds. A block is still where, on every signal,

- the values vary about the block's mean no more than the noise does, and
- the mean lies where those of the segment lie, as far as the noise allows.

The first and the last block of a rest are left out: motion begins and ends gently. Of a segment
that does not hold together the later half is kept: rest may begin with a turn, or where a hand has
just let go, and of a thousand segments of plain rest one or two look like that. Before the noise is
known, this half is the first one of the next segment. After that it counts only if the rest ends
before the next segment is full.

What the noise is on each signal, within blocks and from block to block, is learned from segments
that hold together. The first one may have noise of any spectrum. It is accepted if no mean, of a
rate or of gravity, moves from its first half to its second by more than such means scatter, if the
values vary alike in both halves, and if the means scatter no more than those of a body at rest can.
The means of correlated noise scatter more than its values say, and the limits for blocks and
segments allow for that. A machine that is switched on later makes another noise, which is looked
for beside the one that is known. How much more the means of segments vary than the blocks within
them say, as slow noise makes them, is begun with the correlation of one block and the next, and
learned from one segment to the next.

`detection.py` takes samples in and says where there is rest, `force.py` has the accelerations
without spikes, `spikes.py` finds those of the rates, `segment.py` keeps the sums, `stationarity.py`
judges them, `noise.py` learns the noise from them, `other_noise.py` finds that it is another one by
now, `standing.py` has the mean rate while gravity stands, rest or not, and `records.py` declares
what they share.
"""
