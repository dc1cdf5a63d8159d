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

"""What `/diagnostics` says of the input and of the filter, for the node and for `replay`.

Two statuses with the keys of REP-107; the rules of `input_rules` and `filter_rules` give their
levels and messages.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from gyro_drift_filter.core.parameters import Parameters
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus, Level
from gyro_drift_filter.messages.filter_rules import FILTER_RULES
from gyro_drift_filter.messages.input_rules import INPUT_RULES
from gyro_drift_filter.messages.names import FILTER_STATUS, INPUT_STATUS, NODE_NAME
from gyro_drift_filter.messages.outlier_reason import seconds_since_outlier, why_flagged
from gyro_drift_filter.messages.rest_obstacle import why_not_at_rest
from gyro_drift_filter.messages.rules import Rule, applying
from gyro_drift_filter.messages.span import Span, span_of
from gyro_drift_filter.messages.telemetry import TELEMETRY, MessageReport, as_telemetry
from gyro_drift_filter.version import package_version

# Reports, one a second, that shares and rates are taken over.
_WINDOW = 10
_LEAST_SECONDS = 5.0  # of the window, to judge a rate
# A replay reports where messages come: in more than so many s since the last report none came for
# a while.
_LONGEST_PACED = 2.0

_at_start = np.zeros(1, TELEMETRY)
_at_start['samples_per_message'] = 1.0
# The report of a message filter to which nothing has come.
NOTHING_RECEIVED = MessageReport(0, 0, '', 0, 0, 0, 0, '', Parameters(), as_telemetry(_at_start)[0])


class Health:
    """Judge the reports of a message filter, made at regular intervals."""

    def __init__(self, node: str = f'/{NODE_NAME}', first_stamp: int = 0) -> None:
        """Start before any message.

        Args:
            node: By its full name.
            first_stamp: In ns, of the first message, where one report is to tell of all of them.
        """
        self._node = node
        state = NOTHING_RECEIVED.telemetry._replace(stamp=first_stamp)
        # Time of each report in s, and the report.
        self._window = deque([(0.0, NOTHING_RECEIVED._replace(telemetry=state))], _WINDOW + 1)
        self._applied: set[str] = set()  # names of the rules that applied to the last report
        self._silent = True

    def judge(
        self, now: MessageReport, seconds: float, *, paced: bool = True
    ) -> list[DiagnosticStatus]:
        """Return the status of the input and of the filter; arguments are those of `rules`."""
        return self.statuses(*self.rules(now, seconds, paced=paced))

    def statuses(
        self, span: Span, of_input: Sequence[Rule], of_filter: Sequence[Rule]
    ) -> list[DiagnosticStatus]:
        """Return the status of the input and of the filter by the rules that apply."""
        sound = 'filtering' if span.now.telemetry.samples else 'no sample yet'
        return [
            self._status(INPUT_STATUS, of_input, 'receiving', span, _input_values(span)),
            self._status(FILTER_STATUS, of_filter, sound, span, _filter_values(span)),
        ]

    def rules(
        self, now: MessageReport, seconds: float, *, paced: bool = True
    ) -> tuple[Span, list[Rule], list[Rule]]:
        """Return what the reports up to this one are about, and which rules apply to it.

        Args:
            now: What the message filter is like.
            seconds: Time since the last report.
            paced: Whether messages come at the pace of that time, so that the rate can be judged.

        Returns:
            The span, and the rules for the input and for the filter, the worst first.
        """
        last, before = self._window[-1]
        is_reset = now.telemetry.samples < before.telemetry.samples
        if is_reset:
            before = before._replace(telemetry=NOTHING_RECEIVED.telemetry)
        if is_reset or now.parameters.method != before.parameters.method:
            # The outliers and innovations so far are those of another filter.
            self._window.clear()
            self._window.append((last, before))
            self._applied.clear()
        start, first = self._window[0]
        if self._silent or seconds > _LONGEST_PACED:
            # After a silence what came is no rate: a part of the time, or all that was kept.
            self._window.clear()
        self._window.append((last + seconds, now))
        after_silence = self._silent and before.received > 0
        self._silent = now.received == before.received
        # A partial second at either end is a small share of this.
        is_long = last + seconds - self._window[0][0] >= _LEAST_SECONDS
        span = span_of(
            first,
            before,
            now,
            last + seconds - start,
            is_rate_judged=paced and is_long,
            after_silence=after_silence,
        )
        of_input = applying(INPUT_RULES, span, self._applied)
        of_filter = applying(FILTER_RULES, span, self._applied)
        self._applied = {rule.name for rule in of_input + of_filter}
        return span, of_input, of_filter

    def _status(
        self, part: str, rules: Sequence[Rule], sound: str, span: Span, values: Mapping[str, Any]
    ) -> DiagnosticStatus:
        """Return the status of a part by the rules that apply, or that it is sound without any."""
        level, message = (rules[0].level, rules[0].message(span)) if rules else (Level.OK, sound)
        return DiagnosticStatus(level, self._node + part, message, span.now.frame, _listed(values))


def _input_values(span: Span) -> dict[str, Any]:
    now, state = span.now, span.now.telemetry
    return {
        'Actual frequency (Hz)': span.rate,
        'Expected frequency (Hz)': span.expected_rate,
        'Sample period learned (s)': state.period,
        'Events since startup': now.received,
        'Samples': state.samples,
        'Refused (malformed)': now.malformed,
        'Refused (no usable rate yet)': state.refused,
        'Passed on (not reported)': now.not_reported,
        'Returned (own output)': now.own_outputs,
        'Dropped by the middleware': now.lost,
        'Duplicate messages': state.duplicates,
        'Gaps': state.gaps,
        'Missing samples': state.missing_samples,
        'Restarts after a jump in time': state.restarts,
        'Zero stamps': state.zero_stamps,
        'Equal stamps': state.same_stamps,
        'Backward stamps': state.backward_stamps,
        'Overtaken messages': state.overtaken,
        'Changes of frame_id': now.frame_changes,
        'Last frame_id it changed to': now.frame if now.frame_changes else '',
        'Samples not measured anew': state.not_measured,
        'Rate of the sensor (Hz)': span.sensor_rate,
        'Low-pass of the sensor (Hz)': span.low_pass,
        'Size of a count (rad/s)': state.count_size,
        'Counts are cut towards zero': state.truncated,
        'Times stuck': state.times_stuck,
        'Unusable rates bridged': state.unusable,
        'Samples at the end of the range': state.clipped,
    }


def _row_by_row(values: Sequence[float]) -> str:
    return ' '.join(f'{value:g}' for value in values)


def _filter_values(span: Span) -> dict[str, Any]:
    state = span.now.telemetry
    return {
        'Method': span.now.parameters.method,
        'Version': package_version(),
        'Calibration matrix': _row_by_row(span.now.parameters.calibration_matrix)
        if span.now.parameters.is_calibrated
        else 'none',
        'Acceleration sensitivity (rad/s per m/s^2)': _row_by_row(
            span.now.parameters.calibration_acceleration_sensitivity
        )
        if span.now.parameters.is_sensitive
        else 'none',
        'Outliers': state.outliers,
        'Why the last outlier was flagged': why_flagged(span.now),
        'Time since the last outlier (s)': seconds_since_outlier(state),
        'Outliers of late (%)': [100.0 * share for share in span.outlier_shares],
        'Normalised innovation squared': span.nis,
        'Normalised residual squared': span.residuals,
        'Process noise Q ((rad/s)^2)': state.process_noise,
        'Measurement noise R ((rad/s)^2)': state.measurement_noise,
        'Rest the noise was learned from (s)': span.noise_seconds
        if span.is_noise_learned
        else 'not learned from rest',
        'Bias at rest (rad/s)': state.bias,
        'Deviation of the bias at rest (rad/s)': state.bias_deviation,
        'At rest': state.at_rest,
        'Why not at rest': why_not_at_rest(state),
        'Time since rest (s)': state.seconds_since_rest if state.segments else 'no rest yet',
        'Segments of rest the bias was learned from': state.segments,
        'Segments of rest with a rate beyond bias.max': state.segments_beyond_max,
        'Segments of rest with a rate the bias can not have come to': state.segments_turning,
        'Divergences': state.divergences,
    }


def _listed(values: Mapping[str, Any]) -> str:
    """Return values as `DiagnosticStatus` takes them; of a list one for each axis."""
    # Written out, as it takes half of the time of a report.
    listed = []
    for key, value in values.items():
        if type(value) is float:
            listed.append(f'{key}\0{value:.6g}\0')
        elif type(value) is not list:
            listed.append(f'{key}\0{value}\0')
        else:
            x, y, z = value
            if type(x) is float:
                listed.append(f'{key} x\0{x:.6g}\0{key} y\0{y:.6g}\0{key} z\0{z:.6g}\0')
            else:
                listed.append(f'{key} x\0{x}\0{key} y\0{y}\0{key} z\0{z}\0')
    return ''.join(listed)
