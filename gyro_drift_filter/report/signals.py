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

"""The signals of a run, kept sample by sample in temporary files, for figures."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.identify.series import Stored, append_rows, stored_columns
from gyro_drift_filter.messages.imu import are_filtered
from gyro_drift_filter.messages.rules import Rule
from gyro_drift_filter.messages.span import Span
from gyro_drift_filter.report.sample_times import each_sample_seconds, no_sample_times, note_pace
from gyro_drift_filter.report.verdict import RunWatch

# What is kept of each axis.
VECTORS = (
    'raw',  # rad/s, calibrated, NaN where it was no usable number
    'filtered',  # rad/s
    'raw_angle',  # rad, the integral
    'filtered_angle',
    'innovation',  # rad/s
    'innovation_deviation',  # rad/s, as predicted
    'process_noise',  # Q, (rad/s)^2
    'measurement_noise',  # R, (rad/s)^2
    'bias',  # rad/s, as it was subtracted
    'outlier',  # 0 or 1
)
# A second filter over the same recording is compared in these.
COMPARED = ('filtered', 'filtered_angle')


class Signals:
    """Sees what goes through a filter, for the verdict and for figures."""

    def __init__(self, filter_: Filter, names: Sequence[str] = VECTORS) -> None:
        """Start with a filter that has seen nothing yet, and what is to be kept of it."""
        self.filter = filter_
        self.watch = RunWatch(filter_)
        self.log_times = Stored(np.int64)
        self.resting = Stored(np.uint8)
        self.columns = {name: stored_columns(3, np.float32) for name in names}
        # Of the reports: time since the first one in s, and deviation of the bias (3,) in rad/s.
        self.report_times: list[float] = []
        self.bias_deviations: list[Sequence[float]] = []
        self._angles = {'raw': np.zeros(3), 'filtered': np.zeros(3)}
        self._times = no_sample_times()
        self._seconds = 0.0

    def take(self, imus: Any, log_times: Integers) -> None:
        """See messages (n,) IMU that were filtered, with their log times (n,) in ns."""
        self.watch.take(imus, log_times)
        kept = are_filtered(imus)
        if not kept.any():
            return
        sample, result = imus['sample'][kept], imus['result'][kept]
        matrix = np.reshape(self.filter.parameters.calibration_matrix, (3, 3))
        values = {
            'raw': _calibrated(sample['angular_velocity'], matrix),
            'filtered': result['angular_velocity'],
            'innovation': result['innovation'],
            'innovation_deviation': np.sqrt(result['innovation_variance']),
            'process_noise': result['process_noise'],
            'measurement_noise': result['measurement_noise'],
            'bias': result['bias'],
            'outlier': result['outlier'],
        }
        steps = self._steps(sample['stamp'], log_times[kept])[:, None]
        for name, total in self._angles.items():
            turns = np.nan_to_num(values[name]) * steps
            values[f'{name}_angle'] = total + np.cumsum(turns, axis=0)
            total += turns.sum(axis=0)
        self.log_times.append(log_times[kept])
        self.resting.append(result['at_rest'] > 0.0)
        for name, columns in self.columns.items():
            append_rows(columns, values[name])

    def judge(self, span: Span, rules: Sequence[Rule], seconds: float) -> None:
        """See which rules apply to a report, so many s after the one before."""
        self.watch.judge(span, rules, seconds)
        self._seconds += seconds
        self.report_times.append(self._seconds)
        self.bias_deviations.append(span.now.telemetry.bias_deviation)

    def _steps(self, stamps: Integers, log_times: Integers) -> Floats:
        """Return the time in s that each sample stands for."""
        note_pace(self._times, self.filter)
        steps = np.empty(len(stamps))
        each_sample_seconds(
            np.ascontiguousarray(stamps),
            np.ascontiguousarray(log_times, np.int64),
            self._times,
            steps,
        )
        return steps


def _calibrated(rates: Floats, matrix: Floats) -> Floats:
    """Return raw rates (n, 3) by a matrix (3, 3), NaN where one that counts is no usable number."""
    bad = ~(np.abs(rates) <= LARGEST_RATE)
    product = np.where(bad, 0.0, rates) @ matrix.T
    return np.where(bad @ (matrix != 0.0).T, np.nan, product)
