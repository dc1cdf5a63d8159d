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

"""What the rules of `/diagnostics` said while the recording went through the filter."""

import math
from collections.abc import Callable, Iterable, Set
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.quantisation import SURE
from gyro_drift_filter.doctor.findings import Finding, fault, sound, unknown
from gyro_drift_filter.doctor.steady_rates import SteadyRates
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.input_rules import SLOW_LOW_PASS, WITHOUT_RATES, may_leave_gaps
from gyro_drift_filter.messages.rules import Rule
from gyro_drift_filter.messages.span import Span, usable_outliers
from gyro_drift_filter.messages.telemetry import Telemetry
from gyro_drift_filter.phrases import by_axis, counted, plain

# Of these the recording says nothing, or they are about the filter's settings.
LEFT_OUT = {'silent', 'lost', 'large innovations', 'small innovations', 'no bias for long'}
# The rates at the reports to which these apply tell more of them.
_RATED = {'beyond bias.max', 'no rest'}
# What is learned of the noise may pass through anything while it is learned: a low-pass shows for
# more than this share of the time.
_SETTLING_SHARE = 0.1
# As much as a scale factor that is off by so much, which is that of a good gyroscope.
_MISSING_SHARE = 1e-3
# Reports come each second while anything is recorded: in one of more s there was a pause, or a
# clock was set, and its messages are those of a second, or of a slow sensor.
_LONGEST_REPORT = 2.0
_USUAL_REPORT = 1.0


def starts_anew(findings: Iterable[Finding]) -> bool:
    """Tell whether the stamps let the filter find no rest, however long the sensor stands still."""
    return any(
        finding.name in ('slow sensor', 'always restarted') and finding.values['share'] > 0.5
        for finding in findings
    )


def is_truncation_refuted(filter_: Filter) -> bool:
    """Return whether motion has shown that counts are not cut towards zero."""
    return float(filter_.state['quantisation']['wide_zero']) < -0.5 * SURE


@dataclass
class Applied:
    """When a rule first applied, and for how long, in s; text and span are the last ones."""

    rule: Rule
    first: float
    seconds: float
    text: str
    span: Span


@dataclass
class RuleLog:
    """Watches a filter: which rules applied at its reports, about one a second.

    Attributes:
        applied: By name.
        last: The span of the last report; None before the first.
        seconds: From the start to the last report.
        judged_seconds: The same without pauses, in which nothing was recorded.
        rates: At the reports to which a rule of `_RATED` applied.
        bias_deviation: (3,) the least of a bias that was known, in rad/s; infinite without one.
    """

    applied: dict[str, Applied] = field(default_factory=dict)
    last: Span | None = None
    seconds: float = 0.0
    judged_seconds: float = 0.0
    rates: SteadyRates = field(default_factory=SteadyRates)
    bias_deviation: Floats = field(default_factory=lambda: np.full(3, np.inf))

    def take(self, imus: Any, log_times: Integers) -> None:
        """See messages (n,) IMU that were filtered."""
        self.rates.take(imus)

    def judge(self, span: Span, rules: Iterable[Rule], seconds: float) -> None:
        """Take a report in: its span, the rules that apply, and the time since the one before."""
        judged = seconds
        if seconds > _LONGEST_REPORT:
            judged = min(seconds, max(self._recorded_seconds(span), _USUAL_REPORT))
        for rule in rules:
            if rule.level == Level.OK or rule.name in LEFT_OUT:
                continue
            text = rule.message(span)
            entry = self.applied.setdefault(rule.name, Applied(rule, self.seconds, 0.0, text, span))
            entry.seconds += judged
            entry.text, entry.span = text, span
            if rule.name in _RATED:
                self.rates.note(rule.name, span.before.received, span.now.received)
        state = span.now.telemetry
        if state.bias_known:
            self.bias_deviation = np.minimum(self.bias_deviation, state.bias_deviation)
        self.seconds += seconds
        self.judged_seconds += judged
        self.last = span

    def _recorded_seconds(self, span: Span) -> float:
        """Return the time in s that the last messages stand for, at the pace of all before."""
        before = span.before.received
        if before < 2:
            return math.inf
        return (span.now.received - before) * self.judged_seconds / (before - 1)

    def findings(self, refuted: Set[str], *, truncation_refuted: bool) -> list[Finding]:
        """Return a line for each rule that applied, and for each question that none answered.

        Args:
            refuted: Rules that applied to a part of the recording wrongly, as the whole shows.
            truncation_refuted: Whether motion has shown that counts are not cut towards zero.
        """
        span = self.last
        if span is None:
            return []
        state = span.now.telemetry
        refuted = set(refuted)
        if not state.gaps:
            # It has taken them all back. A driver that lowers its rate seems to lose every
            # second message for the first twenty.
            refuted.add('gaps')
        # Whatever a bias may be, it scatters by no more than its limit: the body has turned.
        if (self.rates.deviation('no rest') > span.now.parameters.bias_max).any():
            refuted.add('no rest')
        # A sensor keeps its low-pass: the noise of a later rest would show it, too. A motor that
        # runs, or wind that sways the body, looks like one in one rest only.
        if min(state.noise_blocks) > 0 and not span.low_pass < SLOW_LOW_PASS:
            refuted.add('low-pass')
        if not self._turns_by_counts(state):
            refuted.add('truncated')
        if 'slow sensor' in self.applied:
            refuted |= {'always restarted', 'restarted', 'gaps'}
        found = [
            self._fault(entry, span)
            for name, entry in self.applied.items()
            if name not in refuted
            and (name != 'low-pass' or entry.seconds > _SETTLING_SHARE * self.judged_seconds)
        ]
        missing = state.missing_samples / max(state.samples, 1)
        reported = {'gaps', 'wrong order'} & (refuted | self.applied.keys())
        if not reported and missing > _MISSING_SHARE:
            without_rates = may_leave_gaps(span.now.not_reported, state.missing_samples)
            cause = f'{WITHOUT_RATES}, or' if without_rates else 'messages'
            found.append(
                fault(
                    'gaps',
                    f'{_figures("gaps", span)}: {cause} are lost before they are recorded',
                    _ADVICE['gaps'],
                    {'gaps': state.gaps, 'missing_samples': state.missing_samples},
                )
            )
        faults = {finding.name for finding in found}
        truncation = self._about_truncation(span, refuted=truncation_refuted)
        found += [
            finding for names, finding in _sound(span, truncation) if not faults.intersection(names)
        ]
        return found

    def _turns_by_counts(self, state: Telemetry) -> bool:
        """Return whether half a count, if it is cut off, turns more than the bias that is left in.

        The bias is less and less certain from one rest to the next: its best deviation counts.
        """
        known = bool(np.isfinite(self.bias_deviation).all())
        return not known or bool((0.5 * np.array(state.count_size) > self.bias_deviation).any())

    def _about_truncation(self, span: Span, *, refuted: bool) -> Finding:
        state = span.now.telemetry
        if not any(state.count_size):
            return sound('truncation', 'no counts are seen that could be cut towards zero')
        if state.truncated and not self._turns_by_counts(state):
            error = math.degrees(float(self.bias_deviation.max()))
            return sound(
                'truncation',
                f'counts of {_count(state)} are cut towards zero, which turns less than the error '
                f'of the bias, {error:.2g} deg/s',
            )
        if refuted:
            return sound('truncation', 'counts are not cut towards zero')
        return unknown(
            'truncation', 'neither rest nor motion tells whether counts are cut towards zero'
        )

    def _fault(self, entry: Applied, span: Span) -> Finding:
        """Return the line of a rule that applied."""
        name = entry.rule.name
        text, _, advice = entry.text.partition(': ')
        figures = _figures(name, entry.span if name == 'low-pass' else span)
        of_all = f'{entry.seconds:.0f} of {self.judged_seconds:.0f} s'
        when = f'for {of_all}, first at {entry.first:.0f} s'
        return fault(
            name,
            f'{text} ({"; ".join(part for part in (figures, when) if part)})',
            _of_times(name, span) or _advice(name, advice),
            {
                'seconds': entry.seconds,
                'first_at': entry.first,
                'share': entry.seconds / max(self.judged_seconds, entry.seconds, 1e-9),
            },
        )


# Where the advice to who runs the filter is none to who has a recording.
_ADVICE = {
    'truncated': 'have the driver round. This filter finds it and undoes it (input.quantisation: '
    'auto); others turn by it',
    'gaps': 'look for what loses them: a slow disk, a full queue, a wireless link, best-effort QoS',
    'restarted': 'is the recording made of several, or was a clock set? From there to the next '
    'rest the bias is uncertain',
    'outliers': 'look at the rates for spikes: a bad cable, a shared bus, knocks. If motion '
    'was flagged, set method to adaptive, or raise outlier.acceleration if it is adaptive',
    'diverged': 'look at the rates for spikes: a bad cable, a shared bus, knocks',
    'unusable': 'have the driver leave a message out where a reading fails',
    'taken for a turn': 'if it stood there, its bias changes faster than bias.random_walk says: '
    'raise that parameter',
    'beyond bias.max': 'are the rates in deg/s (REP-103 asks for rad/s)? If they are not and it '
    'does not turn there, have the sensor looked at',
}


def _advice(name: str, live: str) -> str:
    """Return what to do about a rule that has an advice for who runs the filter."""
    advice = _ADVICE.get(name, live)
    return f'{WITHOUT_RATES}; if it is not that: {advice}' if WITHOUT_RATES in live else advice


# How to stamp where nobody does, or not in this unit.
_STAMPING = {
    'zero stamps': 'stamp the messages in the driver',
    'standing stamps': 'stamp each message with the time of its measurement, in seconds and '
    'nanoseconds',
}


def _of_times(name: str, span: Span) -> str:
    """Return what to do about stamps that tell no time, with the rate that the log times tell.

    The oscillator of a gyroscope is off by a percent or so, so that more digits say nothing.
    """
    if name not in _STAMPING:
        return ''
    if span.now.parameters.sample_rate > 0.0:
        return _STAMPING[name]
    rate = ''
    if math.isfinite(span.sensor_rate):
        rate = f': {float(f"{span.sensor_rate:.3g}"):g}'
    return f'{_STAMPING[name]}, or set sample_rate{rate}'


_FIGURES: dict[str, Callable[[Span], str]] = {
    'gaps': lambda span: (
        f'{counted(span.now.telemetry.gaps, "gap")}, '
        f'{counted(span.now.telemetry.missing_samples, "sample")} missing'
    ),
    'clipped': lambda span: f'samples: {by_axis(span.now.telemetry.clipped)}',
    'unusable': lambda span: f'samples: {by_axis(span.now.telemetry.unusable)}',
    'repeated samples': lambda span: (
        f'{100.0 * span.now.telemetry.not_measured / max(span.now.telemetry.samples, 1):.0f} % of '
        'the samples'
    ),
    'low-pass': lambda span: f'about {span.low_pass:.2g} Hz',
    'truncated': lambda span: f'a count is {_count(span.now.telemetry)}',
    'backward': lambda span: f'{span.now.telemetry.backward_stamps} stamps',
    'wrong order': lambda span: f'{span.now.telemetry.backward_stamps} stamps go backward',
    'restarted': lambda span: counted(span.now.telemetry.restarts, 'time'),
    'not reported': lambda span: (
        f'{span.now.not_reported} of {span.now.received} messages, '
        f'{plain(100.0 * span.now.not_reported / max(span.now.received, 1), 2)} %'
    ),
    'malformed': lambda span: counted(span.now.malformed, 'message'),
    'changing frame': lambda span: counted(span.now.frame_changes, 'time'),
}


def _figures(name: str, span: Span) -> str:
    return _FIGURES[name](span) if name in _FIGURES else ''


def _count(state: Telemetry) -> str:
    return f'{math.degrees(max(state.count_size)):.3g} deg/s'


def _rate(span: Span) -> str:
    known = math.isfinite(span.expected_rate)
    return f'{span.expected_rate:.4g} Hz' if known else 'too short to know the rate'


def _sound(span: Span, truncation: Finding) -> list[tuple[set[str], Finding]]:
    """Return for each question the rules that would answer it, and the line where none does."""
    now, state = span.now, span.now.telemetry
    without = f', {now.not_reported} of them without angular velocity' if now.not_reported else ''
    return [
        (
            {'malformed', 'not reported', 'no usable rate', 'unusable', 'changing frame'},
            sound(
                'messages',
                f'{counted(now.received, "message")}, all whole{without}, frame '
                f'{now.frame or "unnamed"}',
            ),
        ),
        (
            {'zero', 'stuck', 'repeated', 'frozen axis', 'dead axis'},
            sound('alive', 'all axes live'),
        ),
        (
            {'clipped', 'degrees', 'noise in degrees'},
            sound('range', 'no rate is at the end of the range'),
        ),
        ({'truncated'}, truncation),
        ({'low-pass'}, _about_low_pass(span)),
        (
            {'outliers', 'diverged'},
            sound('outliers', f'samples flagged: {by_axis(usable_outliers(state))}'),
        ),
        (
            {
                *('gaps', 'restarted', 'always restarted', 'backward', 'wrong order'),
                *('zero stamps', 'standing stamps', 'wrong rate'),
            },
            sound(
                'stamps',
                f'{_rate(span)}, {_figures("gaps", span)}, '
                f'{counted(state.backward_stamps, "stamp")} backward',
            ),
        ),
    ]


def _about_low_pass(span: Span) -> Finding:
    if min(span.now.telemetry.noise_blocks) == 0:
        return unknown('low-pass', 'without a rest the noise is not known, nor its low-pass')
    if math.isnan(span.low_pass):
        return sound('low-pass', 'the noise has passed no slow low-pass')
    return sound('low-pass', f'the noise has passed a low-pass of {span.low_pass:.2g} Hz')
