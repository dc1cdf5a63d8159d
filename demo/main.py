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

"""The main job end to end: simulate, filter live, filter offline, compare, and draw.

    python -m demo.main OUTPUT_FOLDER

First a robot that drives and stands, with a bias that warms up, spikes and repeated samples: the
verdict, and the heading with and without the filter. Then both experiments of the paper (its
section 4): a motionless gyroscope, and a sinusoid with isolated and consecutive outliers. There the
bias is left in, as the paper does.
"""

import argparse
import shutil
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from demo.figures import draw_dynamic, draw_heading, draw_static
from gyro_drift_filter.arrays import Bools, Floats
from gyro_drift_filter.bags.imu_arrays import read_imu_arrays
from gyro_drift_filter.bags.message_types import read_message
from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import messages
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.replay_run import Watch
from gyro_drift_filter.bags.topics import Topics
from gyro_drift_filter.bags.writer import BagWriter
from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.cli.printing import table
from gyro_drift_filter.cli.replay import describe
from gyro_drift_filter.core import Filter
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.report.verdict import RunWatch
from gyro_drift_filter.simulation.bag import TOPIC, truth_path, write_simulation
from gyro_drift_filter.simulation.drive import SAMPLE_RATE, simulate_drive
from gyro_drift_filter.simulation.experiments import Simulation, SimulationSettings, simulate
from harness.live_node import LOSSLESS, LiveNode

SHIPPED = Path(__file__).parent.parent / 'config' / 'gyro_drift_filter.yaml'
_TOPICS = Topics.of(TOPIC)


def main() -> int:
    """Run the demo; return 0 where live and offline agree."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('output', type=Path, help='folder to be made anew')
    parser.add_argument('--seed', type=int, default=0)
    options = parser.parse_args()
    output: Path = options.output
    driven, helped = output / 'driven', output / 'driven_filtered'
    bag, live = output / 'simulated', output / 'live'
    replayed = {method: output / f'replayed_{method}' for method in METHOD_NAMES}
    heading, static, dynamic = (output / f'{n}.png' for n in ('heading', 'static', 'dynamic'))
    bags = [driven, truth_path(driven), helped, bag, truth_path(bag), live, *replayed.values()]
    written = [*bags, heading, static, dynamic]
    output.mkdir(parents=True, exist_ok=True)
    for path in written:  # of an earlier run
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
    show_drive(options.seed, driven, helped, heading)

    simulation = simulate(SimulationSettings(seed=options.seed))
    write_simulation(bag, simulation)
    print(f'simulated {len(simulation.stamps)} samples at 100 Hz: {bag}')
    print('playing them into the node over ROS 2 ...')
    filter_live(bag, live)
    parameters = read_parameters(SHIPPED).with_names({'bias.enabled': False})
    rates, flags = {'raw': read_rates(bag, TOPIC)}, {}
    for method, path in replayed.items():
        replay(bag, path, parameters=parameters.with_names({'method': method}), diagnostics=True)
        rates[method], flags[method] = read_rates(path, _TOPICS.filtered), read_flags(path)
    online, offline = (
        read_messages(path, _TOPICS.filtered) for path in (live, replayed[parameters.method])
    )
    same, count = online == offline, len(simulation.stamps)
    agree = f'live and offline agree in every bit of {count} messages'
    print(agree if same else 'LIVE AND OFFLINE DIFFER', end='\n\n')
    print(static_table(simulation, rates), end='\n\n')
    print(dynamic_table(simulation, rates, flags), end='\n\n')
    draw_static(static, simulation, rates)
    draw_dynamic(dynamic, simulation, rates)
    print('wrote ' + '\n      '.join(str(path) for path in written))
    return 0 if same else 1


def show_drive(seed: int, driven: Path, helped: Path, figure: Path) -> None:
    """Simulate a robot into a bag, filter it into another one, and show and draw its heading."""
    drive = simulate_drive(seed)
    write_simulation(driven, drive.recording)
    print(f'A robot that drives and stands, its gyroscope warming up: {driven}')
    print(replay_with_verdict(driven, helped), end='\n\n')
    turned = {
        'raw': heading_error(read_rates(driven, TOPIC), drive.rates),
        'adaptive': heading_error(read_rates(helped, _TOPICS.filtered), drive.rates),
    }
    print(heading_table(turned), end='\n\n')
    draw_heading(figure, drive, turned)


def replay_with_verdict(bag: Path, destination: Path) -> str:
    """Filter a bag as `gyro_drift replay` does, and return what that prints."""
    watches = []

    def watched(_: str, filter_: Filter) -> RunWatch:
        watches.append(RunWatch(filter_))
        return watches[0]

    parameters = read_parameters(SHIPPED)
    (summary,) = replay(bag, destination, parameters=parameters, watch=Watch(watcher=watched))
    return describe(watches[0].verdict(summary))


def heading_error(rates: Floats, truth: Floats) -> Floats:
    """Return by how much the heading is off after each sample, (n,) in deg, as rates add up."""
    return np.degrees(np.cumsum((rates - truth)[:, 2]) / SAMPLE_RATE)


def heading_table(turned: Mapping[str, Floats]) -> str:
    """Return how far off the heading is at the end, and what that is in a minute."""
    seconds = len(turned['raw']) / SAMPLE_RATE
    rows = [['', 'off by (deg)', 'in a minute (deg)']]
    rows += [[n, f'{e[-1]:.2f}', f'{60.0 * e[-1] / seconds:.2f}'] for n, e in turned.items()]
    return f'The heading after {seconds:.0f} s, beside the true one\n' + table(rows)


def filter_live(bag: Path, destination: Path) -> None:
    """Play the Imu messages of a bag into the real node and record what it publishes."""
    with open_bag(bag) as reader:
        played = [
            (time, data) for connection, time, data in messages(reader) if connection.topic == TOPIC
        ]
    arguments = ['--params-file', str(SHIPPED), '-p', 'bias.enabled:=false', *LOSSLESS]
    with LiveNode(arguments) as node:
        published = node.play([data for _, data in played])
    with BagWriter(destination) as writer:
        connection = writer.add_connection(_TOPICS.filtered, IMU_TYPE)
        for (time, _), data in zip(played, published, strict=True):
            writer.write(connection, time, data)


def read_messages(bag: Path, topic: str) -> list[bytes]:
    """Return the serialized messages of a topic."""
    with open_bag(bag) as reader:
        return [data for connection, _, data in messages(reader) if connection.topic == topic]


def read_rates(bag: Path, topic: str) -> Floats:
    """Return the angular velocity (n, 3) in rad/s of an Imu topic."""
    return read_imu_arrays(bag, topic).angular_velocity


def read_flags(bag: Path) -> Bools:
    """Return the outlier flags (n, 3) that a replay with diagnostics has written."""
    topic = _TOPICS.sample('outlier')
    with open_bag(bag) as reader:
        vectors = [
            read_message(data, connection).vector
            for connection, _, data in messages(reader)
            if connection.topic == topic
        ]
    return np.array([(v.x, v.y, v.z) for v in vectors]) > 0


def static_table(simulation: Simulation, rates: Mapping[str, Floats]) -> str:
    """Return the paper's Table 2: mean and standard deviation on the motionless part."""
    still = ~simulation.moving
    raw = rates['raw'][still]
    error = standard_error(raw)
    rows = [['', 'mean (rad/s)', 'shift (standard errors)', 'std (rad/s)', 'std / raw']]
    for name, rate in rates.items():
        for i, axis in enumerate(AXES):
            mean, deviation = rate[still, i].mean(), rate[still, i].std()
            rows.append(
                [
                    f'{name} {axis}',
                    f'{mean:.6f}',
                    f'{(mean - raw[:, i].mean()) / error[i]:.2f}',
                    f'{deviation:.6f}',
                    f'{deviation / raw[:, i].std():.3f}',
                ]
            )
    return 'Static experiment: the mean stays, the deviation falls\n' + table(rows)


def standard_error(rate: Floats) -> Floats:
    """Return the standard error of the mean (3,), from means of blocks, as noise is correlated."""
    blocks = np.array([block.mean(axis=0) for block in np.array_split(rate, 30)])
    return np.asarray(blocks.std(axis=0, ddof=1) / np.sqrt(len(blocks)))


def dynamic_table(
    simulation: Simulation,
    rates: Mapping[str, Floats],
    flags: Mapping[str, Bools],
) -> str:
    """Return error against truth, and what became of the outliers, on the sinusoid."""
    moving, outliers = simulation.moving, simulation.outliers
    injected = int(outliers.sum())
    rows = [['', 'rms error', 'largest error', 'injected', 'flagged', 'missed', 'false flags']]
    for name, rate in rates.items():
        error = (rate - simulation.truth)[moving]
        row = [name, f'{np.sqrt((error**2).mean()):.6f}', f'{np.abs(error).max():.6f}']
        if name in flags:
            caught = int(flags[name][outliers].sum())
            false = int(flags[name][~outliers & moving[:, None]].sum())
            row += [str(injected), str(caught), str(injected - caught), str(false)]
        else:
            row += [str(injected), '', '', '']
        rows.append(row)
    return 'Dynamic experiment: sinusoid with outliers, error in rad/s, all axes\n' + table(rows)


if __name__ == '__main__':
    sys.exit(main())
