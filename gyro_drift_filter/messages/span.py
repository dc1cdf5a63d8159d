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

"""What a status of `/diagnostics` is about: the last report, and a window of several reports."""

import math
from typing import NamedTuple

from gyro_drift_filter.core.methods import ADVICE
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.methods.noise import LEAST_NOISE
from gyro_drift_filter.messages.telemetry import MessageReport, Telemetry

# Samples in the window below which shares say nothing.
LEAST_SAMPLES = 200
# Noise with so much correlation from sample to sample has passed a low-pass.
_CORRELATED = 0.6


class Span(NamedTuple):
    """What a status is about: the time since the last report, and a window of several reports.

    Attributes:
        first: The report at the start of the window.
        before: The last report.
        now: The present one.
        samples: Samples since the last report.
        recent: Samples in the window.
        seconds: From its start to the present report.
        rate: Messages a second in the window, of any kind.
        reported_rate: Messages a second in the window that report a rate, which the filter takes.
        not_reported_share: Share of the messages in the window that report no rate.
        expected_rate: The rate of messages in Hz that was given or learned, NaN before it is.
        is_rate_judged: Whether messages came long enough, and at the pace of the clock.
        after_silence: Whether messages came once, and none between the two reports before.
        outlier_shares: Of the samples in the window, for each axis; NaN where there are few. What
            was no usable number is flagged by the filter, too, but is no outlier here.
        nis: Mean normalised innovation squared in the window, for each axis; NaN likewise.
        residuals: Mean squared difference between sample and filtered rate over R, of the same
            samples.
        not_measured_share: Share of the samples in the window that the sensor has not measured
            anew.
        low_pass: The cut-off frequency in Hz of the low-pass that the noise has passed, NaN without
            one.
    """

    first: MessageReport
    before: MessageReport
    now: MessageReport
    samples: int
    recent: int
    seconds: float
    rate: float
    reported_rate: float
    not_reported_share: float
    expected_rate: float
    is_rate_judged: bool
    after_silence: bool
    outlier_shares: list[float]
    nis: list[float]
    residuals: list[float]
    not_measured_share: float
    low_pass: float

    @property
    def sensor_rate(self) -> float:
        """The rate in Hz at which the sensor measures, NaN where it is not known."""
        return (1.0 - self.not_measured_share) * self.reported_rate

    @property
    def stamped_rate(self) -> float:
        """The mean rate of messages in Hz that the stamps in the window tell, with those missing.

        It is `expected_rate` where they tell none, as where a clock was set.
        """
        now, first = self.now.telemetry, self.first.telemetry
        stamped = 1e-9 * (now.stamp - first.stamp)
        overtaken = now.overtaken - first.overtaken
        set_back = now.backward_stamps - first.backward_stamps > overtaken
        jumped = now.restarts > first.restarts or now.zero_stamps > first.zero_stamps
        if first.stamp == 0 or stamped <= 0.0 or set_back or jumped:
            return self.expected_rate
        missing = (now.missing_samples - first.missing_samples) / now.samples_per_message
        return (self.recent + missing) / stamped

    @property
    def noise_seconds(self) -> list[float]:
        """The time at rest that the noise was learned from, in s, of each axis."""
        state = self.now.telemetry
        return [state.noise_block_seconds * count for count in state.noise_blocks]

    @property
    def advice(self) -> Advice:
        """What the method says to do about it."""
        return ADVICE[self.now.parameters.method]

    @property
    def is_noise_learned(self) -> bool:
        """Whether the noise is learned at rest, and not given."""
        return self.advice.learns_noise and not any(self.now.parameters.model_noise_deviation)


def span_of(
    first: MessageReport,
    before: MessageReport,
    now: MessageReport,
    seconds: float,
    *,
    is_rate_judged: bool,
    after_silence: bool = False,
) -> Span:
    """Return the span of three reports, of which the first and the last are `seconds` apart."""
    state, state_first = now.telemetry, first.telemetry
    recent = state.samples - state_first.samples
    outliers = zip(usable_outliers(state), usable_outliers(state_first), strict=True)
    judged = [a - b for a, b in zip(state.nis_samples, state_first.nis_samples, strict=True)]
    nis = zip(state.nis_sum, state_first.nis_sum, judged, strict=True)
    residuals = zip(state.residual_sum, state_first.residual_sum, judged, strict=True)
    sensor_rate = now.parameters.sample_rate
    if sensor_rate == 0.0:
        sensor_rate = 1.0 / state.period if state.period_blocks > 0 else math.nan
    received, not_reported = now.received - first.received, now.not_reported - first.not_reported
    reported = _reporting(now) - _reporting(first)
    expected_rate = sensor_rate / state.samples_per_message
    return Span(
        first=first,
        before=before,
        now=now,
        samples=state.samples - before.telemetry.samples,
        recent=recent,
        seconds=seconds,
        rate=received / seconds if seconds > 0.0 else math.nan,
        reported_rate=reported / seconds if seconds > 0.0 else math.nan,
        not_reported_share=not_reported / received if received > 0 else 0.0,
        expected_rate=expected_rate,
        is_rate_judged=is_rate_judged,
        after_silence=after_silence,
        outlier_shares=[_share(max(a - b, 0), recent) for a, b in outliers],
        nis=[_share(a - b, count) for a, b, count in nis],
        residuals=[_share(a - b, count) for a, b, count in residuals],
        not_measured_share=_share(state.not_measured - state_first.not_measured, recent),
        low_pass=_low_pass(state),
    )


def _reporting(report: MessageReport) -> int:
    """Return how many messages reported a rate of the sensor."""
    return report.received - report.malformed - report.not_reported - report.own_outputs


def usable_outliers(state: Telemetry) -> list[int]:
    """Return how many outliers there were on each axis, without what was no usable number.

    The filter flags that, too, where it has a prediction to put in its place; it refuses it where
    it has none.
    """
    counts = zip(state.outliers, state.unusable, strict=True)
    return [max(flagged - max(none - state.refused, 0), 0) for flagged, none in counts]


def _share(part: float, whole: int) -> float:
    return part / whole if whole >= LEAST_SAMPLES else math.nan


def _low_pass(state: Telemetry) -> float:
    """Return the cut-off frequency in Hz of the low-pass that the noise has passed, NaN without it.

    Of first or of second order, whichever the correlation of samples two apart fits better.
    """
    axes = zip(
        state.measurement_noise,
        state.count_size,
        state.noise_correlation,
        state.noise_correlation_two_apart,
        strict=True,
    )
    # What is below a step is no noise that a low-pass could have shaped. Roots are compared, as the
    # square of a step overflows where a driver sends memory that it has never written.
    shaped = [
        (one_apart, two_apart)
        for noise, step, one_apart, two_apart in axes
        if math.sqrt(noise) > max(step, 2.0 * LEAST_NOISE)
    ]
    one_apart, two_apart = max(shaped, default=(0.0, 0.0))
    if one_apart < _CORRELATED or min(state.noise_blocks) == 0:
        return math.nan
    # In radians from sample to sample.
    first_order, second_order = -math.log(one_apart), _of_second_order(one_apart)
    off_first = abs(two_apart - one_apart * one_apart)
    off_second = abs(two_apart - _second_order_correlation(2.0 * second_order))
    radians = first_order if off_first < off_second else second_order
    return radians / state.period / (2.0 * math.pi)


def _second_order_correlation(radians: float) -> float:
    """Return how white noise behind a Butterworth low-pass of second order correlates.

    It is that of values so far apart, in radians of the cut-off frequency.
    """
    damped = radians / math.sqrt(2.0)
    return math.exp(-damped) * (math.cos(damped) + math.sin(damped))


def _of_second_order(correlation: float) -> float:
    """Return how far apart values have a correlation, from 0 to 1, in radians of the cut-off."""
    nearer, farther = 0.0, math.pi / math.sqrt(2.0)  # where it is 1, and below 0.3
    for _ in range(40):
        middle = 0.5 * (nearer + farther)
        if _second_order_correlation(middle) > correlation:
            nearer = middle
        else:
            farther = middle
    return 0.5 * (nearer + farther)
