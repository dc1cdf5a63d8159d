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

"""How the sample clock copes with stamps as drivers give them.

    python -m benchmark.clock [--seed N]

A minute each. Rate: as learned, off by. Missing: counted in the end. At once: share of the gaps
that were predicted through with the right number. False: samples before which too many were.
"""

import argparse

import numpy as np

from benchmark.scenarios import bursty_stamps, stamps
from gyro_drift_filter.arrays import Integers
from gyro_drift_filter.core import Filter

SECONDS = 60


def delayed(rate: int, mean: float, random: np.random.Generator) -> Integers:
    """Return stamps of arrival: late by an exponential delay, `mean` in s; none overtakes."""
    n = SECONDS * rate
    delays = random.exponential(mean * 1e9, n).astype(np.int64)
    return np.maximum.accumulate(stamps(n, rate) + delays)


def jittered(rate: int, share: float, random: np.random.Generator) -> Integers:
    """Return stamps that are off by up to a share of the period, early or late."""
    offsets = random.uniform(-share, share, SECONDS * rate)
    return stamps(SECONDS * rate, rate) + np.round(offsets * 1e9 / rate).astype(np.int64)


def main() -> None:
    """Print a line for each kind of stamps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seed', type=int, default=0)
    random = np.random.default_rng(parser.parse_args().seed)
    cases = []
    for rate in (100, 200, 400):
        for mean in (0.7e-3, 1.0e-3, 1.5e-3, 2.0e-3):
            text = f'{rate} Hz, late by {mean * 1e3:g} ms'
            cases.append((text, rate, delayed(rate, mean, random), 0.0))
    cases += [
        ('200 Hz, late by 1.5 ms, 1 in 500 lost', 200, delayed(200, 1.5e-3, random), 0.002),
        ('200 Hz, late by 0.2 ms, 1 in 50 lost', 200, delayed(200, 0.2e-3, random), 0.02),
        ('200 Hz, jitter 10 %, 1 in 50 lost', 200, jittered(200, 0.1, random), 0.02),
        ('200 Hz, jitter 40 %, 1 in 50 lost', 200, jittered(200, 0.4, random), 0.02),
        ('100 Hz, bursts of up to 40', 100, bursty_stamps(SECONDS * 100, 100, random), 0.0),
        ('100 Hz, even, 1 in 10 lost', 100, jittered(100, 0.0, random), 0.1),
        ('100 Hz, late by 0.5 ms, 1 in 10 lost', 100, delayed(100, 0.5e-3, random), 0.1),
        ('200 Hz, late by 1 ms, 1 in 20 lost', 200, delayed(200, 1e-3, random), 0.05),
        ('100 Hz, late by 3 ms, 1 in 10 lost', 100, delayed(100, 3e-3, random), 0.1),
        ('100 Hz, jitter 40 %, 1 in 10 lost', 100, jittered(100, 0.4, random), 0.1),
        ('400 Hz, late by 1.25 ms, 1 in 5 lost', 400, delayed(400, 1.25e-3, random), 0.2),
    ]
    print(f'{"stamps":40s}  rate       missing, of   at once  false')
    for text, rate, all_stamps, share in cases:
        left = np.flatnonzero(random.random(len(all_stamps)) >= share)
        lost = np.diff(left, prepend=-1) - 1
        filter_, found = Filter(), np.zeros(len(left), int)
        clock = filter_.state['clock']
        for i, stamp in enumerate(all_stamps[left]):
            before = int(clock['missing_samples'])
            # No two alike: the same stamp with the same rates is a message that came twice.
            filter_.step(int(stamp), (1e-3 * (i % 2), 0.0, 0.0), (0.0, 0.0, 9.8))
            found[i] = int(clock['missing_samples']) - before
        off = 100.0 * (1.0 / (clock['mean_period'] * rate) - 1.0)
        at_once = (found == lost)[lost > 0].mean() if share > 0.0 else np.nan
        print(
            f'{text:40s}  {off:+.3f} %  {clock["missing_samples"]:6d} {lost.sum():5d}'
            f'  {at_once:7.3f}  {(found > lost).sum():5d}'
        )


if __name__ == '__main__':
    main()
