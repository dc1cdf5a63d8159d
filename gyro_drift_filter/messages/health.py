"""What `/diagnostics` tells of the input and of the filter, for the node and for `replay`.

Two statuses with the keys of REP-107. Shares and rates are over the last `_WINDOW` reports; a level
that depends on one is raised at one limit and taken back at another, so that it does not flicker.
What a message says does not change from report to report: a change of it is logged. Numbers stand
in the values.
"""

import math
from collections import deque
from collections.abc import Mapping
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.core.parameters import AXES, Parameters
from gyro_drift_filter.core.sensor_checks import RANGE
from gyro_drift_filter.messages.diagnostics import DiagnosticStatus
from gyro_drift_filter.messages.telemetry import TELEMETRY, MessageReport, as_telemetry

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


_BEFORE_ALL = MessageReport(
    0, 0, '', 0, 0, '', Parameters(), as_telemetry(np.zeros(1, TELEMETRY))[0]
)


class _Span(NamedTuple):
    """What a report is on.

    Attributes:
        first: MessageReport at the begin of the window, and
        before: at the last report, and
        now: at present.
        seconds: From first to now.
    """

    first: MessageReport
    before: MessageReport
    now: MessageReport
    seconds: float


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
        # Time of reports in s, and what there was to tell.
        self._window = deque([(0.0, _BEFORE_ALL)], maxlen=_WINDOW + 1)
        self._outliers = _Alarm(0.1, 0.05)  # share of the samples
        # A filter that fits has a mean of 1; a third of that or so is no fault.
        self._overconfident = _Alarm(4.0, 2.5)
        self._inert = _Alarm(1.0 / 0.1, 1.0 / 0.2)
        self._rate_off = _Alarm(0.2, 0.1)  # share of the expected rate
        self._silent = True

    def judge(
        self, now: MessageReport, seconds: float, paced: bool = True
    ) -> list[DiagnosticStatus]:
        """Return the status of the input and of the filter.

        Args:
            now: What the message filter is like.
            seconds: Time since the last report.
            paced: Whether messages come at the pace of that time, so that the rate can be judged.
        """
        last, before = self._window[-1]
        if now.telemetry.samples < before.telemetry.samples:  # the filter was reset
            before = before._replace(telemetry=_BEFORE_ALL.telemetry)
            self._window.clear()
            self._window.append((last, before))
        began, first = self._window[0]
        if self._silent:
            # After a silence what came is no rate: a part of the time, or all that was kept.
            self._window.clear()
        self._window.append((last + seconds, now))
        self._silent = now.received == before.received
        span = _Span(first, before, now, last + seconds - began)
        # A partial second at either end is a small share of this.
        judged = paced and last + seconds - self._window[0][0] >= _LEAST_SECONDS
        return [self._input(span, judged), self._filter(span)]

    def _input(self, span: _Span, judged: bool) -> DiagnosticStatus:
        first, _, now, seconds = span
        rate = (now.received - first.received) / seconds if seconds > 0.0 else math.nan
        expected = _expected_rate(now)
        off = abs(rate / expected - 1.0) if judged else math.nan
        level, message = self._judge_input(span, off, rate < expected)
        state = now.telemetry
        values = {
            'Actual frequency (Hz)': rate,
            'Expected frequency (Hz)': expected,
            'Sample period learned (s)': state.period,
            'Events since startup': now.received,
            'Samples': state.samples,
            'Refused (malformed)': now.malformed,
            'Refused (no usable rate yet)': state.refused,
            'Passed on (not reported)': now.not_reported,
            'Repeats': state.repeats,
            'Gaps': state.gaps,
            'Missing samples bridged': state.missing_samples,
            'Restarts after a jump in time': state.restarts,
            'Zero stamps': state.zero_stamps,
            'Equal stamps': state.same_stamps,
            'Backward stamps': state.backward_stamps,
            'Changes of frame_id': now.frame_changes,
            'Last frame_id it changed to': now.frame,
            'Times stuck': state.times_stuck,
            'Unusable rates bridged': state.unusable,
            'Samples at the end of the range': state.clipped,
        }
        return DiagnosticStatus(level, self._name + INPUT, message, _listed(values))

    def _judge_input(self, span: _Span, off: float, fewer: bool) -> tuple[int, str]:
        """Return level and message; what is worst comes first."""
        first, before, now, _ = span
        parameters = now.parameters
        state, state_before, state_first = now.telemetry, before.telemetry, first.telemetry
        samples = state.samples - state_before.samples
        # What can't be judged is not off.
        is_off = self._rate_off.judge(0.0 if math.isnan(off) else off)
        if now.received == before.received:
            return STALE, 'no message: is the driver running, and is the topic right?'
        if now.malformed > before.malformed:
            return ERROR, f'messages refused, the last because {now.last_malformed}'
        if samples > 0 and state.refused - state_before.refused == samples:
            return (
                ERROR,
                'no usable rate on some axis (NaN, infinite or above 1e6 rad/s): nothing is '
                'published; look at the driver',
            )
        if samples > 0 and state.repeats - state_before.repeats == samples:
            return ERROR, 'the same message comes again and again: the sensor or its driver hangs'
        if state.stuck and state.all_zero:
            return (
                WARN,
                'all rates have been exactly 0 for a second or more: a dead band in the driver, or '
                'the sensor hangs',
            )
        if state.stuck:
            return (
                ERROR,
                'all values have stayed the same for a second or more: the sensor or its bus hangs '
                '(a simulated sensor without noise does this, too)',
            )
        if now.frame_changes > before.frame_changes:
            return WARN, 'frame_id changes from message to message: two sensors on one topic?'
        if samples == 0:
            return (
                WARN,
                'no angular velocity reported (covariance starts with -1): messages are passed '
                'on unfiltered',
            )
        if 2 * (state.beyond_range - state_before.beyond_range) > samples:
            return (
                WARN,
                f'rates stay above {RANGE:g} rad/s: the driver may publish degrees '
                'per second where REP-103 asks for radians',
            )
        if _grew(state.clipped, state_before.clipped):
            return (
                WARN,
                'a fast rate stays the same to the last bit: the end of the measuring range; choose'
                ' a larger one in the driver',
            )
        if _grew(state.unusable, state_before.unusable):
            return (
                WARN,
                'rates that are no usable number (NaN, infinite or above 1e6 rad/s): bridged by '
                'the prediction for as long as gap_limit, then nothing is published',
            )
        if state.restarts > state_before.restarts:
            return (
                WARN,
                'stamps jumped by more than gap_limit: the filter has started anew from there',
            )
        recent = state.samples - state_first.samples
        if (
            recent >= _FEW
            and state.backward_stamps - state_first.backward_stamps > _MANY_BACKWARD * recent
        ):
            return (
                WARN,
                'many stamps go backward: are there two publishers, or does the driver mix its '
                'messages up?',
            )
        if (
            parameters.sample_rate == 0.0
            and recent == state.zero_stamps - state_first.zero_stamps > 0
        ):
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
        if state.gaps > state_before.gaps:
            return WARN, 'gaps in the stamps: messages are lost before they come here'
        return OK, 'receiving'

    def _filter(self, span: _Span) -> DiagnosticStatus:
        state, state_first = span.now.telemetry, span.first.telemetry
        samples = state.samples - state_first.samples
        pairs = zip(state.outliers, state_first.outliers, strict=True)
        shares = [_share(a - b, samples) for a, b in pairs]
        sums = zip(
            state.nis_sum,
            state_first.nis_sum,
            state.nis_samples,
            state_first.nis_samples,
            strict=True,
        )
        surprise = [_share(a - b, c - d) for a, b, c, d in sums]
        level, message = self._judge_filter(span, shares, surprise)
        values = {
            'Method': span.now.parameters.method,
            'Version': package_version(),
            'Outliers': state.outliers,
            'Outliers of late (%)': [100.0 * share for share in shares],
            'Normalised innovation squared': surprise,
            'Process noise Q ((rad/s)^2)': state.process_noise,
            'Measurement noise R ((rad/s)^2)': state.measurement_noise,
            'Bias (rad/s)': state.bias,
            'Bias deviation (rad/s)': state.bias_deviation,
            'At rest': state.at_rest,
            'Time since rest (s)': state.rest_seconds,
            'Rests the bias was learned from': state.packages,
            'Rests with a rate beyond bias.max': state.beyond_max,
            'Slow turns told from rest': state.turning,
            'Divergences': state.divergences,
        }
        return DiagnosticStatus(level, self._name + FILTER, message, _listed(values))

    def _judge_filter(
        self, span: _Span, shares: list[float], surprise: list[float]
    ) -> tuple[int, str]:
        """Return level and message; what is worst comes first."""
        parameters, state = span.now.parameters, span.now.telemetry
        method = parameters.method
        many = self._outliers.judge(_largest(shares))
        overconfident = self._overconfident.judge(_largest(surprise))
        # Of noise that it has learned adaptive can't expect too much, but for a dead band, which
        # has none at rest. Nor does a stuck sensor tell anything.
        learned = method == 'adaptive' and not any(parameters.model_noise_deviation)
        tells = not learned and not state.stuck
        least = -_largest([-value for value in surprise])
        inert = self._inert.judge((1.0 / least if least else math.inf) if tells else 0.0)
        if _grew(state.divergences, span.before.telemetry.divergences):
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
        if state.beyond:
            limit = math.degrees(parameters.bias_max)
            return (
                WARN,
                f'steady as at rest, but the rate is beyond bias.max ({limit:g} deg/s) and stays '
                'in: if it does not turn, raise bias.max, and have the sensor looked at',
            )
        return OK, 'filtering'


def _expected_rate(report: MessageReport) -> float:
    """Return the rate in Hz that was given or learned, NaN before it is."""
    if report.parameters.sample_rate > 0.0:
        return report.parameters.sample_rate
    return 1.0 / report.telemetry.period if report.telemetry.blocks > 0 else math.nan


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


def _grew(counts: list[int], before: list[int]) -> bool:
    return any(now > then for now, then in zip(counts, before, strict=True))


def _share(part: float, whole: int) -> float:
    return part / whole if whole >= _FEW else math.nan


def _largest(values: list[float]) -> float:
    """Return the largest value, NaN where there is none."""
    return max([value for value in values if value == value], default=math.nan)


def _listed(values: Mapping[str, Any]) -> str:
    """Return values as `DiagnosticStatus` takes them; of a list one for each axis."""
    numbers: list[Any] = []
    for value in values.values():
        if type(value) is list:
            numbers += value
        else:
            numbers.append(value)
    return _form(
        tuple(values), tuple(map(type, values.values())), tuple(map(type, numbers))
    ) % tuple(numbers)


@cache
def _form(names: tuple[str, ...], kinds: tuple[type, ...], of_numbers: tuple[type, ...]) -> str:
    """Return how values of these names and types are shown, and the numbers in them."""
    keys = [
        f'{name} {axis}'.rstrip()
        for name, kind in zip(names, kinds, strict=True)
        for axis in (AXES if kind is list else ('',))
    ]
    shown = [{float: '%.6g', int: '%d'}.get(kind, '%s') for kind in of_numbers]
    pairs = zip((key.replace('%', '%%') for key in keys), shown, strict=True)
    return ''.join(f'{key}\0{form}\0' for key, form in pairs)
