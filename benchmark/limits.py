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

"""What a filter can leave of the noise at rest, where the reference has noise of its own.

    python -m benchmark.limits --data FOLDER [--noise SCALE] [--seed N]

FOLDER holds real recordings (this package has none of them): in motion/ the rates of a gyroscope in
the hand, with the samples at rest; in static/ those of another one that stands, whose noise times
SCALE is added. What the first gyroscope measured is the truth, so its own noise counts as motion.
The table says of each recording, and of the same begun in motion, what part of the added noise is
left at rest, as root mean square:

    filter      by this filter
    constant    by the mean rate of each rest, known in hindsight
    best        by the best causal linear filter of each recording (Wiener), given the mean rates
                and the autocovariances of truth and noise
    in windows  by the best one of each 1.28 s, given the same of each; it knows when the body comes
                to rest

Other filters than linear ones may do better than the last two, by what they make of the motion.
"""

import argparse
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_toeplitz
from scipy.signal import correlate

from benchmark.scenarios import stamps
from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.core import Filter
from gyro_drift_filter.doctor.rests import stretches_of

_SAMPLES = 12_000
_COEFFICIENTS = 300
# A window, of so many s, has fewer autocovariances.
_WINDOW, _COEFFICIENTS_OF_WINDOW = 1.28, 30
_LEAST_REST = 10.0  # s


class Trial(NamedTuple):
    """A recording with noise that is known.

    Attributes:
        name: Of the recording.
        rate: In Hz.
        truth: (n, 3) in rad/s.
        accelerations: (n, 3) in m/s^2.
        noise: (n, 3) to be added, in rad/s.
        rests: First sample of each rest, and that behind its last one.
    """

    name: str
    rate: float
    truth: Floats
    accelerations: Floats
    noise: Floats
    rests: Sequence[tuple[int, int]]


def trials(folder: Path, scale: float, random: np.random.Generator) -> Iterator[Trial]:
    """Yield the recordings with enough rest, each from its start and from within its motion."""
    source = np.load(next(iter(sorted((folder / 'static').glob('*.npz')))))['rate'].astype(float)
    noise = scale * (source - source.mean(axis=0))
    for path in sorted((folder / 'motion').glob('*.npz')):
        data = np.load(path)
        rate, rest = float(data['fs']), data['rest']
        in_motion = int(np.argmin(rest) + 10.0 * rate)
        for start, name in ((0, path.stem), (in_motion, f'{path.stem}, begun in motion')):
            part = slice(start, start + _SAMPLES)
            truth, forces = (data[key][part].astype(float) for key in ('rate', 'acc'))
            if rest[part].sum() < _LEAST_REST * rate:
                continue
            first = random.integers(0, len(noise) - len(truth))
            added = noise[first : first + len(truth)]
            rests = [(span.first, span.stop) for span in stretches_of(rest[part], 0)]
            yield Trial(name, rate, truth, forces, added, rests)


def left_by_filter(trial: Trial) -> float:
    """Return the sum of squares that this filter leaves at rest, in (rad/s)^2."""
    rates = trial.truth + trial.noise
    results = Filter().run(stamps(len(rates), trial.rate), rates, trial.accelerations)
    errors = results['angular_velocity'] - trial.truth
    return squares(errors[first:end] for first, end in trial.rests)


def left_by_constant(trial: Trial) -> float:
    """Return the same for the mean rate of each rest."""
    return squares(_about_means(trial, trial.rests))


def left_by_best(trial: Trial, parts: Sequence[tuple[int, int]], coefficients: int) -> float:
    """Return the same for the best causal linear filter of parts of the rests.

    Args:
        trial: The recording.
        parts: First sample of each, and that behind its last one.
        coefficients: Of the filter, on each axis.
    """
    left = 0.0
    for axis in range(3):
        signals = [part[:, axis] for part in _about_means(trial, parts)]
        signal = autocovariances(signals, coefficients)
        noise = autocovariances([trial.noise[:, axis]], coefficients)
        best = solve_toeplitz(signal + noise, signal)  # the equations of Wiener and Hopf
        left += sum(map(len, signals)) * (signal[0] - float(signal @ best))
    return left


def autocovariances(parts: Sequence[Floats], count: int) -> Floats:
    """Return the first autocovariances (count,) over parts (n,) of zero mean."""
    total = np.zeros(count)
    for part in parts:
        some = correlate(part, part)[len(part) - 1 :][:count]
        total[: len(some)] += some
    return total / sum(map(len, parts))


def _about_means(trial: Trial, parts: Iterable[tuple[int, int]]) -> Iterator[Floats]:
    for first, end in parts:
        yield trial.truth[first:end] - trial.truth[first:end].mean(axis=0)


def squares(parts: Iterable[Floats]) -> float:
    """Return the sum of the squares of all values."""
    return float(sum(np.sum(np.square(part)) for part in parts))


def _windows(trial: Trial) -> Iterator[tuple[int, int]]:
    """Yield the windows that rests are cut into, without those that are too short."""
    length = round(_WINDOW * trial.rate)
    for first, end in trial.rests:
        for start in range(first, end - _COEFFICIENTS_OF_WINDOW, length):
            yield start, min(start + length, end)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument('--data', type=Path, required=True, metavar='FOLDER')
    parser.add_argument('--noise', type=float, default=0.1, help='default %(default)s')
    parser.add_argument('--seed', type=int, default=0, help='default %(default)s')
    options = parser.parse_args()
    names, found = [], []
    for trial in trials(options.data, options.noise, np.random.default_rng(options.seed)):
        windows = list(_windows(trial))
        left = [
            left_by_filter(trial),
            left_by_constant(trial),
            left_by_best(trial, trial.rests, _COEFFICIENTS),
            sum(left_by_best(trial, [window], _COEFFICIENTS_OF_WINDOW) for window in windows),
        ]
        of_rests, of_windows = (
            squares(trial.noise[first:end] for first, end in parts)
            for parts in (trial.rests, windows)
        )
        names.append(trial.name)
        found.append(np.sqrt(np.array(left) / [of_rests, of_rests, of_rests, of_windows]))
    rows = [['', 'filter', 'constant', 'best', 'in windows']]
    rows += [
        [name, *map('{:.3f}'.format, figures)] for name, figures in zip(names, found, strict=True)
    ]
    rows.append(['median', *map('{:.3f}'.format, np.median(found, axis=0))])
    print(table(rows))


if __name__ == '__main__':
    main()
