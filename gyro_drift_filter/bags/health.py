"""What `/diagnostics` tells of the input and of the filter, for the node and for `replay`.

Two statuses with the keys of REP-107. Shares and rates are over the last `_WINDOW` reports; a level
that depends on one is raised at one limit and taken back at another, so that it does not flicker.
What a message says does not change from report to report: a change of it is logged. Numbers stand
in the values.
"""

import math
from collections import deque
from collections.abc import Sequence
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.bags.cdr import DiagnosticStatus
from gyro_drift_filter.bags.message_filter import Vitals
from gyro_drift_filter.core.bias import bias_deviation
from gyro_drift_filter.core.filter import RANGE
from gyro_drift_filter.core.parameters import AXES, Parameters

OK, WARN, ERROR, STALE = range(4)

NODE_NAME = 'gyro_drift_filter'
# The names of the statuses, behind that of the node.
INPUT, FILTER = ': input', ': filter'

# Reports, one a second, that shares and rates are taken over.
_WINDOW = 10
_LEAST_SECONDS = 5.0  # of the window, to judge a rate
_MANY_BACKWARD = 0.05  # share of the samples
# Samples in the window below which shares tell nothing.
_FEW = 200


class _Counts(NamedTuple):
    seconds: float = 0.0
    received: int = 0
    malformed: int = 0
    samples: int = 0
    repeats: int = 0
    refused: int = 0
    backward: int = 0
    zero_stamps: int = 0
    gaps: int = 0
    restarts: int = 0
    frames: int = 0
    beyond_range: int = 0
    unusable: int = 0
    clipped: int = 0
    outliers: tuple[int, ...] = (0, 0, 0)
    nis_sum: tuple[float, ...] = (0.0, 0.0, 0.0)
    nis_samples: tuple[int, ...] = (0, 0, 0)
    divergences: tuple[int, ...] = (0, 0, 0)


@cache
def package_version() -> str:
    """Return the version of the installed package, or 'unknown' in a bare checkout."""
    try:
        return version('gyro_drift_filter')
    except PackageNotFoundError:
        return 'unknown'


class _Alarm:
    """A level with hysteresis: raised beyond one limit, taken back within another."""

    def __init__(self, raised_at: float, cleared_at: float) -> None:
        self._raised_at, self._cleared_at = raised_at, cleared_at
        self._raised = False

    def judge(self, value: float) -> bool:
        """Return whether the alarm stands; NaN leaves it as it is."""
        if value > self._raised_at:
            self._raised = True
        elif value < self._cleared_at:
            self._raised = False
        return self._raised


class Health:
    """Report on a message filter at regular intervals."""

    def __init__(self, name: str = NODE_NAME) -> None:
        self._name = name
        self._window = deque([_Counts()], maxlen=_WINDOW + 1)
        self._outliers = _Alarm(0.1, 0.05)  # share of the samples
        # A filter that fits has a mean of 1; a third of that or so is no fault.
        self._overconfident = _Alarm(4.0, 2.5)
        self._inert = _Alarm(1.0 / 0.1, 1.0 / 0.2)
        self._rate_off = _Alarm(0.2, 0.1)  # share of the expected rate
        self._silent = True

    def report(self, vitals: Vitals, seconds: float, paced: bool = True) -> list[DiagnosticStatus]:
        """Return the status of the input and of the filter.

        Args:
            vitals: What the message filter is like.
            seconds: Time since the last report.
            paced: Whether messages come at the pace of that time, so that the rate can be judged.
        """
        before = self._window[-1]
        counts, clock = _plain(vitals.state['counts']), _plain(vitals.state['clock'])
        now = _count(before.seconds + seconds, vitals, counts, clock)
        if now.samples < before.samples:  # the filter was reset
            before = _Counts(
                before.seconds, before.received, before.malformed, frames=before.frames
            )
            self._window.clear()
            self._window.append(before)
        first = self._window[0]
        if self._silent:
            # After a silence what came is no rate: a part of the time, or all that was kept.
            self._window.clear()
        self._window.append(now)
        self._silent = now.received == before.received
        return [
            self._input(vitals, first, before, now, counts, clock, paced),
            self._filter(vitals, first, before, now),
        ]

    def _input(
        self,
        vitals: Vitals,
        first: _Counts,
        before: _Counts,
        now: _Counts,
        counts: dict[str, Any],
        clock: dict[str, Any],
        paced: bool,
    ) -> DiagnosticStatus:
        seconds = now.seconds - first.seconds
        rate = (now.received - first.received) / seconds if seconds > 0.0 else math.nan
        expected = _expected_rate(vitals.parameters, clock)
        # A partial second at either end is a small share of this.
        known = paced and self._window[-1].seconds - self._window[0].seconds >= _LEAST_SECONDS
        off = abs(rate / expected - 1.0) if known else math.nan
        level, message = self._judge_input(vitals, first, before, now, off, rate < expected)
        values = {
            'Actual frequency (Hz)': f'{rate:.6g}',
            'Expected frequency (Hz)': f'{expected:.6g}',
            'Sample period learned (s)': f'{clock["period"]:.6g}',
            'Events since startup': str(now.received),
            'Samples': str(now.samples),
            'Refused (malformed)': str(vitals.malformed),
            'Refused (no usable rate yet)': str(counts['refused']),
            'Passed on (not reported)': str(vitals.not_reported),
            'Repeats': str(counts['repeats']),
            'Gaps': str(clock['gaps']),
            'Missing samples bridged': str(clock['missing_samples']),
            'Restarts after a jump in time': str(clock['restarts']),
            'Zero stamps': str(clock['zero_stamps']),
            'Equal stamps': str(clock['same_stamps']),
            'Backward stamps': str(clock['backward_stamps']),
            'Changes of frame_id': str(now.frames),
            'Last frame_id it changed to': vitals.frame,
            'Times stuck': str(counts['stuck']),
            **_per_axis(
                {
                    'Unusable rates bridged': counts['unusable'],
                    'Samples at the end of the range': counts['clipped'],
                },
                '%d',
            ),
        }
        return DiagnosticStatus(level, self._name + INPUT, message, values)

    def _judge_input(
        self,
        vitals: Vitals,
        first: _Counts,
        before: _Counts,
        now: _Counts,
        off: float,
        fewer: bool,
    ) -> tuple[int, str]:
        """Return level and message; what is worst comes first."""
        state, parameters = vitals.state, vitals.parameters
        samples = now.samples - before.samples
        # What can't be judged is not off.
        is_off = self._rate_off.judge(0.0 if math.isnan(off) else off)
        if now.received == before.received:
            return STALE, 'no message: is the driver running, and is the topic right?'
        if now.malformed > before.malformed:
            return ERROR, f'messages refused, the last because {vitals.last_malformed}'
        if samples > 0 and now.refused - before.refused == samples:
            return (
                ERROR,
                'no usable rate on some axis (NaN, infinite or above 1e6 rad/s): nothing is '
                'published; look at the driver',
            )
        if samples > 0 and now.repeats - before.repeats == samples:
            return ERROR, 'the same message comes again and again: the sensor or its driver hangs'
        if state['stuck'] and not state['measured'].any():
            return (
                WARN,
                'all rates have been exactly 0 for a second or more: a dead band in the driver, or '
                'the sensor hangs',
            )
        if state['stuck']:
            return (
                ERROR,
                'all values have stayed the same for a second or more: the sensor or its bus hangs '
                '(a simulated sensor without noise does this, too)',
            )
        if now.frames > before.frames:
            return WARN, 'frame_id changes from message to message: two sensors on one topic?'
        if samples == 0:
            return (
                WARN,
                'no angular velocity reported (covariance starts with -1): messages are passed '
                'on unfiltered',
            )
        if 2 * (now.beyond_range - before.beyond_range) > samples:
            return (
                WARN,
                f'rates stay above {RANGE:g} rad/s: the driver may publish degrees '
                'per second where REP-103 asks for radians',
            )
        if now.clipped > before.clipped:
            return (
                WARN,
                'a fast rate stays the same to the last bit: the end of the measuring range; choose'
                ' a larger one in the driver',
            )
        if now.unusable != before.unusable:
            return (
                WARN,
                'rates that are no usable number (NaN, infinite or above 1e6 rad/s): bridged by '
                'the prediction for as long as gap_limit, then nothing is published',
            )
        if now.restarts > before.restarts:
            return (
                WARN,
                'stamps jumped by more than gap_limit: the filter has started anew from there',
            )
        recent = now.samples - first.samples
        if recent >= _FEW and now.backward - first.backward > _MANY_BACKWARD * recent:
            return (
                WARN,
                'many stamps go backward: are there two publishers, or does the driver mix its '
                'messages up?',
            )
        if parameters.sample_rate == 0.0 and recent == now.zero_stamps - first.zero_stamps > 0:
            return WARN, 'the driver does not stamp (all stamps are 0): set sample_rate'
        if is_off:
            less = 'fewer' if fewer else 'more'
            if parameters.sample_rate > 0.0:
                return WARN, f'{less} messages come than sample_rate says: set it right, or to 0'
            cause = 'are some lost on the way?' if fewer else 'are there two publishers?'
            return (
                WARN,
                f'{less} messages come than their stamps say: {cause} Or is a bag played at '
                'another speed?',
            )
        if now.gaps > before.gaps:
            return WARN, 'gaps in the stamps: messages are lost before they come here'
        return OK, 'receiving'

    def _filter(
        self, vitals: Vitals, first: _Counts, before: _Counts, now: _Counts
    ) -> DiagnosticStatus:
        state, method = vitals.state, vitals.parameters.method
        result, bias = state['result'], state['bias']
        samples = now.samples - first.samples
        shares = [_share(a - b, samples) for a, b in zip(now.outliers, first.outliers, strict=True)]
        pairs = zip(now.nis_sum, first.nis_sum, now.nis_samples, first.nis_samples, strict=True)
        surprise = [_share(a - b, c - d) for a, b, c, d in pairs]
        deviation = bias_deviation(bias).tolist() if bias['known'] else _UNKNOWN
        numbers = {
            'Outliers of late (%)': [100.0 * share for share in shares],
            'Normalised innovation squared': surprise,
            'Process noise Q ((rad/s)^2)': result['process_noise'].tolist(),
            'Measurement noise R ((rad/s)^2)': result['measurement_noise'].tolist(),
            'Bias (rad/s)': bias['bias'].tolist(),
            'Bias deviation (rad/s)': deviation,
        }
        values = {
            'Method': method,
            'Version': package_version(),
            **_per_axis({'Outliers': now.outliers}, '%d'),
            **_per_axis(numbers, '%.6g'),
            'At rest': str(bool(bias['rest']['at_rest'])),
            'Time since rest (s)': f'{bias["rest_seconds"]:.6g}',
            'Rests the bias was learned from': str(bias['packages']),
            'Rests with a rate beyond bias.max': str(bias['beyond_max']),
            'Slow turns told from rest': str(bias['turning']),
            **_per_axis({'Divergences': now.divergences}, '%d'),
        }
        level, message = self._judge_filter(vitals, before, now, shares, surprise)
        return DiagnosticStatus(level, self._name + FILTER, message, values)

    def _judge_filter(
        self,
        vitals: Vitals,
        before: _Counts,
        now: _Counts,
        shares: list[float],
        surprise: list[float],
    ) -> tuple[int, str]:
        """Return level and message; what is worst comes first."""
        state, parameters = vitals.state, vitals.parameters
        method = parameters.method
        many = self._outliers.judge(_largest(shares))
        overconfident = self._overconfident.judge(_largest(surprise))
        # Of noise that it has learned adaptive can't expect too much, but for a dead band, which
        # has none at rest. Nor does a stuck sensor tell anything.
        learned = method == 'adaptive' and not any(parameters.model_noise_deviation)
        tells = not learned and not state['stuck']
        least = -_largest([-value for value in surprise])
        inert = self._inert.judge((1.0 / least if least else math.inf) if tells else 0.0)
        if now.divergences != before.divergences:
            return WARN, f'the filter diverged and started anew: {_REMEDIES[method]}'
        if many:
            return WARN, f'many samples count as outliers: {_REMEDIES[method]}'
        if overconfident:
            return (
                WARN,
                f'innovations are much larger than the filter expects: {_OVERCONFIDENT[method]}',
            )
        if inert:
            return (
                WARN,
                'innovations are far smaller than the filter expects, so that no outlier will be '
                f'found: {_INERT[method]}',
            )
        if state['bias']['beyond']:
            limit = math.degrees(parameters.bias_max)
            return (
                WARN,
                f'steady as at rest, but the rate is beyond bias.max ({limit:g} deg/s) and stays '
                'in: if it does not turn, raise bias.max, and have the sensor looked at',
            )
        return OK, 'filtering'


def _count(
    seconds: float, vitals: Vitals, counts: dict[str, Any], clock: dict[str, Any]
) -> _Counts:
    return _Counts(
        seconds,
        vitals.received,
        vitals.malformed,
        counts['samples'],
        counts['repeats'],
        counts['refused'],
        clock['backward_stamps'],
        clock['zero_stamps'],
        clock['gaps'],
        clock['restarts'],
        vitals.frame_changes,
        counts['beyond_range'],
        sum(counts['unusable']),
        sum(counts['clipped']),
        tuple(counts['outliers']),
        tuple(counts['nis_sum']),
        tuple(counts['nis_samples']),
        tuple(vitals.state['paper']['divergences'].tolist()),
    )


def _expected_rate(parameters: Parameters, clock: dict[str, Any]) -> float:
    """Return the rate in Hz that was given or learned, NaN before it is."""
    if parameters.sample_rate > 0.0:
        return parameters.sample_rate
    return 1.0 / clock['period'] if clock['blocks'] > 0 else math.nan


_UNKNOWN = (math.nan,) * 3
_METHOD_FOR_STANDSTILL = 'for a robot that moves, set method to adaptive; else raise epsilon'
_REMEDIES = {
    'kalman': _METHOD_FOR_STANDSTILL,
    'sage_husa': _METHOD_FOR_STANDSTILL,
    'adaptive': 'look at the raw rates; raise outlier.threshold or outlier.acceleration',
}
_MODEL_TOO_SMALL = (
    'it lags behind motion; set method to adaptive, or raise model.process_noise and '
    'model.measurement_noise (gyro_drift identify finds them)'
)
_OVERCONFIDENT = {
    'kalman': _MODEL_TOO_SMALL,
    'sage_husa': _MODEL_TOO_SMALL,
    'adaptive': 'is it a vibration? Leave it at rest for a second so that it learns its noise, or '
    'set model.noise_deviation',
}
_MODEL_TOO_LARGE = (
    'lower model.process_noise and model.measurement_noise (gyro_drift identify finds them)'
)
_INERT = {
    'kalman': _MODEL_TOO_LARGE,
    'sage_husa': _MODEL_TOO_LARGE,
    'adaptive': 'set model.noise_deviation lower, or to 0',
}


def _plain(record: Any) -> dict[str, Any]:
    """Return a record in Python's own numbers and lists, which are faster to show than numpy's."""
    values = dict(zip(record.dtype.names, record.item(), strict=True))
    for name in _vectors(record.dtype):
        values[name] = values[name].tolist()
    return values


@cache
def _vectors(record: np.dtype[Any]) -> tuple[str, ...]:
    """Return the names of the fields of a record that are arrays."""
    return tuple(name for name in record.names or () if record[name].subdtype)


def _share(part: float, whole: int) -> float:
    return part / whole if whole >= _FEW else math.nan


def _largest(values: list[float]) -> float:
    """Return the largest value, NaN where there is none."""
    return max((value for value in values if value == value), default=math.nan)


@cache
def _axis_keys(keys: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(f'{key} {axis}' for key in keys for axis in AXES)


@cache
def _layout(form: str, count: int) -> str:
    return ' '.join([form] * count)


def _per_axis(numbers: dict[str, Sequence[float]], form: str) -> dict[str, str]:
    """Return a text for each axis of each key, all made at once as that is faster."""
    values = tuple(chain.from_iterable(numbers.values()))
    texts = (_layout(form, len(values)) % values).split(' ')
    return dict(zip(_axis_keys(tuple(numbers)), texts, strict=True))
