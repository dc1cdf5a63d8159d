"""What `/diagnostics` tells of the input and of the filter, for the node and for `replay`."""

import math
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from gyro_drift_filter.bags.cdr import DiagnosticStatus
from gyro_drift_filter.bags.message_filter import MessageFilter
from gyro_drift_filter.core.bias import bias_variance
from gyro_drift_filter.core.filter import RANGE
from gyro_drift_filter.core.parameters import AXES

OK, WARN, ERROR, STALE = range(4)

NODE_NAME = 'gyro_drift_filter'


# Share of samples above which it is not the sample that is wrong, but the filter's idea of it.
_MANY_OUTLIERS = 0.5


@dataclass(frozen=True)
class _Counts:
    received: int = 0
    malformed: int = 0
    samples: int = 0
    beyond_range: int = 0
    unusable: tuple[int, ...] = (0, 0, 0)
    outliers: tuple[int, ...] = (0, 0, 0)
    divergences: tuple[int, ...] = (0, 0, 0)


@cache
def package_version() -> str:
    """Return the version of the installed package, or 'unknown' in a bare checkout."""
    try:
        return version('gyro_drift_filter')
    except PackageNotFoundError:
        return 'unknown'


class Health:
    """Report on a message filter at regular intervals."""

    def __init__(self, messages: MessageFilter, name: str = NODE_NAME) -> None:
        self._messages = messages
        self._name = name
        self._before = _Counts()

    def report(self, seconds: float) -> list[DiagnosticStatus]:
        """Return the status of the input and of the filter.

        Args:
            seconds: Time since the last report.
        """
        before, now = self._before, self._count()
        if now.samples < before.samples:  # the filter was reset
            before = replace(_Counts(), received=before.received, malformed=before.malformed)
        self._before = now
        return [self._input(before, now, seconds), self._filter(before, now)]

    def _count(self) -> _Counts:
        messages, counts = self._messages, self._messages.filter.state['counts']
        return _Counts(
            messages.received,
            messages.malformed,
            int(counts['samples']),
            int(counts['beyond_range']),
            tuple(counts['unusable'].tolist()),
            tuple(counts['outliers'].tolist()),
            tuple(self._messages.filter.state['paper']['divergences'].tolist()),
        )

    def _input(self, before: _Counts, now: _Counts, seconds: float) -> DiagnosticStatus:
        messages, state = self._messages, self._messages.filter.state
        clock, counts = state['clock'], state['counts']
        received = now.received - before.received
        samples = now.samples - before.samples
        level, message = OK, 'receiving'
        if received == 0:
            level, message = STALE, 'no message: is the driver running, and is the topic right?'
        elif now.malformed > before.malformed:
            level = ERROR
            message = f'messages refused, the last because {messages.last_malformed}'
        elif samples == 0:
            level = WARN
            message = (
                'no angular velocity reported (covariance starts with -1): messages are passed '
                'on unfiltered'
            )
        elif 2 * (now.beyond_range - before.beyond_range) > samples:
            level = WARN
            message = (
                f'rates stay above {RANGE:g} rad/s: the driver may publish degrees '
                'per second where REP-103 asks for radians'
            )
        elif now.unusable != before.unusable:
            level = WARN
            message = (
                'rates that are no usable number (NaN, infinite or above 1e6 rad/s): bridged by '
                'the prediction for as long as gap_limit, then nothing is published'
            )
        values = {
            'Actual frequency (Hz)': _number(received / seconds) if seconds > 0 else 'nan',
            'Sample period learned (s)': _number(clock['period']),
            'Events since startup': str(now.received),
            'Samples': str(now.samples),
            'Refused (malformed)': str(messages.malformed),
            'Refused (no usable rate yet)': str(counts['refused']),
            'Passed on (not reported)': str(messages.not_reported),
            'Repeats': str(counts['repeats']),
            'Gaps': str(clock['gaps']),
            'Missing samples bridged': str(clock['missing_samples']),
            'Restarts after a jump in time': str(clock['restarts']),
            'Zero stamps': str(clock['zero_stamps']),
            'Equal stamps': str(clock['same_stamps']),
            'Backward stamps': str(clock['backward_stamps']),
        }
        values |= _per_axis('Unusable rates bridged', counts['unusable'])
        return DiagnosticStatus(level, f'{self._name}: input', message, values)

    def _filter(self, before: _Counts, now: _Counts) -> DiagnosticStatus:
        state = self._messages.filter.state
        result = state['result']
        values = {
            'Method': self._messages.filter.parameters.method,
            'Version': package_version(),
        }
        values |= _per_axis('Outliers', state['counts']['outliers'])
        samples = max(1, now.samples - before.samples)
        recent = [(a - b) / samples for a, b in zip(now.outliers, before.outliers, strict=True)]
        values |= _per_axis('Outliers since last report (%)', [100.0 * share for share in recent])
        values |= _per_axis('Process noise Q ((rad/s)^2)', result['process_noise'])
        values |= _per_axis('Measurement noise R ((rad/s)^2)', result['measurement_noise'])
        bias = state['bias']
        deviations = [bias_variance(bias, axis) ** 0.5 for axis in range(3)]
        values |= _per_axis('Bias (rad/s)', bias['bias'])
        values |= _per_axis('Bias deviation (rad/s)', deviations if bias['known'] else _UNKNOWN)
        values['At rest'] = str(bool(bias['rest']['at_rest']))
        values['Time since rest (s)'] = _number(bias['rest_seconds'])
        values['Rests the bias was learned from'] = str(bias['packages'])
        values['Rests with a rate beyond bias.max'] = str(bias['beyond_max'])
        values['Slow turns told from rest'] = str(bias['turning'])
        values |= _per_axis('Divergences', now.divergences)
        level, message = OK, 'filtering'
        method = self._messages.filter.parameters.method
        if max(recent) > _MANY_OUTLIERS:
            level = WARN
            message = f'more than half of the samples count as outliers: {_REMEDIES[method]}'
        elif now.divergences != before.divergences:
            level, message = WARN, f'the filter diverged and started anew: {_REMEDIES[method]}'
        elif bias['beyond']:
            limit = math.degrees(self._messages.filter.parameters.bias_max)
            level = WARN
            message = (
                f'steady as at rest, but the rate is beyond bias.max ({limit:g} deg/s) and stays '
                'in: if it does not turn, raise bias.max, and have the sensor looked at'
            )
        return DiagnosticStatus(level, f'{self._name}: filter', message, values)


_UNKNOWN = (math.nan,) * 3
_METHOD_FOR_STANDSTILL = 'for a robot that moves, set method to adaptive; else raise epsilon'
_REMEDIES = {
    'kalman': _METHOD_FOR_STANDSTILL,
    'sage_husa': _METHOD_FOR_STANDSTILL,
    'adaptive': 'look at the raw rates; raise outlier.threshold or outlier.acceleration',
}


def _per_axis(key: str, values: Any) -> dict[str, str]:
    return {f'{key} {axis}': _number(v) for axis, v in zip(AXES, values, strict=True)}


def _number(value: float) -> str:
    if isinstance(value, float) and not math.isfinite(value):
        return 'nan'
    return f'{value:.6g}'
