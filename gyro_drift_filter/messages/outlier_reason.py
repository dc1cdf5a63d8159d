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


"""Why a sample was accepted or flagged as an outlier, in words."""

from gyro_drift_filter.core.methods import METHODS
from gyro_drift_filter.core.sample import UNUSABLE
from gyro_drift_filter.messages.telemetry import MessageReport

_TEXTS = {method.name: {**method.reasons, UNUSABLE: 'no usable number'} for method in METHODS}


def reason_text(method: str, reason: int) -> str:
    """Return what the `reason` of a result means, by the name of the method."""
    return _TEXTS[method].get(reason, 'another method flagged it')


def why_flagged(now: MessageReport) -> list[str]:
    """Return why the last outlier of each axis was flagged, of several in a row the first one."""
    state = now.telemetry
    return [
        reason_text(now.parameters.method, reason) if outliers else 'none so far'
        for outliers, reason in zip(state.outliers, state.outlier_reason, strict=True)
    ]
