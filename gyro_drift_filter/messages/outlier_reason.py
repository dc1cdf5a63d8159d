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

from gyro_drift_filter.core.methods import METHOD_NAMES, METHODS
from gyro_drift_filter.core.sample import STARTED, UNUSABLE
from gyro_drift_filter.messages.telemetry import MessageReport, Telemetry

# Of samples that no method has judged.
_NOT_JUDGED = {
    UNUSABLE: 'no usable number',
    STARTED: 'the filter starts here, so nothing was predicted',
}
_TEXTS = {method.name: {**method.reasons, **_NOT_JUDGED} for method in METHODS}
_NAMES = {
    method.name: {
        **{number: getattr(number, 'name', str(number)) for number in method.reasons},
        UNUSABLE: 'UNUSABLE',
        STARTED: 'STARTED',
    }
    for method in METHODS
}
_NONE = 'none so far'


def reason_text(method: str, reason: int) -> str:
    """Return what the `reason` of a result means, by the name of the method that gave it."""
    return _TEXTS[method][reason]


def reason_name(method: str, reason: int) -> str:
    """Return what the code calls the `reason` of a result, by the method that gave it."""
    return _NAMES[method][reason]


def why_flagged(now: MessageReport) -> list[str]:
    """Return why the last outlier of each axis was flagged, of several in a row the first one."""
    state = now.telemetry
    of_axes = zip(state.outliers, state.outlier_method, state.outlier_reason, strict=True)
    return [
        reason_text(METHOD_NAMES[method], reason) if outliers else _NONE
        for outliers, method, reason in of_axes
    ]


def seconds_since_outlier(state: Telemetry) -> list[str]:
    """Return the time in s since the last outlier of each axis, as text."""
    return [
        f'{state.message_period * (state.samples - last):.6g}' if outliers else _NONE
        for outliers, last in zip(state.outliers, state.last_outlier, strict=True)
    ]
