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

"""What `/diagnostics` says of the filter, and when: a table of rules, the worst first."""

import math

from gyro_drift_filter.core.rest.records import Obstacle
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.rest_obstacle import why_not_at_rest
from gyro_drift_filter.messages.rules import Rule, beyond, has_grown
from gyro_drift_filter.messages.span import Span

# A sensor that is switched on at rest knows its bias by then, in s, or at a low rate in
# twice the time that its first rest takes.
_START_SECONDS = 10.0
# Without a rest for so long, in s, while gravity stands, something hides it; or at a low rate for
# twice the time that the first rest takes.
_LONG_WITHOUT_REST = 120.0
# Noise that was learned from less rest than this, in s, is known to a tenth at best.
_LITTLE_REST = 3.0

# Each of these pairs is where an alarm is raised, and where it is taken back.

# Spikes are a small share of the samples; many outliers are motion, or a model that is wrong.
_OUTLIER_SHARE = 0.1, 0.05
# A filter that fits has a mean of 1, and a third of that or so is no fault. At 4 innovations are
# twice as large as expected, so the filter lags.
_LARGE_INNOVATIONS = 4.0, 2.5
# What a filter that fits takes off the samples has R as its variance at most. Twice that is motion.
_LARGEST_RESIDUAL = 2.0
# At 10 innovations are a third of what is expected, so that an outlier has to be three times as
# large to be found.
_SMALL_INNOVATIONS = 10.0, 5.0


def _largest(values: list[float]) -> float:
    """Return the largest value, NaN where there is none."""
    return max([value for value in values if value == value], default=math.nan)


def _noise_excess(span: Span) -> float:
    """Return the innovation variance that is expected, over the one found, of the worst axis."""
    # Of noise that it has learned a method can't expect too much, but for a dead band, which has
    # none at rest. Nor does a stuck sensor say anything.
    if span.is_noise_learned or span.now.telemetry.stuck:
        return 0.0
    least = -_largest([-value for value in span.nis])
    return 1.0 / least if least else math.inf


def _lag(span: Span) -> float:
    """Return the normalised innovation squared of the worst axis, as far as the filter lags.

    A method that learns its noise at rest meets innovations of any size in motion that it follows,
    as of a quiet sensor in the hand. It lags where it takes more off the samples than their noise.
    """
    if not span.advice.learns_noise:
        return _largest(span.nis)
    share = _LARGE_INNOVATIONS[0] / _LARGEST_RESIDUAL
    pairs = zip(span.nis, span.residuals, strict=True)
    return _largest([min(squared, share * residual) for squared, residual in pairs])


def _has_no_bias(span: Span) -> bool:
    """Return whether the bias that is to be subtracted is not known."""
    state = span.now.telemetry
    return span.now.parameters.bias_enabled and state.samples > 0 and not state.bias_known


def _has_no_bias_for_long(span: Span) -> bool:
    state = span.now.telemetry
    return _has_no_bias(span) and state.seconds_since_rest > max(
        _START_SECONDS, 2.0 * state.least_rest_seconds
    )


def _has_no_rest_for_long(span: Span) -> bool:
    state = span.now.telemetry
    return not state.accelerometer_hangs and state.standing_seconds > max(
        _LONG_WITHOUT_REST, 2.0 * state.least_rest_seconds
    )


def _is_taken_for_turn(span: Span) -> bool:
    """Return whether it is as still as at rest but for the rate, and has had no rest for long."""
    state = span.now.telemetry
    refused = state.rest_obstacle == Obstacle.NOT_ACCEPTED and not state.at_rest
    if not refused or state.rest_beyond_max or not span.now.parameters.bias_enabled:
        return False
    return state.bias_known and state.seconds_since_rest > _LONG_WITHOUT_REST


def _is_beyond_max(span: Span) -> bool:
    """Return whether it is as still as at rest, at a rate that is no bias.

    Beside a bias that is known that is a turn, unless no rest comes for long.
    """
    state = span.now.telemetry
    is_turn = state.bias_known and state.seconds_since_rest <= _LONG_WITHOUT_REST
    return state.rest_beyond_max and not is_turn


def _no_bias(span: Span) -> str:
    state = span.now.telemetry
    known = 'no bias known yet'
    if state.bias_corrected:
        known = 'the bias is known by motion alone'
    elif state.bias_provisional:
        known = 'the bias is provisional'
    return f'{known}: stand still for {state.first_rest} seconds'


def _beyond_max_text(span: Span) -> str:
    limit = f'bias.max ({math.degrees(span.now.parameters.bias_max):g} deg/s)'
    if span.now.telemetry.bias_known:
        return (
            f'no rest for minutes, and now a mean rate beyond {limit} is taken for a turn, and not '
            'subtracted: if the robot stands, its bias has jumped, so have the sensor looked at'
        )
    return (
        f'the mean rate at rest is beyond {limit} and is not subtracted: are the rates '
        'in deg/s (REP-103 asks for rad/s)? If they are not and the robot does not turn, raise '
        'bias.max, and have the sensor looked at'
    )


def _is_noise_unsure(span: Span) -> bool:
    """Return whether the bias is known, and the noise by little rest only."""
    known = span.now.telemetry.bias_known
    return known and min(span.noise_seconds) < _LITTLE_REST and span.is_noise_learned


def _little_rest_text(span: Span) -> str:
    seconds = min(span.noise_seconds)
    known = f'known from {seconds:.1f} s of rest only' if seconds else 'not known yet'
    return f'filtering; the noise is {known}: stand still for some seconds more'


FILTER_RULES = (
    Rule(
        'diverged',
        lambda span: has_grown(span, 'divergences'),
        lambda span: 'the filter diverged and started anew: ' + span.advice.outliers,
    ),
    Rule(
        'outliers',
        # They are NaN on all axes or on none.
        beyond(lambda span: max(span.outlier_shares), *_OUTLIER_SHARE),
        lambda span: 'many samples count as outliers: ' + span.advice.outliers,
    ),
    Rule(
        'large innovations',
        beyond(_lag, *_LARGE_INNOVATIONS),
        lambda span: (
            'innovations are much larger than the filter expects: ' + span.advice.large_innovations
        ),
    ),
    Rule(
        'small innovations',
        beyond(_noise_excess, *_SMALL_INNOVATIONS),
        lambda span: (
            'innovations are far smaller than the filter expects: ' + span.advice.small_innovations
        ),
    ),
    Rule(
        'no rest',
        _has_no_rest_for_long,
        lambda span: (
            'gravity has stood still for minutes, and yet no rest is found, as '
            f'{why_not_at_rest(span.now.telemetry)}: if the robot stands, look for what makes its '
            'rates wander or jump (a motor, a fan, a loose mount, temperature, a driver that '
            'publishes deg/s); if it drives about on level ground, this is no fault, unless the '
            'accelerometer hangs'
        ),
    ),
    Rule(
        'taken for a turn',
        _is_taken_for_turn,
        'no rest for minutes, and now a steady rate that the bias can not have come to is taken '
        'for a slow turn: if the robot stands, its bias changes faster than bias.random_walk says, '
        'so call ~/calibrate now, and raise that parameter',
    ),
    Rule('beyond bias.max', _is_beyond_max, _beyond_max_text),
    Rule(
        'no bias for long',
        _has_no_bias_for_long,
        lambda span: (
            f'{_no_bias(span)} (the heading drifts until then). If the robot stands still now, '
            "'Why not at rest' says what the filter takes for motion"
        ),
    ),
    Rule('no bias', _has_no_bias, _no_bias, level=Level.OK),
    Rule('little rest', _is_noise_unsure, _little_rest_text, level=Level.OK),
)
