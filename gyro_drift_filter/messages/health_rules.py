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

"""When `/diagnostics` says what: a table of rules for the input, and one for the filter.

The first rule of a table that applies gives the level and the message of the status, so the worst
comes first, and what says more before what says less. A message stays the same as long as its cause
does, as a change of it is logged; numbers stand in the values.
"""

import math
from collections.abc import Callable, Sequence, Set
from operator import gt
from typing import NamedTuple

from gyro_drift_filter.core.methods import ADVICE
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.methods.noise import LEAST_NOISE
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.core.sensor_checks import RANGE, AxisFault
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.telemetry import MessageReport

# A sensor that is switched on standing still knows its bias by then, in s, or at a low rate in
# twice the time that its first rest takes.
_START_SECONDS = 10.0
# Samples in the window below which shares say nothing.
_FEW = 200
# Without a rest for so long, in s, while gravity stands, something hides it.
_LONG_WITHOUT_REST = 120.0
# Noise with so much correlation from sample to sample has passed a low-pass. Robots turn with up to
# 10 Hz or so, which one of so many Hz delays and weakens.
_CORRELATED = 0.6
_SLOW_LOW_PASS = 15.0
# Noise that was learned from less rest than this, in s, is known to a tenth at best.
_LITTLE_REST = 3.0
# Of the stamps in the window: a clock that is set goes backward once, two publishers of one topic
# or a driver that mixes its messages up do so all the time.
_BACKWARD_SHARE = 0.05

# Each of these is where an alarm is raised, and where it is taken back.
# A driver that polls faster than the sensor measures by a twentieth repeats one sample in twenty; a
# bus that hangs now and then repeats fewer than one in fifty.
_REPEATED_SHARE = 0.05, 0.02
# The oscillator of a gyroscope is off by some percent, and so is the number of messages in a
# window that begins and ends between two of them. Two publishers double the rate; of a link that
# loses messages every fifth or so is gone.
_RATE_ERROR = 0.2, 0.1
# Gaps in the window of ten seconds: a busy machine makes one now and then, a lost link many, so
# that three raise the alarm, and it stands until there is none.
_GAPS = 2.5, 0.5
# Spikes are a small share of the samples; many outliers are motion, or a model that is wrong.
_OUTLIER_SHARE = 0.1, 0.05
# A filter that fits has a mean of 1, and a third of that or so is no fault. At 4 innovations are
# twice as large as expected, so the filter lags.
_LARGE_INNOVATIONS = 4.0, 2.5
# At 10 innovations are a third of what is expected, so that an outlier has to be three times as
# large to be found.
_SMALL_INNOVATIONS = 10.0, 5.0


class Span(NamedTuple):
    """What a status is about: the time since the last report, and a window of several reports.

    Attributes:
        first: The report at the start of the window.
        before: The last report.
        now: The present one.
        samples: Samples since the last report.
        recent: Samples in the window.
        rate: Messages a second in the window.
        expected_rate: The rate of messages in Hz that was given or learned, NaN before it is.
        is_rate_judged: Whether messages came long enough, and at the pace of the clock.
        outlier_shares: Of the samples in the window, for each axis; NaN where there are few.
        nis: Mean normalised innovation squared in the window, for each axis; NaN likewise.
        not_measured: Share of the samples in the window that the sensor has not measured anew.
    """

    first: MessageReport
    before: MessageReport
    now: MessageReport
    samples: int
    recent: int
    rate: float
    expected_rate: float
    is_rate_judged: bool
    outlier_shares: list[float]
    nis: list[float]
    not_measured: float

    @property
    def sensor_rate(self) -> float:
        """The rate in Hz at which the sensor measures, NaN where it is not known."""
        return (1.0 - self.not_measured) * self.rate

    @property
    def low_pass(self) -> float:
        """The cut-off frequency in Hz of the low-pass that the noise has passed, NaN without one.

        That of a first-order one, by the correlation of its noise from sample to sample.
        """
        state = self.now.telemetry
        axes = zip(state.measurement_noise, state.count_size, state.noise_correlation, strict=True)
        # What is below a step is no noise that a low-pass could have shaped.
        shaped = [c for noise, step, c in axes if noise > max(step, 2.0 * LEAST_NOISE) ** 2]
        correlation = max(shaped, default=0.0)
        if correlation < _CORRELATED or min(state.noise_blocks) == 0:
            return math.nan
        return -math.log(correlation) / state.period / (2.0 * math.pi)

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
    is_rate_judged: bool,
) -> Span:
    """Return the span of three reports, of which the first and the last are `seconds` apart."""
    state, state_first = now.telemetry, first.telemetry
    recent = state.samples - state_first.samples
    outliers = zip(state.outliers, state_first.outliers, strict=True)
    nis = zip(
        state.nis_sum,
        state_first.nis_sum,
        state.nis_samples,
        state_first.nis_samples,
        strict=True,
    )
    sensor_rate = now.parameters.sample_rate
    if sensor_rate == 0.0:
        sensor_rate = 1.0 / state.period if state.blocks > 0 else math.nan
    expected_rate = sensor_rate / state.samples_per_message
    return Span(
        first,
        before,
        now,
        state.samples - before.telemetry.samples,
        recent,
        (now.received - first.received) / seconds if seconds > 0.0 else math.nan,
        expected_rate,
        is_rate_judged,
        [_share(a - b, recent) for a, b in outliers],
        [_share(a - b, c - d) for a, b, c, d in nis],
        _share(state.not_measured - state_first.not_measured, recent),
    )


class Rule(NamedTuple):
    """A level and a message, and when they apply.

    Attributes:
        name: Its own among the rules of both tables.
        level: The level of the status.
        applies: Says whether the rule applies; None leaves that as it was at the last report.
        text: The message, or what makes it.
    """

    name: str
    level: Level
    applies: Callable[[Span], bool | None]
    text: str | Callable[[Span], str]


def applying(rules: Sequence[Rule], span: Span, before: Set[str]) -> list[Rule]:
    """Return the rules that apply, the worst first.

    Args:
        rules: One of the tables.
        span: What the status is about.
        before: Names of the rules that applied to the last report.
    """
    found = []
    for rule in rules:
        applies = rule.applies(span)
        if rule.name in before if applies is None else applies:
            found.append(rule)
    return found


def _beyond(
    value: Callable[[Span], float], raised_at: float, cleared_at: float
) -> Callable[[Span], bool | None]:
    """Return when an alarm stands: raised above one limit, taken back below another, lower one.

    Between them, and where the value is NaN, it stays as it is, so that it does not flicker.
    """

    def applies(span: Span) -> bool | None:
        now = value(span)
        return True if now > raised_at else False if now < cleared_at else None

    return applies


def _increase(span: Span, name: str) -> int:
    """Return by how much a count has grown since the last report."""
    return int(getattr(span.now.telemetry, name) - getattr(span.before.telemetry, name))


def _has_grown(span: Span, name: str) -> bool:
    """Return whether a count has grown since the last report, on any axis."""
    now, before = getattr(span.now.telemetry, name), getattr(span.before.telemetry, name)
    return now != before and any(map(gt, now, before))


def _share(part: float, whole: int) -> float:
    return part / whole if whole >= _FEW else math.nan


def _largest(values: list[float]) -> float:
    """Return the largest value, NaN where there is none."""
    return max([value for value in values if value == value], default=math.nan)


def _stamps_go_backward(span: Span) -> bool:
    backward = span.now.telemetry.backward_stamps - span.first.telemetry.backward_stamps
    return span.recent >= _FEW and backward > _BACKWARD_SHARE * span.recent


def _stamps_are_zero(span: Span) -> bool:
    now, first = span.now.telemetry, span.first.telemetry
    zero = now.zero_stamps - first.zero_stamps
    # The stamps of what was not measured anew are looked at only until the sensor's pace is known.
    none = zero >= span.recent - (now.not_measured - first.not_measured)
    return span.now.parameters.sample_rate == 0.0 and none and zero > 0


def _frame_text(span: Span) -> str:
    if span.now.frame_changes - span.before.frame_changes == 1:
        return 'frame_id has changed: another driver now, or two sensors on one topic?'
    return 'frame_id changes from message to message: two sensors on one topic?'


def _gaps_in_window(span: Span) -> float:
    """Return how many gaps there were."""
    return float(span.now.telemetry.gaps - span.first.telemetry.gaps)


def _rate_error(span: Span) -> float:
    """Return the share by which the rate is off; what can't be judged is not off."""
    error = abs(span.rate / span.expected_rate - 1.0) if span.is_rate_judged else 0.0
    return 0.0 if math.isnan(error) else error


def _rate_text(span: Span) -> str:
    fewer = span.rate < span.expected_rate
    come = f'{"fewer" if fewer else "more"} messages come than'
    if span.now.parameters.sample_rate > 0.0:
        return f'{come} sample_rate says: set it right, or to 0'
    cause = 'are some lost on the way?' if fewer else 'are there two publishers?'
    return f'{come} their stamps say: {cause} Or is a bag played at another speed?'


def _axes_with(span: Span, fault: AxisFault) -> str:
    """Return the axes that have a fault, in words; empty where there is none."""
    faults = zip(AXES, span.now.telemetry.faults, strict=True)
    axes = [axis for axis, of_axis in faults if of_axis == fault]
    return f'{"axes" if len(axes) > 1 else "axis"} {", ".join(axes)}' if axes else ''


def _is_truncation_left(span: Span) -> bool:
    parameters = span.now.parameters
    return span.now.telemetry.truncated and parameters.input_quantisation in ('none', 'round')


def _noise_excess(span: Span) -> float:
    """Return how many times larger than found innovations are expected, squared."""
    # Of noise that it has learned a method can't expect too much, but for a dead band, which has
    # none at rest. Nor does a stuck sensor say anything.
    if span.is_noise_learned or span.now.telemetry.stuck:
        return 0.0
    least = -_largest([-value for value in span.nis])
    return 1.0 / least if least else math.inf


def _has_no_bias(span: Span) -> bool:
    """Return whether the bias that is to be subtracted is not known."""
    state = span.now.telemetry
    return span.now.parameters.bias_enabled and state.samples > 0 and not state.bias_known


def _has_no_bias_for_long(span: Span) -> bool:
    state = span.now.telemetry
    return _has_no_bias(span) and state.rest_seconds > max(
        _START_SECONDS, 2.0 * state.least_rest_seconds
    )


def _no_bias(span: Span) -> str:
    return f'no bias known yet: stand still for {span.now.telemetry.first_rest} seconds'


def _is_noise_unsure(span: Span) -> bool:
    """Return whether the bias is known, and the noise by little rest only."""
    known = span.now.telemetry.bias_known
    return span.is_noise_learned and known and min(span.noise_seconds) < _LITTLE_REST


INPUT_RULES = (
    Rule(
        'silent',
        Level.STALE,
        lambda span: span.now.received == span.before.received,
        'no message: is the driver running, and is the topic right?',
    ),
    Rule(
        'returned',
        Level.ERROR,
        lambda span: span.now.returned > span.before.returned,
        'the filtered messages come back on the input: some node sends the output there. They are '
        'not filtered again; remap one of the topics',
    ),
    Rule(
        'malformed',
        Level.ERROR,
        lambda span: span.now.malformed > span.before.malformed,
        lambda span: f'messages refused, the last because {span.now.last_malformed}',
    ),
    Rule(
        'never usable',
        Level.ERROR,
        lambda span: _increase(span, 'refused') == span.samples > 0,
        'no usable rate on some axis (NaN, infinite or above 1e6 rad/s): nothing is published; '
        'look at the driver',
    ),
    Rule(
        'repeated',
        Level.ERROR,
        lambda span: _increase(span, 'repeats') == span.samples > 0,
        'the same message comes again and again: the sensor or its driver hangs',
    ),
    Rule(
        'zero',
        Level.WARN,
        lambda span: span.now.telemetry.stuck and span.now.telemetry.all_zero,
        'all rates have been exactly 0 for a second or more: a dead band in the driver, or the '
        'sensor hangs',
    ),
    Rule(
        'stuck',
        Level.ERROR,
        lambda span: span.now.telemetry.stuck,
        'all values have stayed the same for a second or more: the sensor or its bus hangs (a '
        'simulated sensor without noise does this, too)',
    ),
    Rule(
        'frozen axis',
        Level.ERROR,
        lambda span: bool(_axes_with(span, AxisFault.FROZEN)),
        lambda span: (
            f'{_axes_with(span, AxisFault.FROZEN)} of the gyroscope: not a bit has changed for a '
            'second or more, while the other sensors change: it hangs, or the driver has a dead '
            'band'
        ),
    ),
    Rule(
        'changing frame',
        Level.WARN,
        lambda span: span.now.frame_changes > span.before.frame_changes,
        _frame_text,
    ),
    Rule(
        'not reported',
        Level.WARN,
        lambda span: span.samples == 0,
        'no angular velocity reported (covariance starts with -1): messages are passed on '
        'unfiltered',
    ),
    Rule(
        'degrees',
        Level.WARN,
        lambda span: 2 * _increase(span, 'beyond_range') > span.samples,
        f'rates stay above {RANGE:g} rad/s: the driver may publish degrees per second where '
        'REP-103 asks for radians',
    ),
    Rule(
        'clipped',
        Level.WARN,
        lambda span: _has_grown(span, 'clipped'),
        'a fast rate stays the same to the last bit: the end of the measuring range; choose a '
        'larger one in the driver',
    ),
    Rule(
        'dead axis',
        Level.WARN,
        lambda span: bool(_axes_with(span, AxisFault.DEAD)),
        lambda span: (
            f'{_axes_with(span, AxisFault.DEAD)} of the gyroscope: always the same rate while '
            'others turn, so dead or not connected; the other axes are filtered'
        ),
    ),
    Rule(
        'unusable',
        Level.WARN,
        lambda span: _has_grown(span, 'unusable'),
        'rates that are no usable number (NaN, infinite or above 1e6 rad/s): bridged by the '
        'prediction for as long as gap_limit, then nothing is published',
    ),
    Rule(
        'lost',
        Level.WARN,
        lambda span: span.now.lost > span.before.lost,
        'the middleware has dropped messages before the node took them: the processor or the '
        'network does not keep up',
    ),
    Rule(
        'repeated samples',
        Level.WARN,
        _beyond(lambda span: span.not_measured, *_REPEATED_SHARE),
        'the driver repeats samples, as it polls faster than the sensor measures: poll at the rate '
        'of the sensor, or on its data-ready signal',
    ),
    Rule(
        'truncated',
        Level.WARN,
        _is_truncation_left,
        'the sensor cuts its counts towards zero, which turns the heading: set input.quantisation '
        'to auto or truncate',
    ),
    Rule(
        'low-pass',
        Level.WARN,
        lambda span: span.low_pass < _SLOW_LOW_PASS,
        'the rates come through a low-pass, of the sensor or its driver, that holds fast motion '
        'back: choose a higher cut-off frequency',
    ),
    Rule(
        'restarted',
        Level.WARN,
        lambda span: _increase(span, 'restarts') > 0,
        'stamps jumped by more than gap_limit: the filter has started anew from there',
    ),
    Rule(
        'backward',
        Level.WARN,
        _stamps_go_backward,
        'many stamps go backward: are there two publishers, or does the driver mix its messages '
        'up?',
    ),
    Rule(
        'zero stamps',
        Level.WARN,
        _stamps_are_zero,
        'the driver does not stamp (all stamps are 0): set sample_rate',
    ),
    Rule('wrong rate', Level.WARN, _beyond(_rate_error, *_RATE_ERROR), _rate_text),
    Rule(
        'gaps',
        Level.WARN,
        _beyond(_gaps_in_window, *_GAPS),
        'gaps in the stamps: messages are lost before they come here',
    ),
)

FILTER_RULES = (
    Rule(
        'diverged',
        Level.WARN,
        lambda span: _has_grown(span, 'divergences'),
        lambda span: 'the filter diverged and started anew: ' + span.advice.outliers,
    ),
    Rule(
        'outliers',
        Level.WARN,
        _beyond(lambda span: _largest(span.outlier_shares), *_OUTLIER_SHARE),
        lambda span: 'many samples count as outliers: ' + span.advice.outliers,
    ),
    Rule(
        'large innovations',
        Level.WARN,
        _beyond(lambda span: _largest(span.nis), *_LARGE_INNOVATIONS),
        lambda span: (
            'innovations are much larger than the filter expects: ' + span.advice.large_innovations
        ),
    ),
    Rule(
        'small innovations',
        Level.WARN,
        _beyond(_noise_excess, *_SMALL_INNOVATIONS),
        lambda span: (
            'innovations are far smaller than the filter expects, so that no outlier will '
            'be found: ' + span.advice.small_innovations
        ),
    ),
    Rule(
        'no rest',
        Level.WARN,
        lambda span: span.now.telemetry.steady_seconds > _LONG_WITHOUT_REST,
        'gravity has stood still for minutes, and yet no rest is found: if the robot stands, look '
        'for what makes its rates wander or jump (a motor, a fan, a loose mount, temperature)',
    ),
    Rule(
        'beyond bias.max',
        Level.WARN,
        lambda span: span.now.telemetry.beyond,
        lambda span: (
            'steady as at rest, but the rate is beyond bias.max '
            f'({math.degrees(span.now.parameters.bias_max):g} deg/s) and is not subtracted: are '
            'the rates in deg/s (REP-103 asks for rad/s)? If they are not and the robot does not '
            'turn, raise bias.max, and have the sensor looked at'
        ),
    ),
    Rule(
        'no bias for long',
        Level.WARN,
        _has_no_bias_for_long,
        lambda span: _no_bias(span) + ' (the heading drifts until then)',
    ),
    Rule('no bias', Level.OK, _has_no_bias, _no_bias),
    Rule(
        'little rest',
        Level.OK,
        _is_noise_unsure,
        lambda span: (
            f'filtering; the noise is known from {min(span.noise_seconds):.1f} s of rest only: '
            'stand still for some seconds more'
        ),
    ),
)
