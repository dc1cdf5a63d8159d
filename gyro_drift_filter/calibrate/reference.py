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

"""What an orientation from elsewhere says of a sensor: motion capture, odometry, another filter.

Within a few seconds the reference and the integrated rates turn alike, but for a constant rotation
between the two bodies, a delay of the reference's stamps, and where each started. The latter, and
the bias, are unknown in each span anew, so that neither a drift of the reference nor one of the
bias counts; both are eliminated from the residuals.

A reference that never tilts, as wheel odometry, is compared about the vertical alone.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.spatial.transform import Rotation

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.calibrate import CalibrationError
from gyro_drift_filter.calibrate.between_rests import Closures
from gyro_drift_filter.calibrate.track import Track
from gyro_drift_filter.calibrate.turning import (
    GroupedSteps,
    grouped_steps,
    integrals,
    rotations,
    step_vectors,
)
from gyro_drift_filter.calibrate.unknowns import LATE, MATRIX, TURNED, UNKNOWNS, Residuals
from gyro_drift_filter.rotations import from_vectors, inverse, multiply, to_vectors

# A span is short enough for the gyroscope's noise to stay below that of any reference, and holds so
# many orientations at the most.
SPAN_SECONDS, SPAN_SIZE = 5.0, 400
LEAST_SIZE = 20
# The delay is looked for up to this, in s, and may come out up to the margin beyond that.
LARGEST_DELAY, MARGIN = 1.0, 0.2
GUESS_RATE = 100.0  # Hz, for a first guess: a hand's motion is slower
REACH = round(LARGEST_DELAY * GUESS_RATE)  # samples
HALF = round(0.05 * GUESS_RATE)  # samples on each side of one, over which rates are taken
# A robot on wheels tilts by less in its odometry.
LEVEL = float(np.radians(0.1))
# An orientation that is off by so many deviations is a slip.
SLIP = 6.0
LEAST_MOTION = float(np.radians(20.0))  # in all, to tell anything


@dataclass(frozen=True)
class Reference:
    """Orientations (k,): of a body in a world, as topics give them.

    Attributes:
        stamps: (k,) in ns, on the clock of the gyroscope but for a delay.
        orientations: (k, 4) unit quaternions x, y, z, w, from the body's axes to the world's.
    """

    stamps: Integers
    orientations: Floats


class Guess(NamedTuple):
    """What relates a reference to the rates, about.

    Attributes:
        rotation: (4,) from the reference's body to the sensor.
        late: By how much the reference's stamps are late, in s.
        scale: Of the rates.
    """

    rotation: Floats
    late: float
    scale: float


class Mount:
    """How the reference's body is fixed to the sensor, for all recordings.

    Attributes:
        rotation: (4,) from the body's axes to the sensor's. The unknowns hold what is to be added.
    """

    def __init__(self, rotation: Floats) -> None:
        self.rotation = rotation

    def turn(self, unknowns: Floats) -> None:
        """Turn the mount as the unknowns (UNKNOWNS,) say; they hold no rotation from then on."""
        step = from_vectors(unknowns[TURNED][None])
        self.rotation = multiply(step, self.rotation[None])[0]
        unknowns[TURNED] = 0.0


@dataclass
class _Span:
    """Orientations [first, stop) of the reference, and the samples about them, less their bias."""

    first: int
    stop: int
    samples: slice
    bias: Floats
    steps: GroupedSteps
    used: Bools


class _Turned(NamedTuple):
    """How the sensor has turned since the first sample of a span, at n times."""

    rotations: Floats  # (n, 4) from its axes at each time to those at first
    rates: Floats  # (n, 3) by the matrix, in rad/s
    # Derivatives of the rotation vector in the first axes.
    by_matrix: Floats  # (n, 3, 9)
    by_bias: Floats  # (n, 3, 3)


class ReferenceOfOneRecording:
    """A recording's reference beside its rates."""

    def __init__(self, number: int, track: Track, reference: Reference, density: Floats) -> None:
        """Take a recording by its number and track, and the noise of its rates.

        Raises:
            CalibrationError: The reference has too few orientations, or a stamp may mean two times.
        """
        if track.set_back:
            when, by = track.set_back[0]
            raise CalibrationError(
                f'the clock of the stamps was set back by {by:.2f} s at {when:.1f} s after the '
                'start, so they do not tell which orientation of the reference belongs to which '
                'rate: take a part of the recording with --start or --end'
            )
        self.number = number
        order = np.argsort(reference.stamps, kind='stable')
        fresh = np.append(True, np.diff(reference.stamps[order]) > 0)
        usable = np.isfinite(reference.orientations).all(axis=1)
        usable &= np.abs(np.linalg.norm(reference.orientations, axis=1) - 1.0) < 0.1
        kept = order[fresh & usable[order]]
        if len(kept) < LEAST_SIZE:
            raise CalibrationError(f'the reference has only {len(kept)} orientations')
        self._seconds = (reference.stamps[kept] - track.start).astype(float) * 1e-9
        quaternions = reference.orientations[kept]
        self._rotations = quaternions / np.linalg.norm(quaternions, axis=1)[:, None]
        self._track, self._density = track, float(density.mean())
        self._variance = np.radians(0.5) ** 2
        up = Rotation.from_quat(self._rotations).as_matrix()[:, 2, 2]
        self.level = bool(np.quantile(np.arccos(np.clip(up, -1.0, 1.0)), 0.9) < LEVEL)
        self._spans: list[_Span] = []
        self.inflation = 1.0

    def guess(self, up: Floats | None) -> Guess:
        """Return what relates it to the rates, about.

        Args:
            up: (3,) the vertical in the sensor's axes, for a reference that never tilts.

        Raises:
            CalibrationError: The two do not turn alike, or hardly at all.
        """
        grid = self._common_grid()
        rates = self._smooth_rates(grid)
        turned = self._rates_of_reference(grid)
        if np.abs(turned).sum() / GUESS_RATE < LEAST_MOTION:
            raise CalibrationError('the reference hardly turns: turn the sensor while it is seen')
        shift = _delay_in_samples(rates, turned)
        ours, theirs = rates[REACH:-REACH], turned[REACH + shift : len(grid) - REACH + shift]
        ours, theirs = (x - x.mean(axis=0) for x in (ours, theirs))
        if up is not None and self.level:
            rotation = Rotation.align_vectors([up], [[0.0, 0.0, 1.0]])[0]
        else:
            rotation = Rotation.align_vectors(ours, theirs)[0]
        product = float((ours * rotation.apply(theirs)).sum())
        alike = product / np.sqrt((ours**2).sum() * (theirs**2).sum())
        if alike < 0.5:
            raise CalibrationError(
                f'reference and rates do not turn alike (correlation {alike:.2f}): is it the same '
                'body, and are axes and stamps right?'
            )
        return Guess(rotation.as_quat(), shift / GUESS_RATE, product / (ours**2).sum())

    def _common_grid(self) -> Floats:
        """Return even times in s at which both reference and rates are there."""
        track = self._track
        begin = max(track.seconds[0], self._seconds[0]) + LARGEST_DELAY
        end = min(track.seconds[-1], self._seconds[-1]) - LARGEST_DELAY
        if end - begin < 2.0 * LARGEST_DELAY:
            raise CalibrationError(
                'reference and rates overlap by too little: are their stamps of one clock?'
            )
        return np.arange(begin - LARGEST_DELAY, end + LARGEST_DELAY, 1.0 / GUESS_RATE)

    def _smooth_rates(self, grid: Floats) -> Floats:
        """Return the rates (n, 3) at times (n,) in s, each a mean over `2 HALF + 1` of them."""
        size = 2 * HALF + 1
        rates = [np.interp(grid, self._track.seconds, axis) for axis in self._track.rates.T]
        return np.column_stack([np.convolve(axis, np.ones(size) / size, 'same') for axis in rates])

    def _rates_of_reference(self, grid: Floats) -> Floats:
        """Return the rates (n, 3) of the reference's body at times (n,) in s, over `2 HALF`."""
        near = np.clip(np.searchsorted(self._seconds, grid), 1, len(self._seconds) - 1)
        near -= (grid - self._seconds[near - 1]) < (self._seconds[near] - grid)
        at = self._rotations[near]
        steps = multiply(inverse(at[: -2 * HALF]), at[2 * HALF :])
        turned = np.zeros((len(grid), 3))
        turned[HALF:-HALF] = to_vectors(steps) * (GUESS_RATE / (2 * HALF))
        return turned

    def divide(self, mount: Mount, late: float) -> None:
        """Cut the recording into spans, with the delay in s about known."""
        self._mount = mount
        track, at = self._track, self._seconds - late
        inside = (at > track.seconds[0] + MARGIN) & (at < track.seconds[-1] - MARGIN)
        lost = np.concatenate([[0], np.cumsum(track.broken)])
        edges = np.flatnonzero(inside)
        if not len(edges):
            raise CalibrationError('no orientation of the reference lies within the recording')
        first, last = int(edges[0]), int(edges[-1]) + 1
        while first < last:
            reach = np.searchsorted(at, at[first] + SPAN_SECONDS)
            stop = int(min(reach, last, first + SPAN_SIZE))
            low = int(np.searchsorted(track.seconds, at[first] - MARGIN)) - 1
            high = int(np.searchsorted(track.seconds, at[stop - 1] + MARGIN)) + 1
            samples = slice(max(low, 0), min(high, len(track.seconds)))
            whole = lost[samples.stop - 1] == lost[samples.start]
            if stop - first >= LEAST_SIZE and whole:
                bias = self._first_bias(first, stop, at)
                used = np.ones(stop - first, bool)
                steps = self._steps(samples, bias)
                self._spans.append(_Span(first, stop, samples, bias, steps, used))
            first = stop
        if not self._spans:
            raise CalibrationError('the reference is never there for long enough')

    def _first_bias(self, first: int, stop: int, at: Floats) -> Floats:
        """Return the bias (3,) in a span: what the rates have more than the reference."""
        track = self._track
        ends = np.searchsorted(track.seconds, at[[first, stop - 1]])
        steps = multiply(
            inverse(self._rotations[first : stop - 1]), self._rotations[first + 1 : stop]
        )
        turned = to_vectors(steps).sum(axis=0) / (at[stop - 1] - at[first])
        body = Rotation.from_quat(self._mount.rotation).apply(turned)
        return np.asarray(track.rates[ends[0] : ends[1] + 1].mean(axis=0) - body)

    def _steps(self, samples: slice, bias: Floats) -> GroupedSteps:
        """Return the steps of samples, less a bias."""
        steps = np.diff(self._track.seconds[samples])
        rates = self._track.rates[samples] - bias
        return grouped_steps(steps, self._track.period, *integrals(rates, steps))

    def residuals(self, unknowns: Floats) -> Residuals:
        """Return all residuals at the unknowns (UNKNOWNS,).

        What the start and the bias of a span explain is taken out.
        """
        found = [self._free(span, unknowns) for span in self._spans]
        values, jacobian = (np.concatenate(part) for part in zip(*found, strict=True))
        scale = self.inflation**-0.5
        return Residuals(scale * values, scale * jacobian)

    def renew(self, unknowns: Floats, *, near: bool) -> None:
        """Take over what unknowns (UNKNOWNS,) show: biases, noise of the reference, what slipped.

        Only near the solution it can be told whether errors belong together.
        """
        squares, count, gradients, normal = 0.0, 0, [], np.zeros((UNKNOWNS, UNKNOWNS))
        for span in self._spans:
            self._learn_bias(span, unknowns)
            values, jacobian = self._free(span, unknowns)
            squares += float(values @ values)
            count += max(len(values) - 6, 1)
            gradients.append(jacobian.T @ values)
            normal += jacobian.T @ jacobian
        self._variance *= squares / count
        if not near or len(self._spans) < 2:
            return
        # Errors of a reference may belong together over seconds: then spans tell, not samples.
        information = np.array(gradients).T @ np.array(gradients) / (squares / count)
        observed = np.diag(normal) > 0.0
        ratio = np.diag(information)[observed] / np.diag(normal)[observed]
        self.inflation = max(1.0, float(np.median(ratio)))

    @property
    def deviation(self) -> float:
        """The standard deviation of an orientation in rad."""
        return float(self._variance**0.5)

    @property
    def spans(self) -> list[tuple[float, float]]:
        """Start and length of each span in s."""
        ends = [self._seconds[[span.first, span.stop - 1]] for span in self._spans]
        return [(float(first), float(last - first)) for first, last in ends]

    def closures(self, unknowns: Floats) -> Closures:
        """Return by how many rad the ends of spans are off, and by how many each turned."""
        matrix, out = unknowns[MATRIX].reshape(3, 3), []
        for span in self._spans:
            vectors, *_ = self._differences(span, unknowns)
            turned = float(np.linalg.norm(span.steps.angles @ matrix.T, axis=1).sum())
            count = max(len(vectors) // 10, 1)
            # A start is a mean of some, as the reference is noisy, and so is an end.
            step = vectors[-count:].mean(axis=0) - vectors[:count].mean(axis=0)
            out.append((float(np.linalg.norm(step)), turned))
        return Closures(*np.array(out).T)

    def _differences(self, span: _Span, unknowns: Floats) -> tuple[Floats, Floats, Floats]:
        """Return by how much the reference is ahead, as rotation vectors in the span's first axes.

        Beside them (n, 3) stand their derivatives by the unknowns (n, 3, UNKNOWNS) and by the bias
        (n, 3, 3).
        """
        sensor = self._integrate(span, unknowns)
        mount = multiply(from_vectors(unknowns[TURNED][None]), self._mount.rotation[None])
        ahead = multiply(self._rotations[span.first : span.stop], inverse(mount))
        ahead = multiply(ahead, inverse(sensor.rotations))
        center = _mean(ahead)
        vectors = to_vectors(multiply(inverse(center[None]), ahead))
        axes = Rotation.from_quat(sensor.rotations).as_matrix()
        jacobian = np.zeros((len(vectors), 3, UNKNOWNS))
        jacobian[:, :, MATRIX] = -sensor.by_matrix
        if not self.level:
            jacobian[:, :, TURNED] = -axes
        jacobian[:, :, LATE] = np.einsum('kai,ki->ka', axes, sensor.rates)
        return vectors, jacobian, -sensor.by_bias

    def _integrate(self, span: _Span, unknowns: Floats) -> _Turned:
        """Return how the sensor has turned, by its rates, at the orientations of the reference."""
        matrix, steps = unknowns[MATRIX].reshape(3, 3), span.steps
        seconds, rates = self._track.seconds[span.samples], self._track.rates[span.samples]
        before, middle = rotations(step_vectors(steps.angles, steps.coning, matrix))
        at = self._seconds[span.first : span.stop] - unknowns[LATE]
        # Each is so long behind a sample, in a share of the way to the next one. To that sample
        # lead whole groups of steps, and a part of the next group.
        sample = np.clip(np.searchsorted(seconds, at, 'right') - 1, 0, len(seconds) - 2)
        length = seconds[sample + 1] - seconds[sample]
        share = (at - seconds[sample]) / length
        behind = (share * length)[:, None]
        group = np.searchsorted(steps.first, sample, 'right') - 1
        raw, change = rates[sample] - span.bias, rates[sample + 1] - rates[sample]
        rate, now = raw @ matrix.T, (raw + share[:, None] * change) @ matrix.T
        in_group = step_vectors(steps.angles_before[sample], steps.coning_before[sample], matrix)
        turned = multiply(before[group], from_vectors(in_group))
        turned = multiply(turned, from_vectors(0.5 * behind * (rate + now)))
        axes = Rotation.from_quat(middle).as_matrix()

        def summed(of_groups: Floats, of_part: Floats) -> Floats:
            total = np.cumsum(of_groups, axis=0) - of_groups
            return np.asarray(total[group] + of_part)

        angles = steps.angles_before[sample] + behind * (raw + 0.5 * change)
        by_matrix = summed(_outer(axes, steps.angles), _outer(axes[group], angles))
        lengths = (at - seconds[steps.first[group]])[:, None, None]
        time_in_axes = summed(axes * steps.lengths[:, None, None], axes[group] * lengths)
        return _Turned(turned, now, by_matrix, -time_in_axes @ matrix)

    def _whitened(self, span: _Span, unknowns: Floats) -> tuple[Floats, Floats]:
        """Return residuals of variance 1 with their derivatives: (m, 1 + UNKNOWNS) and (m, ...).

        Beside the residuals stand those by the unknowns, the second array is by the bias and the
        start of the span. An orientation has 3 residuals, 1 where the reference never tilts.
        """
        vectors, jacobian, by_bias = self._differences(span, unknowns)
        if self.level:
            up = self._up()
            vectors, jacobian = vectors @ up[:, None], np.einsum('a,kan->kn', up, jacobian)[:, None]
            # The bias about the other two axes is nothing that such a reference sees.
            by_bias = np.einsum('a,kab,b->k', up, by_bias, up)[:, None, None]
        n, size = vectors.shape
        by_start = np.broadcast_to(np.eye(size), (n, size, size))
        columns = np.concatenate([vectors[:, :, None], jacobian, by_bias, by_start], axis=2)
        factor = np.linalg.cholesky(self._covariance(span))
        white = solve_triangular(factor, columns.reshape(n, -1), lower=True, check_finite=False)
        white = white.reshape(-1, columns.shape[2])
        return white[:, : 1 + UNKNOWNS], white[:, 1 + UNKNOWNS :]

    def _covariance(self, span: _Span) -> Floats:
        """Return the covariance (n, n) of a span: white noise, and the gyroscope's summed up."""
        since = self._seconds[span.first : span.stop] - self._seconds[span.first]
        summed = self._density * np.minimum.outer(since, since)
        covariance = self._variance * np.eye(len(since)) + summed
        covariance[~span.used, ~span.used] += 1e6 * self._variance
        return np.asarray(covariance)

    def _up(self) -> Floats:
        """Return the vertical (3,) of a reference that never tilts, in the sensor's axes."""
        return np.asarray(Rotation.from_quat(self._mount.rotation).as_matrix()[:, 2])

    def _free(self, span: _Span, unknowns: Floats) -> tuple[Floats, Floats]:
        """Return residuals of a span and their derivatives, its bias and start projected out."""
        white, by_bias_and_start = self._whitened(span, unknowns)
        basis = np.linalg.qr(by_bias_and_start)[0]
        white = white - basis @ (basis.T @ white)
        return white[:, 0], white[:, 1:]

    def _learn_bias(self, span: _Span, unknowns: Floats) -> None:
        white, by_bias_and_start = self._whitened(span, unknowns)
        step = np.linalg.lstsq(by_bias_and_start, -white[:, 0], rcond=None)[0]
        span.bias = span.bias + (step[0] * self._up() if self.level else step[:3])
        span.steps = self._steps(span.samples, span.bias)
        vectors, *_ = self._differences(span, unknowns)
        off = np.linalg.norm(vectors - np.median(vectors, axis=0), axis=1)
        # Of a vector of three normal variables half are shorter than 1.54 deviations.
        used = off < SLIP * max(float(np.median(off)) / 1.54, self._variance**0.5)
        if used.sum() >= LEAST_SIZE:
            span.used = used


def _delay_in_samples(rates: Floats, turned: Floats) -> int:
    """Return by how many samples the rates of a reference (n, 3) come later than the sensor's.

    Whatever the bias and the rotation between the two, they are fast at the same time.
    """
    speeds = [np.linalg.norm(x - np.median(x, axis=0), axis=1) for x in (rates, turned)]
    ours, theirs = (x - x.mean() for x in speeds)
    inner = ours[REACH:-REACH]
    fits = [inner @ theirs[k : len(inner) + k] for k in range(2 * REACH + 1)]
    return int(np.argmax(fits)) - REACH


def _outer(axes: Floats, angles: Floats) -> Floats:
    """Return for rotations (n, 3, 3) and angles (n, 3) how the former turn each of the latter."""
    return np.asarray(np.einsum('kai,kj->kaij', axes, angles).reshape(-1, 3, 9))


def _mean(rotations_: Floats) -> Floats:
    """Return the mean (4,) of rotations that are near each other."""
    return np.asarray(np.linalg.eigh(rotations_.T @ rotations_)[1][:, -1])
