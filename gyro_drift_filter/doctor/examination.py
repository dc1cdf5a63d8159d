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

"""All that is looked at in a recording, in the order of the page."""

import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.core.sensor_checks import AxisFault
from gyro_drift_filter.doctor.axes import carry_gravity, judge_axes
from gyro_drift_filter.doctor.clipping import is_clipped
from gyro_drift_filter.doctor.clocks import judge_log_clock
from gyro_drift_filter.doctor.covariances import Stated, judge_covariances
from gyro_drift_filter.doctor.evenness import judge_evenness
from gyro_drift_filter.doctor.findings import Finding, FindingVerdict, fault, sound, unknown
from gyro_drift_filter.doctor.live_rules import RuleLog, starts_anew
from gyro_drift_filter.doctor.publishers import judge_publishers
from gyro_drift_filter.doctor.reference import Reference, compare_turns, judge_reference
from gyro_drift_filter.doctor.repeats import judge_doubles, judge_repeats
from gyro_drift_filter.doctor.rests import (
    AtRest,
    judge_accelerometer,
    judge_resolution,
    judge_unrested_noise,
    look_at_rests,
)
from gyro_drift_filter.doctor.vibration import judge_vibration
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.quiet import SampleSpan
from gyro_drift_filter.identify.repeats import without_repeats
from gyro_drift_filter.identify.series import Stretch, Values, parts
from gyro_drift_filter.identify.timing import OneRate, Timing, learn_timing
from gyro_drift_filter.messages.telemetry import Telemetry
from gyro_drift_filter.phrases import by_axis, counted, time_to_stand, why_no_rest

# Stamps that are off by so many periods are taken for those of missing samples now and then.
_LOOSE = 0.2
_INVENTED_RATE = 'invented covariance of angular velocity'


@dataclass(frozen=True)
class Examined:
    """A recording of one Imu topic, n good messages, and what the filter learned from it.

    Attributes:
        stamps: (n,) in ns.
        log_times: (n,) in ns.
        rates: Three columns (n,) in rad/s, NaN where the filter uses no value either.
        accelerations: Three columns (n,) in m/s^2, NaN likewise.
        outliers: Three columns (n,), not 0 where the filter held the rate back.
        resting: (n,) not 0 where the filter takes the sensor to rest.
        stated: What the messages state of their covariances, in the order of QUANTITIES.
        references: Orientations in the same recording.
        connections: Publishers that it names for the topic.
        rules: What the rules of the live filter said.
        telemetry: Of the filter at the end.
        truncation_refuted: Whether motion has shown that counts are not cut towards zero.
    """

    stamps: Values
    log_times: Values
    rates: tuple[Values, ...]
    accelerations: tuple[Values, ...]
    outliers: tuple[Values, ...]
    resting: Values
    stated: tuple[Stated, Stated, Stated]
    references: tuple[Reference, ...]
    connections: int
    rules: RuleLog
    telemetry: Telemetry
    truncation_refuted: bool


# Findings go by their names: a rule of `/diagnostics` gives one its own name (`live_rules.py`), all
# others are named where they are made. `test_findings_named_in_tables_exist` looks for each.
# Rates or accelerations are in another unit, or may be.
OF_UNITS = {
    *('degrees', 'noise in degrees', 'unit of rates', 'beyond bias.max'),
    *('unit of acceleration', 'scale of acceleration', 'no gravity', 'beyond gravity'),
}
_OF_DEGREES = {'beyond bias.max', 'rests', 'clipped', 'contradicts gravity', _INVENTED_RATE}
# Of a fault, those that come of it by themselves: they are left out beside it.
CONSEQUENCES = {
    'degrees': {'noise in degrees', *_OF_DEGREES},
    'unit of rates': {'degrees', 'noise in degrees', *_OF_DEGREES},
    'noise in degrees': _OF_DEGREES,
    'axes': {'contradicts gravity'},
    'beyond bias.max': {'rests'},
    'slow sensor': {'rests'},
    'unit of acceleration': {
        *('no gravity', 'beyond gravity', 'invented covariance of linear acceleration'),
    },
    'scale of acceleration': {'no gravity'},
    'gravity': {'no gravity'},
    'repeated samples': {'repeats', 'vibration'},
    'doubled messages': {'repeats', 'shared stamps', 'vibration'},
    'publishers': {'vibration', 'low-pass', 'outliers', 'diverged', 'jitter', _INVENTED_RATE},
    'vibration': {'low-pass', _INVENTED_RATE},
    'resolution': {_INVENTED_RATE},
    'bursts': {'gaps'},
    # What they are held against is not the time.
    'standing stamps': {'bursts', 'clock drift', 'clock offset', 'jitter'},
}
# Questions about rates, which nothing answers where there are none, beside what follows from that.
_OF_RATES = {
    *('unusable', 'rests', 'axes', 'alive', 'range', 'truncation', 'low-pass', 'outliers'),
    *('repeats', 'resolution', 'vibration'),
}


def examine(seen: Examined) -> list[Finding]:
    """Return a line for each question: faults first, then what is open, then what is sound."""
    state, has_stamps = seen.telemetry, seen.telemetry.has_stamps
    stamps = seen.stamps if has_stamps else seen.log_times
    timing = _learned(stamps, seen.log_times)
    # Of stamps the filter has learned more. The log times it does not know.
    period = state.message_period if has_stamps or timing is None else timing.period
    rates = timing.stretches if timing else ()
    rests = look_at_rests(seen.resting, seen.rates, seen.accelerations, period)
    carried = carry_gravity(stamps, seen.rates, seen.accelerations, period, state.bias)
    findings = [
        judge_axes(carried if has_stamps else replace(carried, period=math.nan)),
        judge_accelerometer(rests, seen.accelerations),
    ]
    for reference in seen.references if has_stamps else ():
        turns = compare_turns(reference, stamps, seen.rates, seen.accelerations, state.bias)
        findings.append(judge_reference(reference, turns))
    if timing and rates:
        findings.append(_changed_rate(timing.rate_changes(stamps), rates))
    repeats = judge_repeats(seen.rates, seen.accelerations)
    evenness = (
        [_judge_evenness(seen, period, rates, repeats=repeats.is_fault)] if has_stamps else []
    )
    refuted = set()
    if any(finding.values.get('jitter_seconds', 0.0) > _LOOSE * period for finding in evenness):
        refuted |= {'gaps', 'wrong order'}
    if not any(state.clipped_calibrated) and not any(map(is_clipped, seen.rates, seen.outliers)):
        refuted.add('clipped')
    of_rules = seen.rules.findings(refuted, truncation_refuted=seen.truncation_refuted)
    findings += _with_constant_axes(of_rules, seen)
    findings += evenness
    if has_stamps:
        findings.append(judge_log_clock(stamps, seen.log_times))
    findings.append(judge_publishers(seen.rates, seen.connections))
    findings += judge_doubles(state.duplicates, len(seen.stamps))
    findings.append(repeats)
    findings.append(judge_resolution(np.array(state.count_size), rests))
    findings.append(judge_vibration(seen.rates, period))
    findings += judge_covariances(seen.stated, rests.noise, rests.force_noise)
    everything = SampleSpan(0, len(seen.stamps))
    recorded, rested = (
        _seconds(spans, rates, period) for spans in ((everything,), rests.stretches)
    )
    of_rests = _judge_rests(state, rests, recorded, rested)
    if not (of_rests.is_fault and starts_anew(findings)):
        findings.append(of_rests)
    if not state.segments and (noisy := judge_unrested_noise(seen.rates, seen.accelerations)):
        findings.append(noisy)
    if any(f.name == 'no usable rate' and f.values['share'] > 0.5 for f in findings):
        findings = [finding for finding in findings if finding.name not in _OF_RATES]
    return _sorted(findings)


def _learned(stamps: Values, log_times: Values) -> Timing | None:
    """Return how samples lie in time by these stamps (n,) in ns, None where they do not advance."""
    with suppress(IdentificationError):
        return learn_timing(stamps, log_times)
    return None


def _changed_rate(changes: str, rates: Sequence[OneRate]) -> Finding:
    return unknown(
        'sample rate',
        changes,
        'is that meant, as to save power at rest? Else look for what slows the driver. What '
        '`gyro_drift identify` finds holds at one of the rates only',
        {'changes': len(rates) - 1, 'rates': [1.0 / rate.period for rate in rates]},
    )


def _judge_evenness(
    seen: Examined, period: float, rates: Sequence[OneRate], *, repeats: bool
) -> Finding:
    """Say whether stamps are even, those of the longest time of one rate where there are more.

    Those of `repeats`, which are a fault of their own, are left out if all others are even: a
    driver may send a sample once more, with its stamp, in place of one that it has lost.
    """
    columns: tuple[Values, ...] = (seen.stamps, *seen.rates, *seen.accelerations)
    if rates:
        longest = max(rates, key=lambda rate: (rate.stop - rate.first) * rate.period)
        period = longest.period
        columns = tuple(Stretch(column, longest.first, longest.stop) for column in columns)
    found = judge_evenness(columns[0], period)
    if not repeats or found.name not in ('jitter', 'arrival stamps'):
        return found
    of_others = judge_evenness(without_repeats(columns[0], columns[1:]), period)
    if of_others.verdict != FindingVerdict.SOUND:
        return found
    return replace(of_others, text=f'{of_others.text}, but for those of repeated samples')


def _seconds(spans: Sequence[SampleSpan], rates: Sequence[OneRate], period: float) -> float:
    """Return how long samples last in s, each of them a period or that of its time."""
    if not rates:
        return sum(map(len, spans)) * period
    return sum(
        max(min(span.stop, rate.stop) - max(span.first, rate.first), 0) * rate.period
        for span in spans
        for rate in rates
    )


def _is_constant(values: Values) -> bool:
    return len(values) > 1 and all((part == values[:1]).all() for part in parts(values))


def _with_constant_axes(findings: list[Finding], seen: Examined) -> list[Finding]:
    """Return findings, with an open question of axes that have never changed and are not told."""
    faults = zip(AXES, seen.rates, seen.telemetry.faults, strict=True)
    untold = [
        axis for axis, rates, fault in faults if fault != AxisFault.DEAD and _is_constant(rates)
    ]
    # Else they are told with all others, as those of a sensor that hangs.
    if not untold or not {finding.name for finding in findings} & {'alive', 'dead axis'}:
        return findings
    question = unknown(
        'alive',
        f'always the same rate about {", ".join(untold)}: dead, a dead band in the driver, or '
        'steps that are coarser than the noise',
        'record the sensor turned by hand about each axis',
    )
    return [*(finding for finding in findings if finding.name != 'alive'), question]


def _sorted(findings: list[Finding]) -> list[Finding]:
    """Return findings, the faults first, without the consequences of others."""
    faults = {finding.name for finding in findings if finding.is_fault}
    consequences = {other for name in faults for other in CONSEQUENCES.get(name, ())}
    order = (FindingVerdict.FAULT, FindingVerdict.UNKNOWN, FindingVerdict.SOUND)
    left: dict[tuple[str, FindingVerdict], Finding] = {}
    for finding in findings:
        if not (finding.is_fault and finding.name in consequences):
            # Gravity and a rule may both tell of degrees: the first one says more.
            left.setdefault((finding.name, finding.verdict), finding)
    return sorted(left.values(), key=lambda finding: order.index(finding.verdict))


def _judge_rests(state: Telemetry, rests: AtRest, recorded: float, rested: float) -> Finding:
    """Say whether the sensor rested, for so many s, and what the bias and the noise are."""
    advice = (
        f'let it stand still for {time_to_stand(state.first_rest)} at the start of a recording, '
        'and at its end'
    )
    if not state.segments:
        what = why_no_rest(recorded, state.least_rest_seconds, state.samples)
        known = 'known for the time being only' if state.bias_provisional else 'not known'
        return fault('rests', f'{what}: its bias is {known}', advice)
    bias, noise = (np.degrees(values) for values in (state.bias, rests.noise))
    if np.isnan(noise).any():
        return unknown(
            'rests',
            f'too little to tell the noise: bias {_listed(bias)} deg/s, which is known to '
            f'{math.degrees(max(state.bias_deviation)):.2g} deg/s',
            advice,
        )
    return sound(
        'rests',
        f'{counted(len(rests.stretches), "rest")}, {rested:.0f} s together; '
        f'bias {_listed(bias)} deg/s, noise {_listed(noise)} deg/s',
        values={
            'rests': len(rests.stretches),
            'seconds': rested,
            'bias': list(state.bias),
            'bias_deviation': list(state.bias_deviation),
            'noise': rests.noise.tolist(),
        },
    )


def _listed(values: Floats) -> str:
    return by_axis(f'{value:.2g}' for value in values)
