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

"""How much of the motion a filter takes for outliers."""

from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Bools
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.messages.imu import are_filtered

# A bad read, a burst on the bus or a knock is over within so many s, and within so few samples at a
# low rate. What stays away from its prediction for longer is motion. `adaptive` follows it after at
# most `2 * outlier.run + 2` samples, so above 40 Hz nothing is counted of it by default.
_LONGEST_SPIKE, _SPIKE_SAMPLES = 0.2, 3


class HeldBack:
    """Counts the samples in motion that were flagged for longer in a row than spikes last.

    Attributes:
        samples: So many on each axis (3,).
    """

    def __init__(self) -> None:
        """Start before the first sample."""
        self.samples = np.zeros(3, np.int64)
        self._in_a_row = np.zeros(3, np.int64)  # at the end of what was seen

    def take(self, imus: Any, period: float) -> None:
        """See messages (n,) IMU that were filtered, so many s from sample to sample."""
        results, filtered = imus['result'], are_filtered(imus)
        in_motion = filtered & (results['at_rest'] == 0.0)
        flagged = (results['outlier'] > 0.0) & in_motion[:, None]
        if not (flagged.any() or self._in_a_row.any()):
            return
        rates = imus['sample']['angular_velocity']
        is_seen = filtered[:, None] & (np.abs(rates) <= LARGEST_RATE)
        longest = max(_SPIKE_SAMPLES, _LONGEST_SPIKE / period)
        for axis in range(3):
            # A value that is no usable number neither ends a row nor lengthens it.
            self._take_axis(axis, flagged[is_seen[:, axis], axis], longest)

    def _take_axis(self, axis: int, flagged: Bools, longest: float) -> None:
        """See which samples (n,) of an axis were flagged."""
        before = int(self._in_a_row[axis])
        edges = np.flatnonzero(np.diff(flagged, prepend=False, append=False))
        rows = edges[1::2] - edges[::2]
        counted = 0
        if before and len(rows) and edges[0] == 0:
            rows[0] += before
            counted = before if before > longest else 0
        self.samples[axis] += int(rows[rows > longest].sum()) - counted
        if len(flagged):
            self._in_a_row[axis] = rows[-1] if flagged[-1] else 0
