"""The whole identification of one recording: rests, bias, tests, models, filter parameters."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.identify.allan import Allan, allan_deviation
from gyro_drift_filter.identify.checks import (
    Check,
    check_normality,
    check_quantisation,
    check_stationarity,
    check_zero_mean,
    require_noise,
)
from gyro_drift_filter.identify.errors import IdentificationError
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
from gyro_drift_filter.identify.quiet import Quiet, Span, describe_absence, find_quiet

Floats = NDArray[np.float64]

SHORTEST_QUIET = 20.0  # s
SHORT_QUIET = 60.0  # s: below that a warning
# The models are fitted to spans of at least this many samples, where there is one.
_SHORTEST_FITTED = 500


@dataclass(frozen=True)
class AxisModel:
    """What is known of one axis; rad/s and (rad/s)^2.

    Attributes:
        preprocessed: Bias, trend, outliers and what is left.
        checks: What the model assumes, tested.
        fits: ARMA models, the paper's Table 1.
        chosen: The one that is adequate.
        description: AR(1) plus white noise.
        phi: Of the AR(1) that the filter takes.
        noise: Q and R for the filter.
        deviation: Standard deviation of the noise at rest.
        allan: Allan deviation.
    """

    preprocessed: Preprocessed
    checks: tuple[Check, ...]
    fits: tuple[ArmaFit, ...]
    chosen: ArmaFit
    description: DriftAndWhite
    phi: float
    noise: FilterNoise
    deviation: float
    allan: Allan


@dataclass(frozen=True)
class Identification:
    """What is known of a gyroscope from one recording.

    Attributes:
        sample_rate: In Hz.
        quiet: The motionless spans.
        begins: Begin of each span in s from the first sample.
        seconds: Length of all of them together.
        axes: One per axis.
        warnings: Sentences on how far it can be trusted.
    """

    sample_rate: float
    quiet: Quiet
    begins: tuple[float, ...]
    seconds: float
    axes: tuple[AxisModel, ...]
    warnings: tuple[str, ...]


def sample_period(stamps: NDArray[np.int64]) -> float:
    """Return the time per sample in s: that of blocks of two seconds, the median of all.

    Raises:
        IdentificationError: The stamps don't advance.
    """
    seconds = (stamps - stamps[0]) * 1e-9
    if len(stamps) < 2 or not seconds[-1] > 0.0:
        raise IdentificationError(
            'the stamps do not advance: there is no sample rate to be learned'
        )
    edges = np.searchsorted(seconds, np.arange(0.0, seconds[-1], 2.0))
    edges = np.append(edges[np.append(True, np.diff(edges) >= 10)], len(stamps) - 1)
    counts = np.diff(edges)
    if not (counts > 0).any():
        return float(seconds[-1] / (len(stamps) - 1))
    return float(np.median(np.diff(seconds[edges])[counts > 0] / counts[counts > 0]))


def identify(
    stamps: NDArray[np.int64],
    rates: Floats,
    accelerations: Floats,
    *,
    orders: Sequence[Order] = ORDERS,
    paper: bool = False,
) -> Identification:
    """Identify the drift model of a gyroscope from a recording with rest in it.

    Args:
        stamps: (n,) in ns.
        rates: (n, 3) in rad/s.
        accelerations: (n, 3) in m/s^2, NaN or zero where there is none.
        orders: ARMA orders to compare.
        paper: Take Q and R as the paper does, instead of those of the filter's own likelihood.

    Raises:
        IdentificationError: There is no rest of `SHORTEST_QUIET` s, or an axis shows no noise.
    """
    period = sample_period(stamps)
    quiet = find_quiet(stamps, rates, accelerations, period)
    seconds = sum(span.stop - span.first for span in quiet.spans) * period
    if seconds < SHORTEST_QUIET:
        raise IdentificationError(
            f'{describe_absence(quiet, stamps, period)}; {SHORTEST_QUIET:g} s of rest are needed'
        )
    begins = tuple(float((stamps[span.first] - stamps[0]) * 1e-9) for span in quiet.spans)
    axes = tuple(
        _identify_axis(rates[:, axis], quiet.spans, begins, period, AXES[axis], orders, paper)
        for axis in range(3)
    )
    warnings = []
    if seconds < SHORT_QUIET:
        warnings.append(
            f'only {seconds:.0f} s of rest: the figures are rough below {SHORT_QUIET:g} s'
        )
    for name, axis in zip(AXES, axes, strict=True):
        warnings += [
            f'axis {name}: {check.name}: {check.consequence}'
            for check in axis.checks
            if not check.passed
        ]
        if axis.chosen.order not in ((1, 0), (0, 0)):
            warnings.append(
                f'axis {name}: ARMA{axis.chosen.order} describes the noise better than AR(1); the '
                "filters' AR(1) leaves that correlation in"
            )
    return Identification(
        1.0 / period, quiet, begins, seconds, axes, tuple(dict.fromkeys(warnings))
    )


def _identify_axis(
    rate: Floats,
    spans: Sequence[Span],
    begins: Sequence[float],
    period: float,
    name: str,
    orders: Sequence[Order],
    paper: bool,
) -> AxisModel:
    raw = [rate[span.first : span.stop] for span in spans]
    require_noise(raw, name)
    clean = preprocess(rate, spans, period, begins)
    residuals = clean.residuals
    longest = max(len(piece) for piece in residuals)
    fitted = [piece for piece in residuals if len(piece) >= min(_SHORTEST_FITTED, longest)]
    deviation = float(np.sqrt(np.mean(np.concatenate(fitted) ** 2)))
    fits = fit_arma(fitted, orders)
    phi, noise = paper_noise(fitted)
    if not paper:
        noise = fit_filter_noise(fitted, phi)
    return AxisModel(
        preprocessed=clean,
        checks=(
            check_zero_mean(residuals),
            check_stationarity(residuals),
            check_normality(residuals),
            check_quantisation(raw, deviation),
        ),
        fits=tuple(fits),
        chosen=choose(fits),
        description=fit_drift_and_white(fitted),
        phi=phi,
        noise=noise,
        deviation=deviation,
        allan=allan_deviation(clean.cleaned, period),
    )
