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

"""What `/diagnostics` says of the input, and when: a table of rules, the worst first."""

import math

from gyro_drift_filter.core.bias.in_motion import LARGEST_GRAVITY_SHARE, LEAST_GRAVITY_SHARE
from gyro_drift_filter.core.clock.periods import LEAST_STAMPED_SHARE, OTHER_PERIOD, STALLED_SECONDS
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.core.rest.standing import STEADY_GRAVITY
from gyro_drift_filter.core.sensor_checks import LARGEST_STEADY_ACCELERATION, RANGE, AxisFault
from gyro_drift_filter.gravity import GRAVITY
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.rules import Rule, beyond, has_grown, in_window, increase
from gyro_drift_filter.messages.span import LEAST_SAMPLES, Span
from gyro_drift_filter.phrases import named_axes

# Robots turn with up to 10 Hz or so, which a low-pass of so many Hz delays and weakens.
SLOW_LOW_PASS = 15.0
# Of the stamps in the window: a clock that is set goes backward once, two publishers of one topic
# or a driver that mixes its messages up do so all the time.
_BACKWARD_SHARE = 0.05
# Of gap_limit: where samples are so far apart, stamps that are a bit late are beyond it.
_LONG_STEP = 0.8
# Messages that come between two reports stand for up to a report more.
_OTHER_UNIT = 10.0
# So many samples in the window show that their stamps always jump: one pause is none of them.
_LEAST_STEPS = 5
# No gyroscope has so much noise at rest, in rad/s, and what shakes it so much shakes the
# accelerometer by more than this, in m/s^2. In degrees, 0.06 deg/s of noise pass for 0.06 rad/s.
LARGEST_NOISE, CALM = 0.03, 0.1
IN_DEGREES = 'the driver may publish degrees per second where REP-103 asks for radians'

# What is known of gravity at rest is a mean that each axis has since then stayed by within
# STEADY_GRAVITY, so that one which shows nothing may seem to show so much, in m/s^2.
_NO_FORCE = math.sqrt(3.0) * STEADY_GRAVITY

# Each of these pairs is where an alarm is raised, and where it is taken back.

# A driver that polls faster than the sensor measures by a twentieth repeats one sample in twenty; a
# bus that hangs now and then repeats fewer than one in fifty.
_REPEATED_SHARE = 0.05, 0.02
# The oscillator of a gyroscope is off by some percent, and so is the number of messages in a
# window that begins and ends between two of them. Two publishers double the rate; of a link that
# loses messages every fifth or so is gone.
_RATE_ERROR = 0.2, 0.1
# Of the messages in a window of so many seconds or more: a driver that starts up leaves the rates
# out of a few.
_NOT_REPORTED_SHARE, _NOT_REPORTED_SECONDS = (0.02, 0.01), 5.0
# Where so many are to be expected, none comes by chance once in a thousand times.
_SURELY_ONE = 7.0
# What may leave a gap in the stamps of the rates, as well as what is lost.
WITHOUT_RATES = 'messages come without rates (covariance starts with -1)'
# Gaps in the window of ten seconds: a busy machine makes one now and then, a lost link many, so
# that three raise the alarm, and it stands until there is none.
_GAPS = 2.5, 0.5


def _stamps_go_backward(span: Span) -> bool:
    if span.recent < LEAST_SAMPLES:
        return False
    return in_window(span, 'backward_stamps') > _BACKWARD_SHARE * span.recent


def _stamps_always_jump(span: Span) -> bool:
    return span.recent >= _LEAST_STEPS and 2 * in_window(span, 'restarts') > span.recent


def _is_slower_than_gap_limit(span: Span) -> bool:
    """Return whether it is the sensor that is slow where stamps jump, and no clock that is set."""
    state = span.now.telemetry
    if state.restarts < _LEAST_STEPS or not in_window(span, 'restarts'):
        return False
    limit, step = _LONG_STEP * span.now.parameters.gap_limit, 1e-9 * in_window(span, 'stamp')
    # Stamps that are farther apart than gap_limit tell the filter no period.
    is_known = state.period_blocks > 0 and state.period < limit
    # In another unit they advance a thousand times as fast.
    return not is_known and limit * span.recent < step < _OTHER_UNIT * span.seconds


def _stamps_are_zero(span: Span) -> bool:
    zero = in_window(span, 'zero_stamps')
    # The stamps of what was not measured anew are looked at only until the sensor's pace is known.
    none = zero > 0 and zero >= span.recent - in_window(span, 'not_measured')
    return span.now.parameters.sample_rate == 0.0 and none


def _stamps_stand(span: Span) -> bool:
    if span.recent < LEAST_SAMPLES:
        return False
    again = in_window(span, 'not_measured') + in_window(span, 'duplicates')
    lasted = (span.recent - again) * span.now.telemetry.period
    stamped = 1e-9 * in_window(span, 'stamp')
    judged = min(span.seconds, lasted) >= STALLED_SECONDS
    # A clock that was set, or no stamps at all, are told by other rules.
    others = 'zero_stamps', 'backward_stamps', 'restarts'
    stand = judged and stamped < LEAST_STAMPED_SHARE * lasted
    return stand and all(in_window(span, name) <= 0 for name in others)


def _contradicts_gravity(span: Span) -> bool:
    """Return whether rates and accelerations are not those of one motion.

    Where samples are counted at a rate that nobody has given, nobody knows for how long it turned,
    so that its turns fit gravity only by chance. Nor do they fit with a bias that is left in, as it
    is beyond `bias.max`.
    """
    state = span.now.telemetry
    left_in = state.segments_beyond_max > 0 and not state.bias_known
    if not state.contradicts_gravity or left_in:
        return False
    is_given = span.now.parameters.sample_rate > 0.0
    return is_given or not (_stamps_are_zero(span) or _stamps_stand(span))


def _has_noise_in_degrees(span: Span) -> bool:
    state = span.now.telemetry
    calm = 0.0 < max(state.acceleration_deviation_at_rest) < CALM
    return calm and min(state.rate_deviation_at_rest) > LARGEST_NOISE


def _frame_text(span: Span) -> str:
    if span.now.frame_changes - span.before.frame_changes == 1:
        return (
            'frame_id has changed: another driver now, or two sensors on one topic? The bias is '
            'uncertain until the next rest'
        )
    return 'frame_id changes from message to message: two sensors on one topic?'


def _left_in_gaps(span: Span) -> int:
    """Return how many messages came too late for their place: each goes back into a gap."""
    backward = in_window(span, 'backward_stamps')
    return min(in_window(span, 'gaps'), backward - in_window(span, 'overtaken'))


def _swapped_in_window(span: Span) -> float:
    """Return how many messages came after the next one."""
    return float(in_window(span, 'overtaken') + _left_in_gaps(span))


def _gaps_in_window(span: Span) -> float:
    """Return how many gaps there were that no message has filled later."""
    return float(in_window(span, 'gaps') - _left_in_gaps(span))


def _rate_error(span: Span) -> float:
    """Return the share by which the rate is off; what can't be judged is not off."""
    if not span.is_rate_judged:
        return 0.0
    error = _rate_off(span, span.expected_rate)
    if span.now.parameters.sample_rate == 0.0:
        # After a driver has changed its rate the window holds samples of both, and for some seconds
        # the period is still the old one.
        if _has_changed_rate(span):
            return 0.0
        error = min(error, _rate_off(span, span.stamped_rate))
    return 0.0 if math.isnan(error) else error


def _rate_off(span: Span, expected: float) -> float:
    """Return the share by which the rate is off an expected one.

    Messages without rates are none too many, but they may stand where rates are too few.
    """
    return max(span.reported_rate / expected - 1.0, 1.0 - span.rate / expected)


def _has_changed_rate(span: Span) -> bool:
    """Return whether the sample period learned is another one than at the start of the window."""
    now, first = span.now.telemetry, span.first.telemetry
    return first.period_blocks > 0 and abs(now.period / first.period - 1.0) > OTHER_PERIOD


def _rate_text(span: Span) -> str:
    fewer = span.reported_rate < span.expected_rate
    come = f'{"fewer" if fewer else "more"} messages come than'
    if span.now.parameters.sample_rate > 0.0:
        return f'{come} sample_rate says: set it right, or to 0'
    cause = 'are some lost on the way?' if fewer else 'are there two publishers?'
    return f'{come} their stamps say: {cause} Or is a bag played at another speed?'


_are_some_not_reported = beyond(lambda span: span.not_reported_share, *_NOT_REPORTED_SHARE)


def _is_not_reported(span: Span) -> bool | None:
    """Return whether messages without rates come; None where the alarm stays as it is."""
    some = _are_some_not_reported(span)
    if span.now.not_reported > span.before.not_reported:
        return span.samples == 0 or (some if span.seconds >= _NOT_REPORTED_SECONDS else None)
    # What is left of a time without rates in the window is no share of what comes now.
    received = span.now.received - span.before.received
    is_over = span.not_reported_share * received > _SURELY_ONE
    return False if is_over or some is False else None


def _not_reported_text(span: Span) -> str:
    measured = 'If the driver does measure rates, have it write 0 or their variance there'
    if span.samples == 0:
        return (
            'no angular velocity reported (covariance starts with -1): messages are passed on '
            f'unfiltered. {measured}'
        )
    return (
        'some messages report no angular velocity (covariance starts with -1): they are passed on '
        'unfiltered, and the others are filtered. Are there two publishers, or does the driver '
        f'send orientation and rates apart? {measured}'
    )


def may_leave_gaps(without_rates: int, missing: int) -> bool:
    """Return whether so many messages without rates may be half of the missing samples or more."""
    return without_rates > 0 and 2 * without_rates >= missing


def _gap_text(span: Span) -> str:
    without = span.now.not_reported - span.first.not_reported
    if may_leave_gaps(without, in_window(span, 'missing_samples')):
        return f'gaps in the stamps: {WITHOUT_RATES}, or are lost before they come here'
    return 'gaps in the stamps: messages are lost before they come here'


def _restart_text(span: Span) -> str:
    anew = 'the filter has started anew from there'
    if span.after_silence:
        return f'no message came for longer than gap_limit: {anew}'
    if _are_some_not_reported(span):
        return (
            f'stamps of rates jumped by more than gap_limit: {WITHOUT_RATES}, or a clock was set; '
            f'{anew}'
        )
    return f'stamps jumped by more than gap_limit: {anew}'


def _axes_with(span: Span, fault: AxisFault) -> str:
    """Return the axes that have a fault, in words."""
    faults = zip(AXES, span.now.telemetry.faults, strict=True)
    return named_axes([axis for axis, of_axis in faults if of_axis == fault])


def _frozen_text(span: Span) -> str:
    still = (
        f'{_axes_with(span, AxisFault.FROZEN)} of the gyroscope: not a bit has changed for a '
        'second or more, while the other sensors change: '
    )
    pairs = zip(span.now.telemetry.faults, span.now.telemetry.at_limit, strict=True)
    if any(fault == AxisFault.FROZEN and at_limit for fault, at_limit in pairs):
        return still + (
            'the rate is at the end of the measuring range (choose a larger one in the driver), '
            'or it hangs'
        )
    return still + 'it hangs, or the driver has a dead band'


def _is_truncation_left(span: Span) -> bool:
    parameters = span.now.parameters
    return span.now.telemetry.truncated and parameters.input_quantisation in ('none', 'round')


def _shows_no_gravity(span: Span) -> bool:
    """Return whether the accelerometer shows something else than gravity in m/s^2 at rest.

    One that shows nothing is none, or has gravity taken off. What is beyond gravity has a rule of
    its own.
    """
    if _is_mostly_beyond_gravity(span):
        return False
    size = span.now.telemetry.acceleration_at_rest
    is_gravity = LEAST_GRAVITY_SHARE < size / GRAVITY < LARGEST_GRAVITY_SHARE
    return size > _NO_FORCE and not is_gravity


def _is_mostly_beyond_gravity(span: Span) -> bool:
    """Return whether more than half of the samples in the window are."""
    return span.recent >= LEAST_SAMPLES and 2 * in_window(span, 'beyond_gravity') > span.recent


def _no_gravity_text(span: Span) -> str:
    # Not to more than it is known by.
    size = round(span.now.telemetry.acceleration_at_rest, 1)
    return (
        f'the acceleration at rest is {size:g}, where gravity is 9.81 m/s^2 (REP-145): publish '
        'm/s^2, and look whether each of its axes measures. Without gravity no bias is found in '
        'motion, and a bias that has jumped is found only after 90 s of rest'
    )


def _are_all(span: Span, name: str) -> bool:
    """Return whether a count has grown by every sample since the last report, if there were any."""
    return 0 < span.samples == increase(span, name)


INPUT_RULES = (
    Rule(
        'silent',
        lambda span: span.now.received == span.before.received,
        'no message: is the driver running, and is the topic right?',
        level=Level.STALE,
    ),
    Rule(
        'own output',
        lambda span: span.now.own_outputs > span.before.own_outputs,
        'the filtered messages come back on the input: some node sends the output there. They are '
        'not filtered again; remap one of the topics',
        level=Level.ERROR,
    ),
    Rule(
        'malformed',
        lambda span: span.now.malformed > span.before.malformed,
        lambda span: f'messages refused, the last because {span.now.last_malformed}',
        level=Level.ERROR,
    ),
    Rule(
        'no usable rate',
        lambda span: _are_all(span, 'refused'),
        'no usable rate on some axis (NaN, infinite or above 1e6 rad/s): nothing is published; '
        'look at the driver',
        level=Level.ERROR,
    ),
    Rule(
        'repeated',
        lambda span: _are_all(span, 'duplicates'),
        'the same message comes again and again: the sensor or its driver hangs',
        level=Level.ERROR,
    ),
    Rule(
        'zero',
        lambda span: span.now.telemetry.stuck and span.now.telemetry.all_zero,
        'all rates have been exactly 0 for a second or more: a dead band in the driver, or the '
        'sensor hangs',
    ),
    Rule(
        'stuck',
        lambda span: span.now.telemetry.stuck,
        'all values have stayed the same for a second or more: the sensor or its bus hangs (a '
        'simulated sensor without noise does this, too)',
        level=Level.ERROR,
    ),
    Rule(
        'frozen axis',
        lambda span: AxisFault.FROZEN in span.now.telemetry.faults,
        _frozen_text,
        level=Level.ERROR,
    ),
    Rule(
        'changing frame',
        lambda span: span.now.frame_changes > span.before.frame_changes,
        _frame_text,
    ),
    Rule('not reported', _is_not_reported, _not_reported_text),
    Rule(
        'degrees',
        lambda span: 2 * increase(span, 'beyond_range') > span.samples,
        f'rates stay above {RANGE:g} rad/s, as in deg/s or mrad/s: {IN_DEGREES}',
    ),
    Rule(
        'noise in degrees',
        _has_noise_in_degrees,
        f'at rest the rates have a noise of more than {LARGEST_NOISE:g} rad/s beside a calm '
        f'accelerometer, as in deg/s or mrad/s: {IN_DEGREES}',
    ),
    Rule(
        'frozen accelerometer',
        lambda span: span.now.telemetry.accelerometer_hangs,
        'the accelerometer hangs: not a bit has changed for a second or more, while the body turns '
        'so that gravity would move. The rates are filtered all the same, but no bias is found in '
        'motion',
    ),
    Rule(
        'beyond gravity',
        _is_mostly_beyond_gravity,
        f'the acceleration stays beyond {LARGEST_STEADY_ACCELERATION:g} m/s^2, ten times gravity: '
        'does the driver publish mg or counts where REP-145 asks for m/s^2, or does the sensor '
        'spin fast at a distance from its axis? Rests are found late then, or not at all, and so '
        'is the bias',
    ),
    Rule('no gravity', _shows_no_gravity, _no_gravity_text),
    Rule(
        'contradicts gravity',
        _contradicts_gravity,
        'rates and accelerations are not those of one motion: are the axes of both sensors the '
        'same, with the same signs, and does neither come late? In free fall no gravity is felt, '
        'and thrust that lasts hides it. Until that ends, gravity shows no bias in motion: it is '
        'found only while the sensor stands still',
    ),
    Rule(
        'clipped',
        lambda span: has_grown(span, 'clipped'),
        'a fast rate stays where it is, without noise: the end of the measuring range; choose a '
        'larger one in the driver',
    ),
    Rule(
        'dead axis',
        lambda span: AxisFault.DEAD in span.now.telemetry.faults,
        lambda span: (
            f'{_axes_with(span, AxisFault.DEAD)} of the gyroscope: always the same rate while '
            'others turn, so dead or not connected; the other axes are filtered'
        ),
    ),
    Rule(
        'unusable',
        lambda span: has_grown(span, 'unusable'),
        'rates that are no usable number (NaN, infinite or above 1e6 rad/s): bridged by the '
        'prediction for as long as gap_limit, then nothing is published',
    ),
    Rule(
        'lost',
        lambda span: span.now.lost > span.before.lost,
        'the middleware has dropped messages before the node took them: the processor or the '
        'network does not keep up',
    ),
    Rule(
        'repeated samples',
        beyond(lambda span: span.not_measured_share, *_REPEATED_SHARE),
        'the driver repeats samples, as it polls faster than the sensor measures: poll at the rate '
        'of the sensor, or on its data-ready signal',
    ),
    Rule(
        'truncated',
        _is_truncation_left,
        'the sensor cuts its counts towards zero, which turns the heading: set input.quantisation '
        'to auto or truncate',
    ),
    Rule(
        'low-pass',
        lambda span: span.low_pass < SLOW_LOW_PASS,
        'the rates come through a low-pass, of the sensor or its driver, that holds fast motion '
        'back: choose a higher cut-off frequency, unless a machine that runs at some Hz shakes the '
        'sensor at rest',
    ),
    Rule(
        'slow sensor',
        _is_slower_than_gap_limit,
        'samples come as far apart as gap_limit allows, or farther, so that the filter starts anew '
        'at each that is a bit late: raise gap_limit to three sample periods or more, and have a '
        'sensor publish at 1 Hz at least',
    ),
    Rule(
        'always restarted',
        _stamps_always_jump,
        'most stamps are farther than gap_limit from the one before, so that each sample begins '
        'anew and nothing is filtered: are the stamps in another unit, do the clocks of two '
        'drivers mix, or does the sensor measure more slowly than gap_limit allows?',
    ),
    Rule('restarted', lambda span: increase(span, 'restarts') > 0, _restart_text),
    Rule(
        'backward',
        _stamps_go_backward,
        'many stamps go backward: are there two publishers, or does the driver mix its messages '
        'up?',
    ),
    Rule(
        'wrong order',
        beyond(_swapped_in_window, *_GAPS),
        'stamps leave gaps and go back into them: do messages come in the wrong order, as from a '
        'relay with several threads or a link by UDP, or are stamps off by half a period and more?',
    ),
    Rule(
        'zero stamps',
        _stamps_are_zero,
        'the driver does not stamp (all stamps are 0), so that samples are counted at 100 Hz: set '
        'sample_rate to the rate of the sensor',
    ),
    Rule(
        'standing stamps',
        _stamps_stand,
        'the stamps hardly advance from message to message, so that samples are counted at '
        'sample_rate, or at 100 Hz where it is 0: stamp each message with the time of its '
        'measurement, in seconds and nanoseconds, or set sample_rate',
    ),
    Rule('wrong rate', beyond(_rate_error, *_RATE_ERROR), _rate_text),
    Rule('gaps', beyond(_gaps_in_window, *_GAPS), _gap_text),
)
