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

"""Long runs, by hand: a day of data through the core, and the real node under random commands.

    PYTHONPATH=test python -m support.soak core [--hours 24]
    PYTHONPATH=test python -m support.soak node [--minutes 20]

Ends with status 1, and says why, where something is not as it should be.
"""

import argparse
import sys
import time

import numpy as np
import psutil
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter
from std_srvs.srv import Trigger

from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.cli.main import main as gyro_drift
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.methods.noise import LEAST_NOISE
from gyro_drift_filter.core.sample import LARGEST_RATE, SampleStatus
from gyro_drift_filter.simulation.bag import imu_message
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from harness.live_node import LOSSLESS, LiveNode
from support.paths import NAMES, RECORDINGS

RATE = 200.0
PIECE = 100_000  # samples
LARGEST_GROWTH = 5.0  # MB

# What is set at random while the node runs.
CHANGES = (
    ('method', METHOD_NAMES),
    ('forgetting_factor', (0.95, 0.98, 0.999)),
    ('outlier.enabled', (True, False)),
    ('outlier.threshold', (5.0, 9.0, 20.0)),
    ('outlier.run', (1, 3, 10)),
    ('sample_rate', (0.0, 100.0, 500.0)),
    ('bias.enabled', (True, False)),
    ('bias.max', (0.05, 0.17)),
    ('epsilon', (1e-3, 2e-2)),
    ('model.noise_deviation', ([0.0] * 3, [0.01] * 3)),
    ('forgetting_factor', (0.1, -3.0)),  # refused
)


def real_data():
    """Return rates and accelerations (n, 3) of all recordings, or simulated ones without them."""
    if not RECORDINGS.exists():
        data = simulate(SimulationSettings(static_seconds=600, dynamic_seconds=600))
        return data.angular_velocity, data.linear_acceleration
    bags = [read_imu_arrays(RECORDINGS / name) for name in NAMES]
    return (
        np.concatenate([bag.angular_velocity for bag in bags]),
        np.concatenate([bag.linear_acceleration for bag in bags]),
    )


def with_faults(random, stamps, rates, accelerations):
    """Strew faults into a piece, about one in two thousand samples; all in place."""
    n = len(stamps)
    for place in random.integers(0, n - 400, n // 2000):
        length = int(random.integers(1, 300))
        part = slice(place, place + length)
        match random.integers(0, 12):
            case 0:
                rates[part, random.integers(0, 3)] = np.nan
            case 1:
                rates[place] = np.inf
            case 2:
                rates[place, random.integers(0, 3)] += random.choice([-30.0, 5.0, 1e300])
            case 3:
                rates[place : place + 3] = 0.0
            case 4:
                rates[part], accelerations[part] = rates[place], accelerations[place]
            case 5:
                stamps[place:] += int(random.choice([1e8, 1e10, 3.6e12]))
            case 6:
                stamps[place:] -= int(random.choice([1e7, 1e9, 1e11]))
            case 7:
                stamps[part] = stamps[place]
            case 8:
                stamps[part] = 0
            case 9:
                accelerations[part] = np.nan
            case 10:
                rates[part] = np.clip(20.0 * rates[part], -8.73, 8.73)
            case 11:
                stamps[part] += random.integers(-4_000_000, 4_000_000, length)


def memory():
    """Return the resident memory of this process in MB."""
    return psutil.Process().memory_info().rss / 1e6


def soak_core(hours):
    """Take hours of data through `adaptive` and check every sample."""
    random = np.random.default_rng(0)
    rates, accelerations = real_data()
    samples = round(hours * 3600 * RATE)
    filter_, now, done = Filter(Parameters()), 10**18, 0
    least, largest, memories = np.inf, 0.0, []
    while done < samples:
        place = random.integers(0, len(rates) - PIECE)
        piece = rates[place : place + PIECE].copy()
        forces = accelerations[place : place + PIECE].copy()
        stamps = now + np.round(np.arange(PIECE) * 1e9 / RATE).astype(np.int64)
        with_faults(random, stamps, piece, forces)
        now = int(stamps.max()) + 5_000_000
        results = filter_.run(stamps, piece, forces)
        good = results[results['status'] != SampleStatus.REFUSED]
        for name in results.dtype.names:
            assert np.isfinite(good[name]).all(), name
        assert np.abs(good['angular_velocity']).max() < 2.0 * LARGEST_RATE
        assert np.abs(good['bias']).max() <= filter_.parameters.bias_max
        noise = good['measurement_noise']
        assert (noise >= LEAST_NOISE**2).all()
        assert (good['process_noise'] >= 0.0).all()
        assert (good['innovation_variance'] > 0.0).all()
        assert (good['angular_velocity_variance'] > 0.0).all()
        least, largest = min(least, noise.min()), max(largest, noise.max())
        done += PIECE
        memories.append(memory())
    counts, stuck = filter_.state['counts'], filter_.state['checks']['times_stuck']
    # The least of several pieces, as the array of one comes and goes.
    growth = min(memories[-10:]) - min(memories[10:20], default=np.inf)
    print(
        f'{done:,} samples, {counts["outliers"].sum():,} outliers, {stuck} times stuck, '
        f'{filter_.state["clock"]["restarts"]} restarts, {filter_.state["bias"]["segments"]:,} '
        f'rests; noise {np.sqrt(least):.2g} to {np.sqrt(largest):.2g} rad/s; '
        f'memory {growth:+.1f} MB'
    )
    assert growth < LARGEST_GROWTH, 'memory grows'


class Player:
    """Publishes at an even rate, and counts what has to come back."""

    def __init__(self, live, rates, accelerations, rate):
        self.live, self.rate = live, rate
        self._rates, self._accelerations = rates, accelerations
        self.sent = self.lost = 0
        self._begin = time.monotonic()
        self._began = time.time_ns()

    def restart(self):
        """End the publisher, and begin another one; the first messages may not arrive."""
        self.live.restart_player()
        before = len(self.live.received)
        while len(self.live.received) == before:
            self._publish()
            end = time.monotonic() + 0.2
            while len(self.live.received) == before and time.monotonic() < end:
                self.live.spin(0.01)
        # Let those that do arrive late do so.
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            self.live.spin(0.01)
        self.lost = self.sent - len(self.live.received)
        self._begin = time.monotonic() - self.sent / self.rate

    def play(self, seconds):
        """Publish for so long."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            while self.sent < (time.monotonic() - self._begin) * self.rate:
                self._publish()
            self.live.spin(0.002)

    def _publish(self):
        k = self.sent % len(self._rates)
        stamp = self._began + round(self.sent * 1e9 / self.rate)
        self.live.publish(imu_message(stamp, self._rates[k], self._accelerations[k]))
        self.sent += 1

    @property
    def due(self):
        """How many messages have to have come back."""
        return self.sent - self.lost


def soak_node(minutes, rate=500.0):
    """Play to the real node for minutes, with random sets, resets and other publishers."""
    random = np.random.default_rng(0)
    rates, accelerations = real_data()
    with LiveNode(LOSSLESS) as live:
        name = '/gyro_drift_filter'
        sets = live.node.create_client(SetParameters, f'{name}/set_parameters')
        resets = live.node.create_client(Trigger, f'{name}/reset')
        process = psutil.Process(live.process.pid)
        player = Player(live, rates, accelerations, rate)
        end, count, refused, first = time.monotonic() + 60 * minutes, [0, 0, 0], 0, 0.0
        settled = time.monotonic() + 60.0
        while time.monotonic() < end:
            player.play(random.uniform(0.2, 2.0))
            what = int(random.choice([0, 0, 0, 0, 1, 2]))
            count[what] += 1
            if what == 0:
                key, values = CHANGES[random.integers(len(CHANGES))]
                value = values[random.integers(len(values))]
                request = SetParameters.Request(
                    parameters=[Parameter(key, value=value).to_parameter_msg()]
                )
                future = sets.call_async(request)
                player.play(0.2)
                live.wait(future.done, 'an answer')
                refused += not future.result().results[0].successful
            elif what == 1:
                future = resets.call_async(Trigger.Request())
                player.play(0.2)
                live.wait(future.done, 'an answer')
                assert future.result().success
            else:
                live.wait(lambda: len(live.received) >= player.due, 'all messages')
                player.restart()
            if not first and time.monotonic() > settled:
                first = process.memory_info().rss / 1e6
        live.wait(lambda: len(live.received) >= player.due, 'the last message')
        growth = process.memory_info().rss / 1e6 - first
        print(
            f'{player.sent:,} messages at {rate:g} Hz, {player.lost} lost while the publisher was '
            f'another one, none else; {count[0]} sets ({refused} refused), {count[1]} resets, '
            f'{count[2]} other publishers; memory {growth:+.1f} MB'
        )
    assert live.returncode == 0
    assert growth < LARGEST_GROWTH, 'memory grows'


def main():
    """Run one of them."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('what', choices=['core', 'node'])
    parser.add_argument('--hours', type=float, default=24.0)
    parser.add_argument('--minutes', type=float, default=20.0)
    options = parser.parse_args()
    gyro_drift(['compile'])  # after a cold start more comes at once than the queues hold
    try:
        if options.what == 'core':
            soak_core(options.hours)
        else:
            soak_node(options.minutes)
    except (AssertionError, TimeoutError) as error:
        print(f'failed: {error!r}', file=sys.stderr)
        return 1
    return 0


if __name__ == '__main__':
    sys.exit(main())
