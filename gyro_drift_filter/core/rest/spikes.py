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

"""Spikes before the first rest, when nobody knows yet what is noise.

A sample waits until the next one has come. If its rate has jumped and is back, it is a spike:
nothing that has mass turns so. Where the noise is known, outliers are found by it instead.
"""

from typing import Annotated, TypedDict

from gyro_drift_filter.accelerate import PerAxis, kernel, record
from gyro_drift_filter.core.sample import SAMPLE, Sample, smallest_change

# A spike stands out by so many times what is usual: noise alone does in one of 10^7 samples. It
# is more than so many counts, as a coarse sensor at rest shows single ones.
SPIKE_RATIO, SPIKE_COUNTS = 7.0, 3.0
# The rates before and after it lie within this share of it.
LARGEST_STEP = 0.5
# What is usual is a mean over so many samples, of which each counts for so many means at most.
USUAL_SAMPLES, LARGEST_SIZE = 20, 5.0


class Waiting(TypedDict):
    """The last sample, which waits for the next one, and what is usual."""

    sample: Annotated[Sample, SAMPLE, ()]
    waits: bool  # it does so, and is in no value yet
    trusted: bool  # it is no outlier, and its sensor measures
    follows: bool  # it is trusted, and so is the one before it
    before: PerAxis  # rad/s, the sample before it
    usual: PerAxis  # distance of a rate from the middle of its neighbours, rad/s
    seen: int  # samples that are in it, up to `USUAL_SAMPLES`
    spikes: int  # so many, until a second segment of rest has been found
    resolution: PerAxis  # rad/s, the smallest change of a rate; 0 before the first


WAITING = record(Waiting)


@kernel
def forget_waiting(waiting: Waiting) -> None:
    """Let no sample wait any more, nor be a neighbour of the next one."""
    waiting['waits'] = waiting['trusted'] = False


@kernel
def note_next(waiting: Waiting, sample: Sample, trusted: bool, missing: int) -> bool:
    """Note what is usual; return whether the sample shows that the last one is a spike.

    `missing` samples lie between them.
    """
    if not (trusted and waiting['follows'] and missing == 0):
        return False
    spike = False
    known = waiting['seen'] == USUAL_SAMPLES
    if not known:
        waiting['seen'] += 1
    now, rate = sample['angular_velocity'], waiting['sample']['angular_velocity']
    for axis in range(3):
        before, usual = waiting['before'][axis], waiting['usual'][axis]
        size = abs(rate[axis] - 0.5 * (before + now[axis]))
        least = max(SPIKE_RATIO * usual, SPIKE_COUNTS * waiting['resolution'][axis])
        step = abs(now[axis] - before)
        # A device that is not ready has shown one rate so far, of which nothing is usual.
        judged = known and usual > 0.0
        if judged and size > least and step < LARGEST_STEP * size:
            spike = True
        counted = min(size, LARGEST_SIZE * usual) if judged else size
        waiting['usual'][axis] += (counted - usual) / waiting['seen']
    if spike:
        waiting['spikes'] += 1
    return spike


@kernel
def let_wait(waiting: Waiting, sample: Sample, trusted: bool, missing: int) -> None:
    """Let a sample wait for the next one, if that can tell whether it is a spike.

    `missing` samples lie before it.
    """
    follows = waiting['trusted'] and trusted and missing == 0
    for axis in range(3):
        rate, before = sample['angular_velocity'][axis], waiting['sample']['angular_velocity'][axis]
        if follows:
            resolution = waiting['resolution'][axis]
            waiting['resolution'][axis] = smallest_change(resolution, abs(rate - before))
        waiting['before'][axis] = before
    waiting['sample'] = sample
    waiting['follows'] = follows
    waiting['waits'] = follows and waiting['seen'] == USUAL_SAMPLES
    waiting['trusted'] = trusted
