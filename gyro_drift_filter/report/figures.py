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

"""What is drawn of a run: figures of panels of traces, for the page and for pictures alike.

A trace is reduced here to what a page has room for, by the least and the largest value of each of
its parts, so that no extreme is lost. The page reduces it once more to what the screen shows.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from tsdownsample import MinMaxDownsampler

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.identify import IdentificationError
from gyro_drift_filter.identify.allan import allan_deviation
from gyro_drift_filter.identify.blocks import runs_of
from gyro_drift_filter.identify.preprocess import bridged
from gyro_drift_filter.identify.spectrum import spectrum
from gyro_drift_filter.identify.timing import GAP_PERIODS
from gyro_drift_filter.report.run_sums import REST_BLOCK_SECONDS
from gyro_drift_filter.report.signals import Signals

DEGREES = float(np.degrees(1.0))
TIME = 'time (s)'
# The innovations are drawn in a band of so many of their predicted deviations.
BAND = 3.0
_LARGEST = 10.0
# A rest that is shorter, in s, has no spectrum worth drawing.
_SHORTEST = 5.0
_OF_REST = 'Of the longest rest, without outliers, and without its end, where motion may begin'
_LAGS = 40
_LARGEST_FOURIER = 1 << 18
_BINS = np.linspace(-6.0, 6.0, 61)
# Outliers that are marked on one axis; more are a cloud.
_MARKED = 5000
# How much room each kind of trace gets, in parts of the whole.
_SHARES = {'rate': 4.0, 'innovation': 3.0, 'slow': 1.0}


@dataclass(frozen=True)
class Trace:
    """One line or set of marks.

    Attributes:
        role: What it is: it has the colour of that, and is shown and hidden with it.
        x: (n,).
        y: (n,); NaN breaks a line.
        style: 'line', 'marks', 'bars', or 'band': from `-y` to `y`, or about `middle` where there
            is one.
        middle: (n,) for a band.
    """

    role: str
    x: NDArray[Any]
    y: NDArray[Any]
    style: str = 'line'
    middle: NDArray[Any] | None = None


@dataclass(frozen=True)
class Figure:
    """Panels below each other with one horizontal axis, one for each axis of the gyroscope.

    Attributes:
        name: For files and links.
        title: What is drawn.
        text: What it tells, in a sentence or two.
        y: Label of the vertical axes.
        x: Label of the horizontal axis: TIME, or something else.
        panels: Traces by the name of their panel.
        logarithmic: Which of the axes are, 'x', 'y' or both.
        limits: Of the vertical axes, None where the traces decide.
    """

    name: str
    title: str
    text: str
    y: str
    x: str = TIME
    panels: dict[str, list[Trace]] = field(default_factory=dict)
    logarithmic: str = ''
    limits: tuple[float, float] | None = None

    @property
    def in_time(self) -> bool:
        """Whether x is the time in s since the first message, the same in all such figures."""
        return self.x == TIME


class Drawer:
    """Makes the figures of one recording that went through one or several filters.

    Attributes:
        runs: By method, the first one being drawn in full.
    """

    def __init__(
        self, runs: dict[str, Signals], start: int, points: int, recorded: Any = None
    ) -> None:
        """Begin.

        Args:
            runs: By method; the first one kept all, the others what is compared.
            start: Log time in ns of the first message of the recording.
            points: How many all traces together may have.
            recorded: (times (n,) in s, rates (n, 3) in rad/s) of a filtered topic that the
                recording holds, where it is another one.
        """
        self.runs, self._recorded = runs, recorded
        self._method, self.main = next(iter(runs.items()))
        self.times: Floats = (np.asarray(self.main.log_times) - start) * 1e-9
        # s: the filter coasts no longer, and a slow sensor takes its time.
        self._longest_step = max(
            self.main.filter.parameters.gap_limit, GAP_PERIODS * self.main.watch.period
        )
        # The first index of each, and the one behind its last.
        self.rests = runs_of(np.asarray(self.main.resting) > 0).tolist()
        others = len(runs) - 1 + (recorded is not None)
        total = 3.0 * (
            (2.0 + others) * _SHARES['rate']
            + _SHARES['innovation']
            + (6.0 + others) * _SHARES['slow']
        )
        self._room = {kind: max(int(points * s / total), 100) for kind, s in _SHARES.items()}

    def figures(self) -> list[Figure]:
        """Return all figures, the ones over time first."""
        drawn = [self._rates(), self._angles(), self._bias(), self._innovations(), self._noise()]
        period = self.main.watch.period
        calm = (self._without_end(rest, period) for rest in self.rests)
        longest = max(calm, key=lambda rest: rest[1] - rest[0], default=(0, 0))
        if (longest[1] - longest[0]) * period >= _SHORTEST:
            drawn += [self._spectrum(longest, period), self._allan(longest, period)]
        innovations = self._autocorrelation(), self._histogram()
        return drawn + [figure for figure in innovations if figure.panels]

    def roles(self) -> dict[str, str]:
        """Return the name of each role that can be shown and hidden."""
        named = {'raw': 'raw', **{method: f'filtered, {method}' for method in self.runs}}
        if self._recorded is not None:
            named['recorded'] = 'filtered, as recorded'
        return named | {'outlier': 'outliers', 'rest': 'at rest'}

    def _without_end(self, rest: tuple[int, int], period: float) -> tuple[int, int]:
        """Return a rest without what may be motion already, as the noise is counted without it."""
        first, stop = rest
        block = max(round(REST_BLOCK_SECONDS / period), 1)
        return first, first + max((stop - first) // block - 1, 0) * block

    def rest_times(self) -> list[tuple[float, float]]:
        """Return begin and end of each rest in s."""
        return [(float(self.times[a]), float(self.times[b - 1])) for a, b in self.rests]

    def _trace(self, role: str, kind: str, y: Any, scale: float = DEGREES) -> Trace:
        return self._line(role, self.times, np.asarray(y), self._room[kind], scale)

    def _line(
        self, role: str, times: Floats, values: NDArray[Any], room: int, scale: float = DEGREES
    ) -> Trace:
        """Return a line through values (n,), broken where no sample came for long."""
        behind = 1 + np.flatnonzero(np.diff(times) > self._longest_step)
        where = reduced(values, room - min(len(behind), room // 2))
        breaks = np.unique(np.searchsorted(where, behind))
        breaks = breaks[(breaks > 0) & (breaks < len(where))]
        x, y = times[where], scale * values[where].astype(np.float64)
        return Trace(role, np.insert(x, breaks, x[breaks]), np.insert(y, breaks, np.nan))

    def _rates(self) -> Figure:
        figure = Figure(
            'rates',
            'Rates',
            'As the sensor gave them, and as the filter publishes them: without the bias, quiet at '
            'rest (shaded), and following motion at once. Crosses are samples that were flagged '
            'as outliers.',
            'deg/s',
        )
        for axis, name in enumerate(AXES):
            raw = np.asarray(self.main.columns['raw'][axis])
            traces = [self._trace('raw', 'rate', raw)]
            if self._recorded is not None:
                times, rates = self._recorded
                room = self._room['rate']
                traces.append(self._line('recorded', times, rates[:, axis], room))
            # The first method stands in front.
            for method, run in reversed(self.runs.items()):
                traces.append(self._trace(method, 'rate', run.columns['filtered'][axis]))
            outliers = np.flatnonzero(np.asarray(self.main.columns['outlier'][axis]))
            outliers = outliers[:: -(-len(outliers) // _MARKED) or 1]
            marks = Trace(
                'outlier', self.times[outliers], DEGREES * raw[outliers].astype(float), 'marks'
            )
            figure.panels[name] = [*traces, marks]
        return figure

    def _angles(self) -> Figure:
        figure = Figure(
            'angles',
            'Integrated angle',
            'The sum of the rates of each axis: what a bias does to it. At rest a good line is '
            'level. It is no orientation, as turns about several axes do not add up.',
            'deg',
        )
        for axis, name in enumerate(AXES):
            traces = [self._trace('raw', 'slow', self.main.columns['raw_angle'][axis])]
            for method, run in reversed(self.runs.items()):
                traces.append(self._trace(method, 'slow', run.columns['filtered_angle'][axis]))
            figure.panels[name] = traces
        return figure

    def _bias(self) -> Figure:
        figure = Figure(
            'bias',
            'Bias',
            'As it is subtracted from the rates, with one standard deviation of what is known at '
            'rest: it narrows at each rest and widens between them. From the first rest on, where '
            'there is one.',
            'deg/s',
        )
        first = self.rests[0][0] if self.rests else 0
        report_times = np.array(self.main.report_times)
        deviations = np.reshape(self.main.bias_deviations, (-1, 3))
        begin = int(np.searchsorted(report_times, self.times[first]))
        some = slice(begin, None, -(-len(report_times) // self._room['slow']) or 1)
        for axis, name in enumerate(AXES):
            bias = np.asarray(self.main.columns['bias'][axis]).copy()
            bias[:first] = np.nan
            traces = []
            if len(report_times[some]):
                at = np.searchsorted(self.times, report_times[some]).clip(max=len(bias) - 1)
                traces.append(
                    Trace(
                        'deviation',
                        report_times[some],
                        DEGREES * deviations[some, axis],
                        'band',
                        DEGREES * bias[at].astype(float),
                    )
                )
            figure.panels[name] = [*traces, self._trace(self._method, 'slow', bias)]
        return figure

    def _innovations(self) -> Figure:
        figure = Figure(
            'innovations',
            'Innovations',
            'How far each sample was from what the filter expected, in the standard deviations '
            f'that it predicted. They should fill the band of {BAND:g}, and stay in it. What is '
            f'beyond {_LARGEST:g}, as outliers are, is drawn at the edge.',
            'deviations',
            limits=(-1.05 * _LARGEST, 1.05 * _LARGEST),
        )
        ends = self.times[[0, -1]]
        for axis, name in enumerate(AXES):
            clipped = self._normalised(axis).clip(-_LARGEST, _LARGEST)
            figure.panels[name] = [
                Trace('band', ends, np.full(2, BAND), 'band'),
                self._trace(self._method, 'innovation', clipped, 1.0),
            ]
        return figure

    def _normalised(self, axis: int) -> NDArray[np.float32]:
        """Return the innovations (n,) in predicted standard deviations, NaN where none is known."""
        innovation, deviation = (
            np.asarray(self.main.columns[name][axis])
            for name in ('innovation', 'innovation_deviation')
        )
        unknown = np.full_like(innovation, np.nan)
        return np.asarray(np.divide(innovation, deviation, out=unknown, where=deviation > 0.0))

    def _noise(self) -> Figure:
        figure = Figure(
            'noise',
            'Adapted noise: Q and R',
            'Q (orange), how much the filter expects the rate to change, rises in motion so that '
            'the rates come through; R (blue), the noise of the sensor, is learned at rest.',
            '(deg/s)^2',
            logarithmic='y',
        )
        for axis, name in enumerate(AXES):
            figure.panels[name] = [
                self._trace(role, 'slow', self.main.columns[column][axis], DEGREES**2)
                for role, column in (('q', 'process_noise'), ('r', 'measurement_noise'))
            ]
        return figure

    def _spectrum(self, rest: tuple[int, int], period: float) -> Figure:
        figure = Figure(
            'spectrum',
            'Power spectral density at rest',
            f'{_OF_REST}. Lines that stand out are motors or fans; the filter takes off '
            'what is fast.',
            '(deg/s)^2/Hz',
            'frequency (Hz)',
            logarithmic='xy',
        )
        for axis, name in enumerate(AXES):
            figure.panels[name] = []
            for role, values in self._at_rest(rest, axis):
                data = spectrum([values - values.mean()])
                frequency = data.frequency / (2.0 * np.pi * period)
                power = np.maximum(2.0 * period * DEGREES**2 * data.power, 1e-30)
                figure.panels[name].append(Trace(role, frequency, power))
        return figure

    def _allan(self, rest: tuple[int, int], period: float) -> Figure:
        figure = Figure(
            'allan',
            'Overlapping Allan deviation at rest',
            f'{_OF_REST}: how much the mean over a time changes from one such time to the '
            'next. The falling part is noise, the lowest point the bias instability.',
            'deg/h',
            'averaging time (s)',
            logarithmic='xy',
        )
        for axis, name in enumerate(AXES):
            figure.panels[name] = []
            for role, values in self._at_rest(rest, axis):
                try:
                    allan = allan_deviation([values], period)
                except IdentificationError:
                    continue  # too short, or a dead axis
                deviations = 3600.0 * DEGREES * allan.deviations
                figure.panels[name].append(Trace(role, allan.taus, deviations))
        return figure

    def _at_rest(self, rest: tuple[int, int], axis: int) -> list[tuple[str, Floats]]:
        """Return role and rates of a rest; lines are drawn over outliers and what is no number."""
        first, stop = rest
        flagged = self.main.columns['outlier'][axis][first:stop] > 0
        of_runs = [(method, run.columns['filtered']) for method, run in self.runs.items()]
        found = []
        for role, columns in [('raw', self.main.columns['raw']), *of_runs]:
            values = np.asarray(columns[axis][first:stop], np.float64)
            good = np.isfinite(values) & ~flagged
            if good.any():
                found.append((role, bridged(values, good)))
        return [(role, values) for role, values in found if np.ptp(values) > 0]

    def _autocorrelation(self) -> Figure:
        figure = Figure(
            'autocorrelation',
            'Autocorrelation of the innovations',
            'At rest, where the filter leaves nothing that it could have foreseen, all lags lie '
            'near zero: the band holds 95 % of them. A sensor with a low-pass of its own has more.',
            'correlation',
            'lag (samples)',
        )
        resting = np.asarray(self.main.resting) > 0
        for axis, name in enumerate(AXES):
            innovations = self._normalised(axis).astype(np.float64)
            piece = innovations[self._is_usual(innovations, axis) & resting][:_LARGEST_FOURIER]
            if len(piece) > 10 * _LAGS and np.ptp(piece) > 0:
                lags = np.arange(1, _LAGS + 1)
                limit = np.full(_LAGS, 1.96 / np.sqrt(len(piece)))
                figure.panels[name] = [
                    Trace('band', lags, limit, 'band'),
                    Trace(self._method, lags, autocorrelation(piece, _LAGS), 'bars'),
                ]
        return figure

    def _histogram(self) -> Figure:
        figure = Figure(
            'histogram',
            'Normalised innovations',
            'Innovations in predicted standard deviations, of all samples, beside the normal '
            'distribution that the filter assumes. What is beyond 6 is in the outermost bars.',
            'density',
            'standard deviations',
        )
        for axis, name in enumerate(AXES):
            innovations = self._normalised(axis).astype(np.float64)
            usual = innovations[self._is_usual(innovations, axis)]
            if len(usual) and np.ptp(usual) > 0:
                density, _ = np.histogram(usual.clip(-6.0, 6.0), _BINS, density=True)
                centres = 0.5 * (_BINS[1:] + _BINS[:-1])
                bell = np.exp(-0.5 * centres**2) / np.sqrt(2.0 * np.pi)
                figure.panels[name] = [
                    Trace(self._method, centres, density, 'bars'),
                    Trace('expected', centres, bell),
                ]
        return figure

    def _is_usual(self, innovations: Floats, axis: int) -> Bools:
        """Return which innovations (n,) of an axis are known, and not those of outliers."""
        flagged = np.asarray(self.main.columns['outlier'][axis]) > 0
        return np.asarray(np.isfinite(innovations) & ~flagged)


def reduced(values: NDArray[Any], room: int) -> Integers:
    """Return indexes of at most `room` finite values (n,): the least and largest of each part."""
    finite = np.flatnonzero(np.isfinite(values))
    if len(finite) <= room:
        return finite
    found = values if len(finite) == len(values) else values[finite]
    where = MinMaxDownsampler().downsample(np.ascontiguousarray(found), n_out=room // 2 * 2)
    # The least and the largest value of a part without any change are the same one.
    return np.asarray(finite[np.unique(where.astype(np.int64))])


def autocorrelation(values: Floats, lags: int) -> Floats:
    """Return the correlation (lags,) of values (n,) with themselves, from lag 1 on."""
    centred = values - values.mean()
    power = np.abs(np.fft.rfft(centred, 2 * len(values))) ** 2
    found = np.fft.irfft(power)[: lags + 1]
    return np.asarray(found[1:] / found[0])
