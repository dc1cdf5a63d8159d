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

"""The bias of vehicles that are switched on while they move, and never rest.

    python -m benchmark.without_rest [--seeds N] [--only NAME ...] [--check] [--data FOLDER]

A drone, a car, a legged robot and a sensor in the hand (`simulation/vehicles.py`) start in the
middle of their motion, and give the filter the hint that they move, so that no rest is found. The
table has the error of the bias across the vertical, root mean square over the seeds in 1e-3 rad/s:
at the start, and later with `bias.in_motion` off and on; for a sensor with the turn-on bias of a
cheap one, and for a sensor that has none. The last column is the mean over the first 20 s of the
next run, when the bias has moved by 0.5 deg/s on each axis, without the memory file and with it.

A second table has the error where the robot is switched on in motion with the bias of an earlier
run, which is right or has moved by 0.5 deg/s on each axis since.

FOLDER holds recordings of flights and walks with a known bias. They are run from 35 s on, with a
further bias of some sizes in `--seeds` directions.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import fields, replace
from pathlib import Path

import numpy as np

from benchmark.figures import tell_misses
from benchmark.vehicles import vehicle_parser
from gyro_drift_filter.arrays import Floats, Integers
from gyro_drift_filter.cli.printing import table, tell
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.bias.shift import NO_SHIFT, BiasShift
from gyro_drift_filter.messages.memory_file import REPEATABILITY, RememberedBias
from gyro_drift_filter.rotations import rotate
from gyro_drift_filter.simulation.sensor import DEGREE
from gyro_drift_filter.simulation.vehicles import VEHICLES, Ride, ride

# What is cut off at the start, when all of them stand or begin to move, and at the end, in s.
START, END = 40.0, 14.0
SECONDS, SAMPLE_RATE = 240.0, 200.0
AFTER = (30, 60, 120, 180)  # s
NEXT_SECONDS = 20.0  # s, of the next run
HINT_EVERY = 0.5  # s: a hint holds for one
# A car shows no bias that is worth anything before it has driven for minutes.
SOON_KNOWN = [name for name in VEHICLES if name != 'car']
# Turn-on deviations in rad/s: of a cheap sensor on each axis, and of one that is calibrated.
SENSORS = {'uncalibrated': 2.0 * DEGREE, 'without a bias': 0.0}
# The error in the end is at most this share of that at the start, or this much, in 1e-3 rad/s.
LEFT, NOTHING = 0.35, 5.0
# What has become of a bias of an earlier run, in rad/s. Its error is at most so much, in 1e-3
# rad/s, where it is right, and in the end at most so much of that at the start where it has moved:
# only what is so wrong that it contradicts gravity is corrected.
MEMORIES = {'is right': 0.0, 'has moved': REPEATABILITY}
LARGEST_WHERE_RIGHT, LEFT_OF_MEMORY = 3.0, 0.7
# Of recordings: where they begin and end, in s, and what is added to their bias, in deg/s. Gravity
# is the mean acceleration over so many s.
RECORDED, LANDING, ADDED, GRAVITY_SECONDS = 35.0, 12.0, (0.0, 0.5, 1.0, 2.0), 4.0
RECORDED_AFTER = (30, 40, 60, 80)  # s


def started_in_motion(vehicle: str, seed: int, turn_on: float) -> Ride:
    """Return a ride that begins and ends in motion."""
    whole = ride(VEHICLES[vehicle], seed, SECONDS + START + END, SAMPLE_RATE, 0.0, turn_on)
    return _part(whole, slice(round(START * SAMPLE_RATE), -round(END * SAMPLE_RATE)))


def _part(of: Ride, samples: slice) -> Ride:
    return Ride(**{field.name: getattr(of, field.name)[samples] for field in fields(of)})


def errors_across(of: Ride, *, followed: bool) -> Floats:
    """Return the error of the bias across the vertical, (n,) in 1e-3 rad/s."""
    return errors_of(of, Filter(Parameters(bias_in_motion=followed)))


def errors_of(of: Ride, filter_: Filter) -> Floats:
    """Return the error of a filter's bias across the vertical, (n,) in 1e-3 rad/s."""
    length = round(HINT_EVERY * SAMPLE_RATE)
    parts = []
    for first in range(0, len(of.stamps), length):
        filter_.hint(True)
        part = slice(first, first + length)
        given = of.stamps[part], of.rates[part], of.accelerations[part]
        parts.append(filter_.run(*given)['bias'])
    across = rotate(of.orientations, np.vstack(parts) - of.bias)[:, :2]
    return np.asarray(1e3 * np.linalg.norm(across, axis=1))


def errors_of_next_run(of: Ride, seed: int) -> Floats:
    """Return the mean errors at the start of the next run, in 1e-3 rad/s: forgotten, remembered."""
    first = Filter()
    errors_of(of, first)
    learned = RememberedBias.of(first)
    moved = REPEATABILITY * np.random.default_rng(seed).standard_normal(3)
    start = _part(of, slice(0, round(NEXT_SECONDS * SAMPLE_RATE)))
    start = replace(start, rates=start.rates + moved, bias=start.bias + moved)
    forgotten, remembered = Filter(), Filter()
    if learned is not None:
        learned.give(remembered)
    return np.array([errors_of(start, filter_).mean() for filter_ in (forgotten, remembered)])


def remembering(bias: Floats, shift: BiasShift = NO_SHIFT) -> Filter:
    """Return a filter that is given a bias (3,) in rad/s of an earlier run, known exactly then."""
    filter_ = Filter()
    RememberedBias(bias.tolist(), (0.0, 0.0, 0.0), shift).give(filter_)
    return filter_


def errors_beside_memory(of: Ride, moved: float, seed: int) -> Floats:
    """Return the errors (n,) in 1e-3 rad/s of a filter that is given a bias of an earlier run.

    Since then it has moved by a deviation in rad/s on each axis.
    """
    before = of.bias[0] + moved * np.random.default_rng(seed).standard_normal(3)
    return errors_of(of, remembering(before))


def at_times(errors: Sequence[Floats]) -> Floats:
    """Return the root mean square over rides of errors (n,) at the start and `AFTER` so many s."""
    at = [0, *(round(seconds * SAMPLE_RATE) for seconds in AFTER)]
    return np.asarray(np.sqrt(np.mean(np.square([each[at] for each in errors]), axis=0)))


def recorded(folder: Path, added: float, seeds: int) -> tuple[Floats, Floats]:
    """Return the errors across the vertical of recordings, (n,) in 1e-3 rad/s: without and with.

    Of all recordings in a folder, all directions of what is added in deg/s, and `RECORDED_AFTER`.
    """
    pairs = []
    for path in sorted((folder / 'dead_reckoning').glob('*.npz')):
        data = np.load(path)
        first, last = (
            int(np.searchsorted(data['t'], stamp))
            for stamp in (data['t'][0] + RECORDED * 1e9, data['t'][-1] - LANDING * 1e9)
        )
        stamps, accelerations = data['t'][first:last], data['acc'][first:last].astype(float)
        rates = data['rate'][first:last] - data['hindsight_bias']
        for seed in range(seeds):
            direction = np.random.default_rng(seed).standard_normal(3)
            other = added * DEGREE * direction / np.linalg.norm(direction)
            biases = Filter().run(stamps, rates + other, accelerations)['bias']
            pairs += list(_errors_of(stamps, accelerations, biases, other))
    off, on = np.array(pairs).T
    return off, on


def _errors_of(
    stamps: Integers, accelerations: Floats, biases: Floats, true: Floats
) -> Iterator[tuple[float, float]]:
    """Yield the errors without and with the biases (n, 3), `RECORDED_AFTER` so many s."""
    for seconds in RECORDED_AFTER:
        now = int(np.searchsorted(stamps, stamps[0] + seconds * 1e9))
        if now == len(stamps):
            return
        begin = int(np.searchsorted(stamps, stamps[now] - GRAVITY_SECONDS * 1e9))
        up = accelerations[begin:now].mean(axis=0)
        up /= np.linalg.norm(up)
        errors = (rate - (rate @ up) * up for rate in (true, biases[now] - true))
        off, on = (1e3 * float(np.linalg.norm(error)) for error in errors)
        yield off, on


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table; return 1 where a bar is checked and does not hold."""
    parser = vehicle_parser(__doc__, list(VEHICLES))
    parser.add_argument('--data', type=Path, metavar='FOLDER', help='real recordings')
    options = parser.parse_args(arguments)
    later = (f'after {seconds} s: off  on' for seconds in AFTER)
    rows = [['', 'at the start', *later, 'next run: forgotten  remembered']]
    with_memory = [['bias of an earlier run', 'at the start', *(f'{s} s' for s in AFTER)]]
    missed = []
    for name in options.only:
        for kind, turn_on in SENSORS.items():
            tell(f'riding: {name}, {kind} ...')
            rides = [started_in_motion(name, seed, turn_on) for seed in range(options.seeds)]
            off, on = (
                at_times([errors_across(of, followed=followed) for of in rides])
                for followed in (False, True)
            )
            cells = (f'{a:.1f}  {b:.1f}' for a, b in zip(off[1:], on[1:], strict=True))
            following = [errors_of_next_run(of, seed) for seed, of in enumerate(rides)]
            forgotten, remembered = np.mean(following, axis=0)
            in_next = f'{forgotten:.1f}  {remembered:.1f}'
            rows.append([f'{name}, {kind}', f'{off[0]:.1f}', *cells, in_next])
            if on[-1] > max(LEFT * off[-1], NOTHING):
                missed.append(f'{name}, {kind}: an error of {on[-1]:.1f}e-3 rad/s is left')
        # The rides are those of the sensors without a bias.
        for kind, moved in MEMORIES.items():
            tell(f'riding: {name}, with a memory that {kind} ...')
            errors = [errors_beside_memory(of, moved, seed) for seed, of in enumerate(rides)]
            start, *after = at_times(errors)
            with_memory.append([f'{name}: {kind}', *(f'{error:.1f}' for error in (start, *after))])
            largest = LEFT_OF_MEMORY * start if moved else LARGEST_WHERE_RIGHT
            error = after[-1] if moved else max(after)
            if error > largest:
                missed.append(
                    f'{name}, with a memory that {kind}: an error of {error:.1f}e-3 rad/s'
                )
    print(table(rows))
    print(table(with_memory))
    if options.data:
        rows = [['recorded, with another bias of', 'off', 'on', 'on, worst']]
        for added in ADDED:
            off, on = recorded(options.data, added, options.seeds)
            root = [f'{np.sqrt(np.mean(np.square(errors))):.1f}' for errors in (off, on)]
            rows.append([f'{added} deg/s', *root, f'{on.max():.1f}'])
        print(table(rows))
    return tell_misses(missed, check=options.check)


if __name__ == '__main__':
    sys.exit(main())
