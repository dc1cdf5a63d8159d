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

"""What a filter did with the Imu topic of a recording, once the recording has ended."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.messages.diagnostics import DiagnosticStatus


@dataclass(frozen=True)
class Summary:
    """What a filter did with an Imu topic.

    Attributes:
        topic: The input topic.
        output_topic: The filtered topic.
        received: Imu messages read.
        written: Messages written to the filtered topic.
        not_reported: Messages without angular velocity, passed on as they came.
        left_out: Topics of the input that were not copied, and why.
        outliers: Samples flagged, per axis (3,).
        unusable: Samples without a usable rate, per axis (3,).
        period: Sample period at the end in s, as the filter has it: where stamps tell none, the one
            that it was given or assumes.
        bias_deviation: Standard deviation of the bias at the end (3,) in rad/s, as `/diagnostics`
            tells it: with its wander, and with what rounding may leave in the mean of a rest.
        status: The filter's health over the whole bag.
        start: Log time of the first message of the recording in ns.
        seconds: From then to its last message.
    """

    topic: str
    output_topic: str
    received: int
    written: int
    not_reported: int
    left_out: dict[str, str]
    outliers: NDArray[np.int64]
    unusable: NDArray[np.int64]
    period: float
    bias_deviation: NDArray[np.float64]
    status: list[DiagnosticStatus]
    start: int
    seconds: float
