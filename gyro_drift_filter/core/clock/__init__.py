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

"""Time: the sample period learned from the stamps, and how many samples a gap has swallowed.

A filter step stands for one sample period, whatever the stamps say: drivers stamp on arrival, late
by any delay, and deliver in bursts. Samples are taken at even steps, so what the stamps say of them
is their lower envelope: the line of even steps that no stamp lies below. What a stamp lies above it
is its delay.

- A stretch is a hundred stamps or half a second. Its least late stamp is a point of the envelope.
- The period is the slope of the envelope between two such points that are two seconds apart, over
  the last five of these blocks. The filter works with it as it was until it is off by 1 %, as its
  coefficients depend on it.
- A delay of a period is suspicious if it comes with a long step: the errors of many steps, as of a
  driver that sleeps between two readings, add up as well. If the delay is far beyond those of late,
  or most suspicions of late were right, samples are missing and are predicted through. If those
  after it come early by as much, none was missing, and the count is taken back.
- Where samples are missing before each of twenty samples in a row, by steps of one length, the
  driver has changed its rate: that length is the period, and none was missing. So it is where
  more samples have come than the stamps tell time for, behind twenty shorter steps of one length.
- Any other suspicion waits. If all samples after it stay late by a period, some were missing; they
  are counted, but not predicted through, as the filter has followed the samples since.
- While stamps come in bursts a delay means nothing.

Where many samples are missing, delays hide some of them, and the envelope would be longer by their
share. But most stamps agree with one period, however many are missing (`periodogram.py`). Wherever
it says that some are, it is taken for the period, and what a block has lost beyond those found is
counted at its end. In bursts, and if delays are as long as the period, stamps agree with none:
losses and delays can't be told apart then. Across a gap the envelope tells the period.

The bias walks for as long as stamps say, and so for all of a gap. Where they have told less than a
tenth of the time of the samples for five seconds, they stand still or are in another unit, and each
sample takes a period, as without stamps.

Every effect of a stamp is counted:

==================  ==========================================================================
stamp               effect
==================  ==========================================================================
zero                one step; the clock is left alone (the driver does not stamp)
same, same rates    a repeat: no step, the result of the sample before once more
same, new rates     one step (a coarse clock)
backward            into a gap: at its place (`out_of_sequence.py`); else one step, and the clock
                    goes on from there; beyond `gap_limit` a restart
forward             one step, after a prediction for each sample that is missing for sure; beyond
                    `gap_limit` a restart
==================  ==========================================================================

The envelope as a causal fit to delayed stamps: E. Olson, "A Passive Solution to the Sensor
Synchronization Problem", IROS 2010; L. Zhang, Z. Liu, C. H. Xia, "Clock Synchronization Algorithms
for Network Measurements", INFOCOM 2002.

`envelope.py` follows the stamps, `periods.py` learns the period from it, and `periodogram.py` from
the stamps alone; `runs.py` sees that a driver has changed its rate. `delays.py` learns what delays
are usual, and `losses.py` how many samples are missing. `records.py` declares what they share.
"""
