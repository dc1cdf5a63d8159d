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

"""The verdict in words that somebody understands who has never seen the filter."""

import textwrap
from collections.abc import Callable

import numpy as np

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.doctor.live_rules import starts_anew
from gyro_drift_filter.errors import printable
from gyro_drift_filter.messages.input_rules import IN_DEGREES
from gyro_drift_filter.phrases import by_axis, counted, time_to_stand, why_no_rest
from gyro_drift_filter.report.verdict import (
    SIGNIFICANT,
    Bias,
    BiasSource,
    FlaggedOutliers,
    Outcome,
    Verdict,
    in_degrees,
)

_WIDTH = 100
_INDENT = 11
_PER_MINUTE = 60.0
# A turn before the bias was known that nobody sees, in rad: half a degree.
_VISIBLE = 0.0087
# A filter that does not fit its sensor for less than this share of the time is not worth a word.
_LAG_SHARE = 0.005
# A good gyroscope's scale is off by so much; it is told where that is more than what is left.
_SCALE = 0.01
# A robot that stops stands for so long, in s: where a rest has to last longer, that is told.
_USUAL_REST = 10
# s without samples that are worth a word.
_PAUSE_SECONDS = 1.0
_TOO_SHORT = 'too short to tell the noise'
_NOT_LOOKED_FOR = 'not looked for: outlier.enabled is false'


def headline(verdict: Verdict) -> str:
    """Return the verdict in a sentence or two."""
    if verdict.outcome == Outcome.HARMED:
        return f'This filter does harm here: {_why_harmful(verdict)}'
    if verdict.outcome == Outcome.USELESS:
        return f'This filter did nothing useful here: {_why_useless(verdict)}.'
    if verdict.outcome == Outcome.UNSURE:
        return f'This filter can not tell whether it helped: {_why_unsure(verdict)}.'
    parts = []
    if 'noise' in verdict.gains:
        times = 1.0 / float(np.nanmedian(verdict.rests.ratio))
        parts.append(f'at rest the rates are {times:.1f} times quieter')
    if 'bias' in verdict.gains:
        raw, left = abs(verdict.heading.raw), verdict.heading.left
        if raw > SIGNIFICANT * left:
            parts.append(
                f'the bias turns the heading by some {per_minute(left)} deg/min instead of '
                f'{per_minute(raw)}'
            )
        else:
            of_motion = verdict.bias.source == BiasSource.MOTION
            part = 'what gravity shows of ' if of_motion else ''
            parts.append(f'{part}the bias is subtracted')
    if 'outliers' in verdict.gains:
        taken_out = 'was taken out' if verdict.outliers.confirmed == 1 else 'were taken out'
        parts.append(f'{counted(verdict.outliers.confirmed, "outlier")} {taken_out}')
    return f'It helped: {_listed(parts)}.'


def statements(verdict: Verdict) -> list[tuple[str, str]]:
    """Return what was found, one statement for each question: what it is about, and the text."""
    if all(verdict.silent):
        found = [('rates', f'no figures: {_why_silent(verdict)}')]
    else:
        found = [
            ('rest', _about_rest(verdict)),
            ('bias', _about_bias(verdict.bias, verdict.rests.needed)),
            ('heading', _about_heading(verdict)),
            ('outliers', _about_outliers(verdict)),
        ]
    for finding in verdict.findings:
        advice = f' -> {finding.advice}' if finding.advice else ''
        found.append(('unsound', f'{finding.text}{advice}'))
    lags = verdict.outcome != Outcome.HARMED and verdict.lagging > _LAG_SHARE
    if lags:
        text = (
            f'for {100.0 * verdict.lagging:.0f} % of the time the rates changed more than '
            f'method {verdict.method} expects'
        )
        found.append(('lag', text))
    if not (verdict.findings or lags or all(verdict.silent) or verdict.outcome == Outcome.HARMED):
        text = "nothing unsound was seen on the way; 'gyro_drift doctor' looks closer"
        found.append(('sound', text))
    return [(about, printable(text)) for about, text in found]


def as_text(verdict: Verdict, painted: Callable[[str, str], str] = lambda text, _: text) -> str:
    """Return the verdict for a terminal; `painted` gives lines the colour of an outcome."""
    lines = [painted(line, verdict.outcome) for line in textwrap.wrap(headline(verdict), _WIDTH)]
    for about, text in statements(verdict):
        lines += textwrap.wrap(
            text,
            _WIDTH,
            initial_indent=f'  {about:<{_INDENT - 2}}',
            subsequent_indent=' ' * _INDENT,
        )
    return '\n'.join(lines)


def per_minute(rate: float) -> str:
    """Return a rate in rad/s as text in degrees a minute."""
    digits = '.2g' if abs(rate) < 2.9e-3 else '.0f'
    return f'{np.degrees(rate) * _PER_MINUTE:{digits}}'


def _why_harmful(verdict: Verdict) -> str:
    """Return what the filter does wrong, and what to do about it."""
    what = []
    if verdict.misfit.lags:
        what.append(f'lags behind the motion for {100.0 * verdict.lagging:.0f} % of the time')
    if verdict.misfit.holds_motion_back:
        what.append(f'takes {100.0 * verdict.held_back:.0f} % of the motion for outliers')
    advice = 'Take the default method, adaptive.'
    if verdict.method == Parameters().method:
        advice = "Look on the page of 'gyro_drift report' whether the rates are full of spikes."
    return f'method {verdict.method} {_listed(what)}. {advice}'


def _why_useless(verdict: Verdict) -> str:
    if all(verdict.silent):
        return _why_silent(verdict)
    if in_degrees(verdict.findings):
        return IN_DEGREES
    why = []
    if not verdict.rests.count:
        why.append(f'{_why_no_rest(verdict)}, so there was no rest to learn the bias from')
    elif not verdict.bias.taken_off:
        why.append('bias.enabled is false')
    elif 'bias' not in verdict.gains:
        why.append('the bias is too small to be told from 0')
    if verdict.rests.count and 'noise' not in verdict.gains:
        known = np.isfinite(verdict.rests.raw_deviation).all()
        short = f'{"the rests were" if verdict.rests.count > 1 else "the rest was"} {_TOO_SHORT}'
        why.append('there is hardly any noise at rest to take away' if known else short)
    if 'outliers' not in verdict.gains:
        why.append(_why_no_outliers(verdict.outliers))
    return f'{_listed(why)}{_advice(verdict)}'


def _advice(verdict: Verdict) -> str:
    """Return the end of a sentence, and one that asks for a rest; empty where there was one."""
    if verdict.rests.count or _is_beyond(verdict) or starts_anew(verdict.findings):
        return ''
    seconds = time_to_stand(verdict.rests.needed)
    return (
        f'. Let it stand still for {seconds} at the start; if it did, '
        "'gyro_drift doctor' looks closer"
    )


# Where a bias comes from that is subtracted without a rest.
_UNSURE = {
    BiasSource.PROVISIONAL: 'from a time that was steady but not quite a rest',
    BiasSource.MOTION: 'as gravity has shown it in motion',
    BiasSource.GIVEN: 'kept from the recording before',
}


def _why_unsure(verdict: Verdict) -> str:
    """Return what is subtracted, and how little is known of it.

    It is the best guess there is, but the deviations leave room for a bias of zero.
    """
    bias = verdict.bias
    rates = by_axis(f'{np.degrees(rate):.3f}' for rate in bias.rates)
    known = by_axis(f'{np.degrees(deviation):.2g}' for deviation in bias.deviations)
    return (
        f'it subtracts a bias of {rates} deg/s, {_UNSURE[bias.source]}, and knows it to {known} '
        f'deg/s only{_advice(verdict)}'
    )


def _why_no_outliers(outliers: FlaggedOutliers) -> str:
    if outliers.confirmed:
        return 'what it flagged is too much to be outliers'
    if outliers.samples:
        return 'nothing that it flagged turned out to be an outlier'
    return 'no outlier came' if outliers.looked_for else f'outliers were {_NOT_LOOKED_FOR}'


def _is_beyond(verdict: Verdict) -> bool:
    """Tell whether what would be a rest has a rate that is too large for a bias."""
    return any(finding.name == 'beyond bias.max' for finding in verdict.findings)


def _why_no_rest(verdict: Verdict) -> str:
    if _is_beyond(verdict):
        return 'while the sensor was steady, its rate was beyond bias.max'
    if starts_anew(verdict.findings):
        return 'the filter starts anew all the time, as stamps lie gap_limit or more apart'
    seconds = verdict.received * verdict.period
    return why_no_rest(seconds, verdict.rests.least, verdict.received)


def _why_silent(verdict: Verdict) -> str:
    if all(text.startswith('dead') for text in verdict.silent):
        return 'all three axes are dead, each holds one value throughout'
    return 'no message had a usable rate on all axes'


def _about_rest(verdict: Verdict) -> str:
    rests = verdict.rests
    if not rests.count:
        return f'none: {_why_no_rest(verdict)}'
    text = (
        f'it stood still for {rests.seconds:.0f} of {verdict.sampled_seconds:.0f} s, in '
        f'{counted(rests.count, "rest")}'
    )
    # Other times, as of outliers, count the pauses.
    if verdict.seconds - verdict.sampled_seconds >= _PAUSE_SECONDS:
        text += f'; with its pauses the recording lasts for {verdict.seconds:.0f} s'
    passed_over = ''
    if rests.needed > _USUAL_REST:
        rate = f'{1.0 / verdict.period:.2g} Hz'
        passed_over = f'. At {rate} rests of less than {rests.needed} s may be passed over'
    if not np.isfinite(rests.ratio).any():
        known = np.isfinite(rests.raw_deviation).all()
        return f'{text}; {"there is no noise" if known else _TOO_SHORT}{passed_over}'
    shares = by_axis(
        f'{100.0 * ratio:.0f} %' if np.isfinite(ratio) else '-' for ratio in rests.ratio
    )
    return f'{text}; the noise falls to {shares} there{passed_over}'


def _about_bias(bias: Bias, needed: int) -> str:
    rates = by_axis(f'{np.degrees(rate):.3f}' for rate in bias.rates)
    sure = f'{np.degrees(float(bias.deviations.max())):.2g}'
    left_in = '' if bias.taken_off else '; it is left in, as bias.enabled is false'
    if _has_shown_too_much(bias):
        shown = by_axis(f'{np.degrees(rate):.3g}' for rate in bias.beyond_max)
        return (
            f'not known: while the sensor was steady, its rates were {shown} deg/s, beyond '
            'bias.max; if it did not turn there, that is its bias'
        )
    if bias.source == BiasSource.UNKNOWN:
        return f'not known: it needs {needed} s of rest; it may be anything up to {sure} deg/s'
    if bias.source == BiasSource.PROVISIONAL:
        return (
            f'provisional: {rates} deg/s, from a time since the start that was steady but not '
            f'quite a rest; known to {sure} deg/s{left_in}'
        )
    if bias.source == BiasSource.MOTION:
        each = by_axis(f'{np.degrees(deviation):.2g}' for deviation in bias.deviations)
        return (
            f'{rates} deg/s, as gravity has shown in motion; known to {each} deg/s, and least '
            f'about the vertical: {needed} s of rest show all of it{left_in}'
        )
    when = 'kept from the recording before'
    if bias.source == BiasSource.REST:
        known = bias.known_at
        when = 'found at rest' if known is None else f'found at rest after {known:.1f} s'
    if not bias.moved.any():
        return f'{rates} deg/s, {when}; at the end known to {sure} deg/s{left_in}'
    moves = f'after moves of up to {np.degrees(bias.moved.max()):.2g} deg/s'
    return f'{rates} deg/s at the end, {moves}, {when}; known to {sure} deg/s{left_in}'


def _has_shown_too_much(bias: Bias) -> bool:
    """Tell whether all that is known of the bias is that it is beyond bias.max, if it is one."""
    return bias.source == BiasSource.UNKNOWN and bool(np.isfinite(bias.beyond_max).all())


def _about_heading(verdict: Verdict) -> str:
    heading, bias = verdict.heading, verdict.bias
    sure = per_minute(heading.left)
    if _has_shown_too_much(bias):
        largest = per_minute(float(np.linalg.norm(bias.beyond_max)))
        return (
            f'drifts by up to {largest} deg/min, if it did not turn there, as a bias beyond '
            'bias.max is left in'
        )
    if bias.source == BiasSource.UNKNOWN:
        return f'drifts with the bias, by up to {sure} deg/min or so: the filter can not tell'
    if bias.source == BiasSource.MOTION:
        return (
            f'drifts by up to {sure} deg/min or so, with the bias about the vertical, of which '
            'motion shows little'
        )
    text = (
        f'the raw rates drift by {per_minute(abs(heading.raw))} +- {sure} deg/min about the '
        'vertical'
    )
    if not bias.taken_off:
        return f'{text}, and so do the filtered ones'
    text += f", the filtered ones by 0 +- {sure}, by the filter's own account"
    if abs(heading.before) > _VISIBLE:
        text += (
            f', after a turn of {abs(np.degrees(heading.before)):.1f} deg while the bias was not '
            'known'
        )
    scale = 0.0 if heading.calibrated else _SCALE * heading.turned
    # What is left is another error after each rest, so that it grows with their root only.
    left = heading.left * verdict.sampled_seconds / max(verdict.rests.count, 1) ** 0.5
    if scale > 5.0 * left and scale > 10.0 * _VISIBLE:
        text += (
            f'. It turned by {np.degrees(heading.turned):.0f} deg in all, so each percent that the '
            f"scale is off makes up to {np.degrees(scale):.0f} deg: 'gyro_drift calibrate'"
        )
    return text


def _about_outliers(verdict: Verdict) -> str:
    outliers, count = verdict.outliers, verdict.outliers.samples
    if not count:
        return 'none' if outliers.looked_for else _NOT_LOOKED_FOR
    if count == 1:
        where = 'at rest' if outliers.at_rest else 'in motion'
        when = '' if outliers.first is None else f' at {outliers.first:.1f} s'
        return f'1 sample flagged as an outlier, {where}{when}{_turned_out(outliers)}'
    text = (
        f'{counted(count, "sample")} flagged as outliers ({by_axis(outliers.axes.tolist())}), '
        f'{outliers.at_rest} of them at rest'
    )
    text += _turned_out(outliers)
    if outliers.first is None or outliers.last is None or outliers.busiest is None:
        return text
    text += f'; from {outliers.first:.1f} to {outliers.last:.1f} s'
    if outliers.in_busiest < count and outliers.in_busiest > 1:
        text += (
            f', most in the ten seconds from {outliers.busiest:.1f} s on ({outliers.in_busiest})'
        )
    return text


def _turned_out(outliers: FlaggedOutliers) -> str:
    """Return what the samples behind them showed of those that were no outliers, if any."""
    knocks = 'a knock' if outliers.knocks == 1 else 'knocks'
    undecided = outliers.samples - outliers.confirmed - outliers.motion - outliers.knocks
    whole = 'it' if outliers.samples == 1 else 'all'
    parts = [
        f'{whole if count == outliers.samples else count} {what}'
        for count, what in (
            (outliers.motion, 'turned out to be motion'),
            (outliers.knocks, f'turned out to be {knocks}, whose angle is given back'),
            (undecided, 'stayed undecided'),
        )
        if count
    ]
    return f'; {_listed(parts)}' if parts else ''


def _listed(parts: list[str]) -> str:
    """Return parts as a list in words, with a comma before the last one where figures may meet."""
    if len(parts) < 3:
        return ' and '.join(parts)
    return f'{", ".join(parts[:-1])}, and {parts[-1]}'
