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

"""The whole identification of one recording: rests, bias, tests, models, filter parameters."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.core.sample import LARGEST_RATE
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.allan import Allan, allan_deviation
from gyro_drift_filter.identify.checks import (
    Check,
    check_normality,
    check_quantisation,
    check_stationarity,
    check_zero_mean,
    dead_value,
    require_noise,
)
from gyro_drift_filter.identify.models import (
    ORDERS,
    ArmaFit,
    DriftAndWhite,
    FilterNoise,
    Order,
    choose,
    fit_arma,
    fit_drift_and_white,
    fit_filter_noise,
    paper_noise,
)
from gyro_drift_filter.identify.preprocess import Preprocessed, preprocess
from gyro_drift_filter.identify.quiet import (
    SHORTEST_QUIET,
    SHORTEST_SECONDS,
    Quiet,
    SampleSpan,
    find_quiet,
)
from gyro_drift_filter.identify.repeats import Repeats, count_repeats
from gyro_drift_filter.identify.series import (
    Stored,
    Stretch,
    Values,
    columns,
    mean_square,
    parts,
)
from gyro_drift_filter.identify.timing import Timing, learn_timings
from gyro_drift_filter.identify.tones import Tone, find_tones
from gyro_drift_filter.phrases import counted, named_axes, plain, rounded_down, without_rate

SHORT_QUIET = 60.0  # s: below that a warning
# The models are fitted to spans of at least this many samples, where there is one.
_SHORTEST_FITTED = 500
# Losses below this are left unsaid: they change a filtered deviation by half of it.
_MATERIAL_LOSS = 0.01
# White noise of which this share is repeated seems to have a correlation of as much.
_MATERIAL_REPEATS = 0.02


@dataclass(frozen=True)
class AxisModel:
    """What is known of one axis; rad/s and (rad/s)^2.

    Attributes:
        preprocessed: Bias, trend, outliers and what is left.
        checks: What the model assumes, tested.
        fits: ARMA models, the paper's Table 1.
        chosen: The one that is adequate.
        lost: Share of the noise's variance that the chosen model predicts and AR(1) does not.
        description: AR(1) plus white noise.
        phi: Of the AR(1) that the filter takes.
        noise: Q and R for the filter.
        deviation: Standard deviation of the noise at rest.
        allan: Allan deviation.
        tones: Sines in the noise.
    """

    preprocessed: Preprocessed
    checks: tuple[Check, ...]
    fits: tuple[ArmaFit, ...]
    chosen: ArmaFit
    lost: float
    description: DriftAndWhite
    phi: float
    noise: FilterNoise
    deviation: float
    allan: Allan
    tones: tuple[Tone, ...]


@dataclass(frozen=True)
class DeadAxis:
    """An axis that holds one value in rad/s throughout: it does not measure."""

    value: float


@dataclass(frozen=True)
class Identification:
    """What is known of a gyroscope from one recording.

    Attributes:
        timing: How the samples lie in time.
        quiet: The motionless spans.
        begins: Begin of each span in s from the first sample.
        ends: End of each span likewise.
        seconds: Length of all of them together.
        axes: One per axis; not all of them are dead.
        warnings: Sentences on how far it can be trusted.
    """

    timing: Timing
    quiet: Quiet
    begins: tuple[float, ...]
    ends: tuple[float, ...]
    seconds: float
    axes: tuple[AxisModel | DeadAxis, ...]
    warnings: tuple[str, ...]


@dataclass(frozen=True)
class _Rests:
    """The rests at one sample rate; `stamps` (n,) in ns are those of the whole recording."""

    timing: Timing
    quiet: Quiet
    stamps: Integers | Stored

    def length(self, span: SampleSpan) -> float:
        """Return how long a span lasts in s."""
        return self.timing.seconds_of(self.stamps, span.first, span.stop)

    def seconds(self) -> float:
        """Return how long all rests last in s."""
        return sum(map(self.length, self.quiet.spans))


def identify(
    stamps: Integers | Stored,
    rates: Floats | tuple[Values, ...],
    accelerations: Floats | tuple[Values, ...],
    *,
    log_times: Integers | Stored | None = None,
    orders: Sequence[Order] = ORDERS,
    paper: bool = False,
) -> Identification:
    """Identify the drift model of a gyroscope from a recording with rest in it.

    Args:
        stamps: (n,) in ns.
        rates: (n, 3) in rad/s, or its columns.
        accelerations: (n, 3) in m/s^2, or its columns; NaN or zero where there is none.
        log_times: (n,) in ns, which tell where the clock of the stamps was set.
        orders: ARMA orders to compare; (1, 0), which the filter takes, among them.
        paper: Take Q and R as the paper does, instead of those of the filter's own likelihood.

    Raises:
        IdentificationError: There is no rest of `SHORTEST_QUIET` s, an axis shows no noise at rest
            though it is not dead, or all are dead.
    """
    rates, accelerations = columns(rates), columns(accelerations)
    found = [
        _Rests(timing, find_quiet(timing, rates, accelerations), stamps)
        for timing in learn_timings(stamps, log_times)
    ]
    rests = max(found, key=_Rests.seconds)
    timing, quiet, seconds = rests.timing, rests.quiet, rests.seconds()
    begins = tuple(timing.seconds_at(stamps, span.first) for span in quiet.spans)
    lengths = map(rests.length, quiet.spans)
    ends = tuple(begin + length for begin, length in zip(begins, lengths, strict=True))
    about_rates = _about_sample_rates(rests, sum(map(_Rests.seconds, found)) - seconds)
    if seconds < SHORTEST_QUIET:
        raise IdentificationError('; '.join([_why_too_short(rests, rates), *about_rates]))
    dead = [dead_value(rate) for rate in rates]
    if None not in dead:
        raise IdentificationError(
            'all three axes are dead, each holds one value throughout: the gyroscope does not '
            "measure, or the driver's zero-rate filter takes its noise away"
        )
    axes = tuple(
        _with_moves_of_bias(
            _identify_axis(
                rates[axis], quiet.spans, begins, timing.period, AXES[axis], orders, paper=paper
            ),
            quiet,
            axis,
        )
        if value is None
        else DeadAxis(value)
        for axis, value in enumerate(dead)
    )
    warnings = [
        *_about_recording(seconds, count_repeats(rates, accelerations)),
        *about_rates,
        *_about_other_rates(rests),
        *_about_axes(axes),
    ]
    return Identification(timing, quiet, begins, ends, seconds, axes, tuple(warnings))


def _why_too_short(rests: _Rests, rates: Sequence[Values]) -> str:
    """Return why the rests are too short, and which was the longest one."""
    quiet, timing, stamps = rests.quiet, rests.timing, rests.stamps
    needed = f'{SHORTEST_QUIET:g} s of rest are needed: let it lie still for a minute'
    if quiet.open and not quiet.spans:
        return (
            'no rest can be told: the rates change as slowly as those of a body, and the recording '
            "does not show that this is the sensor's own filter; let it lie still for ten minutes"
        )
    recorded = timing.seconds_of(stamps, 0, len(stamps))
    if quiet.longest is None and recorded < SHORTEST_QUIET:
        return f'the recording has no more than {recorded:.2g} s: {needed}'
    if quiet.longest is None:
        known = [any(np.isfinite(part).any() for part in parts(rate)) for rate in rates]
        if why := without_rate(known, LARGEST_RATE):
            return f'{why}: the gyroscope or its driver does not work'
        return f'no rest: even the quietest second of the recording moves; {needed}'
    begin = timing.seconds_at(stamps, quiet.longest.first)
    longest = f'{rounded_down(rests.length(quiet.longest))} s, from {begin:.1f} s after the start'
    if not quiet.spans:
        return f'no rest that lasts {SHORTEST_SECONDS:g} s: the longest is {longest}; {needed}'
    others = ''.join(f'; {text}' for text in _about_other_rates(rests))
    seconds = rounded_down(rests.seconds())
    return f'only {seconds} s of rest, the longest {longest}{others}; {needed}'


def _about_recording(seconds: float, repeats: Repeats) -> list[str]:
    """Return one sentence for each reason why all of the figures are less than they seem."""
    warnings = []
    if seconds < SHORT_QUIET:
        warnings.append(
            f'only {seconds:.0f} s of rest: the figures are rough below {SHORT_QUIET:g} s'
        )
    if repeats.are_repeats and repeats.share > _MATERIAL_REPEATS:
        warnings.append(
            f'{plain(100.0 * repeats.share, 2)} % of the samples are sent twice or more, so that '
            'the noise looks correlated, and phi, Q, R and tones are those of the repeats: let the '
            'driver publish each measurement once, and record again'
        )
    return warnings


def _about_sample_rates(rests: _Rests, others: float) -> list[str]:
    """Return in words what is left out, with so many s of rest, as the sensor changed its rate."""
    changes = rests.timing.rate_changes(rests.stamps)
    if not changes:
        return []
    return [
        f'{changes}: the figures are those at {1.0 / rests.timing.period:.4g} Hz, which has the '
        f'longest rest; {others:.0f} s of rest at other sample rates are left out'
    ]


def _about_other_rates(rests: _Rests) -> list[str]:
    """Return in words which quiet stretches are no rest of this bias, and why."""
    out = []
    for turns_not, why in (
        (True, 'gravity stood, so the bias has moved; bias.initial is that of the other rests'),
        (False, 'a slow turn, or the bias has moved'),
    ):
        others = [other for other in rests.quiet.other_rates if other.turns_not == turns_not]
        if others:
            lasting = sum(rests.length(other.span) for other in others)
            largest = max(max(map(abs, other.step)) for other in others)
            out.append(
                f'{counted(len(others), "span")} without motion, {rounded_down(lasting)} s in all, '
                f'left out, as the rate differs by up to {math.degrees(largest):.2g} deg/s: {why}'
            )
    return out


def _with_moves_of_bias(model: AxisModel, quiet: Quiet, axis: int) -> AxisModel:
    """Return a model whose bias is as uncertain as it moves from rest to rest.

    The noise is that of the rests of one bias; at which of them the next run begins is not known.
    """
    moves = [(len(o.span), o.step[axis]) for o in quiet.other_rates if o.turns_not]
    total = sum(map(len, quiet.spans)) + sum(length for length, _ in moves)
    variance = sum(length * step**2 for length, step in moves) / total
    clean = model.preprocessed
    deviation = math.hypot(clean.bias_deviation, math.sqrt(variance))
    return replace(model, preprocessed=replace(clean, bias_deviation=deviation))


def _about_axes(axes: Sequence[AxisModel | DeadAxis]) -> list[str]:
    """Return one sentence each, with the axes that it is about."""
    about: dict[str, list[str]] = {}
    for name, axis in zip(AXES, axes, strict=True):
        if isinstance(axis, DeadAxis):
            what = f'{math.degrees(axis.value):.6g} deg/s throughout: it does not measure'
            about.setdefault(f'dead, {what}', []).append(name)
            continue
        sentences = [f'{c.name}: {c.consequence}' for c in axis.checks if not c.passed]
        if axis.lost > _MATERIAL_LOSS:
            sentences.append(
                'ARMA({}, {}) describes the noise better than the AR(1) that the filters take, '
                'which leaves {:.2g} % of its variance in that could be predicted'.format(
                    *axis.chosen.order, 100.0 * axis.lost
                )
            )
        sentences += axis.allan.warnings
        sentences += [
            f'a tone of {math.degrees(tone.amplitude):.2g} deg/s at {tone.frequency:.4g} Hz is in '
            'the noise: a motor, the mains or the sensor itself'
            for tone in axis.tones
        ]
        for sentence in sentences:
            about.setdefault(sentence, []).append(name)
    return [f'{named_axes(names)}: {sentence}' for sentence, names in about.items()]


def _identify_axis(
    rate: Values,
    spans: Sequence[SampleSpan],
    begins: Sequence[float],
    period: float,
    name: str,
    orders: Sequence[Order],
    *,
    paper: bool,
) -> AxisModel:
    raw = [Stretch(rate, span.first, span.stop) for span in spans]
    require_noise(raw, name)
    clean = preprocess(rate, spans, period, begins)
    residuals = clean.residuals
    longest = max(len(piece) for piece in residuals)
    fitted = [piece for piece in residuals if len(piece) >= min(_SHORTEST_FITTED, longest)]
    deviation = math.sqrt(mean_square(fitted))
    fits = fit_arma(fitted, orders)
    chosen = choose(fits)
    drift = next(candidate for candidate in fits if candidate.order == (1, 0))
    phi = float(drift.phi[0])
    return AxisModel(
        preprocessed=clean,
        checks=(
            check_zero_mean(residuals),
            check_stationarity(residuals),
            check_normality(residuals),
            check_quantisation(raw, deviation),
        ),
        fits=tuple(fits),
        chosen=chosen,
        lost=max(1.0 - chosen.variance / drift.variance, 0.0),
        description=fit_drift_and_white(fitted),
        phi=phi,
        noise=paper_noise(drift, deviation) if paper else fit_filter_noise(fitted, phi),
        deviation=deviation,
        allan=allan_deviation(clean.cleaned, period),
        tones=find_tones(residuals, period),
    )
