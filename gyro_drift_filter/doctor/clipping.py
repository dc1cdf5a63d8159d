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

"""Whether rates were stopped by the end of the measuring range."""

import numpy as np

from gyro_drift_filter.core.range_end import CLIPPED_SAMPLES
from gyro_drift_filter.identify.blocks import runs_of
from gyro_drift_filter.identify.series import LARGEST_PART, Values


def is_clipped(rates: Values, outliers: Values) -> bool:
    """Tell whether the largest of the rates (n,) is held to the last bit, to either side.

    Nothing is beyond the end of a range, and it is met again and again. The top of a turn may stay
    the same for three samples by chance, but is hardly ever the largest rate of a recording. What a
    damaged message says is no rate: `outliers` (n,) are not 0 where the filter held it back.
    """
    return any(_is_largest_held(rates, outliers, sign) for sign in (1.0, -1.0))


def _is_largest_held(rates: Values, outliers: Values, sign: float) -> bool:
    largest, held = -np.inf, 0
    for first in range(0, len(rates), LARGEST_PART):
        some = slice(first, first + LARGEST_PART)
        part = np.where(outliers[some] > 0, -np.inf, sign * np.nan_to_num(rates[some]))
        top = float(part.max())
        if top < largest or top == -np.inf:
            continue
        run = int(np.ptp(runs_of(part == top), axis=1).max())
        held = run if top > largest else max(held, run)
        largest = top
    return held >= CLIPPED_SAMPLES
