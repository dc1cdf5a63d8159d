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

"""Whether the driver sends the values of the sample before once more now and then.

What the filter counts are rates that repeat where noise or motion forbid it. Here it is all six
values, over the whole recording, beside how often they meet by chance: as often as with the sample
before they then meet with the one before that.
"""

import math
from typing import Any

import numpy as np

from gyro_drift_filter.doctor.findings import Finding, Verdict
from gyro_drift_filter.identify.series import LARGEST_PART, Values

# Chance gives a count its root; beyond so many of them, and so many, it was not chance.
_DEVIATIONS, _LEAST = 5.0, 5.0


def judge_repeats(rates: tuple[Values, ...], accelerations: tuple[Values, ...]) -> Finding:
    """Say whether samples of rates and accelerations, three columns (n,) each, are repeated."""
    n, repeated, runs, chance = len(rates[0]), 0, 0, 0
    for first in range(0, n, LARGEST_PART):
        ahead = min(first, 2)
        part = slice(first - ahead, first + LARGEST_PART)
        values = np.column_stack([column[part] for column in (*rates, *accelerations)])
        values = np.nan_to_num(values)
        same, before, between = np.zeros((3, len(values)), np.bool_)
        same[1:] = (values[1:] == values[:-1]).all(axis=1)
        before[1:] = same[:-1]
        between[2:] = (values[2:] == values[:-2]).all(axis=1)
        repeated += int(same[ahead:].sum())
        runs += int((same & ~before)[ahead:].sum())
        chance += int((between & ~same & ~before)[ahead:].sum())
    found: dict[str, Any] = {'repeated': repeated, 'times': runs, 'by_chance': chance}
    if repeated <= chance + _LEAST + _DEVIATIONS * math.sqrt(chance):
        return Finding('repeats', Verdict.SOUND, 'no sample is repeated', values=found)
    return Finding(
        'repeats',
        Verdict.FAULT,
        f'all six values are those of the sample before in {repeated} samples '
        f'({100.0 * repeated / n:.3g} %), {runs} times',
        'the bus or the driver hangs, or polls faster than the sensor measures: poll on its '
        'data-ready signal, and do not publish the same sample twice',
        found,
    )
