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

"""`gyro_drift calibrate`: scale and misalignment from a recording of turns by hand."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.bag_options import BAG, add_topic_option, distinct_paths
from gyro_drift_filter.cli.packages import needing
from gyro_drift_filter.cli.printing import say, tell
from gyro_drift_filter.cli.progress import Progress
from gyro_drift_filter.cli.result_files import add_json_option, check_targets, saying
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.errors import GyroDriftFilterError, printable, yaml_reason
from gyro_drift_filter.whole_file import write_whole

if TYPE_CHECKING:
    from gyro_drift_filter.calibrate.calibration import Samples

# Exit status where entries are not known well: they are named.
INCOMPLETE = 3
# What a calibration of another program needs; all other options are about recordings.
_OF_CALIBRATIONS = ('command', 'bags', 'output')


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Find the rests of recordings in which the sensor was laid down on its sides '
        'by hand, and the matrix by which its rates carry gravity from rest to rest; write a '
        'parameter file that the node and replay read. docs/calibration.md says how to record.'
    )
    command.add_argument(
        'bags',
        type=Path,
        nargs='+',
        metavar='BAG',
        help=f"of one sensor: {BAG}; or a file of Kalibr's (.yaml) or of imu_tk's (.calib), to be "
        'written as a parameter file',
    )
    command.add_argument('-o', '--output', type=Path, required=True, help='parameter file to write')
    add_json_option(command, 'all results')
    command.add_argument(
        '--plot',
        type=Path,
        metavar='FOLDER',
        help='draw the rates with the rests, and by how much turns miss gravity, as PNG files',
    )
    command.add_argument(
        '--kalibr', type=Path, metavar='FILE', help='write it for Kalibr and OpenVINS, too'
    )
    add_topic_option(command, 'a bag')
    add_time_options(command)
    command.add_argument(
        '--turns',
        action='store_true',
        help='between two rests on the same side the sensor was turned by whole turns, and pushed '
        'back against the same edge of a table',
    )
    command.add_argument(
        '--reference',
        metavar='TOPIC',
        help='orientation from elsewhere in the same bag: a pose, transform, quaternion, odometry '
        'or the orientation of an Imu; its rotation to the sensor and its delay are found',
    )
    command.set_defaults(parser=command)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand; return its exit status."""
    with needing('calibration', 'scipy'):
        from gyro_drift_filter.calibrate.calibration import calibrate
        from gyro_drift_filter.calibrate.exchange import lacking, to_kalibr
        from gyro_drift_filter.cli.calibration_report import parameter_file, report
    if options.plot:
        with needing('--plot', 'matplotlib'):
            from gyro_drift_filter.cli.calibration_figures import draw
    check_targets(
        {'-o': options.output, '--json': options.json, '--kalibr': options.kalibr},
        {'--plot': options.plot},
    )
    if options.bags[0].suffix in ('.yaml', '.yml', '.calib') and options.bags[0].is_file():
        _convert(options)
        return 0
    distinct_paths(options.bags)  # a recording that counts twice would seem to be known better
    topics, recordings = zip(*[_read(bag, options) for bag in options.bags], strict=True)
    with Progress(enabled=True, unit='matrices tried') as progress:
        result = calibrate(recordings, turns=options.turns, progress=progress)
    warnings = (f'warning: {warning}' for warning in (*result.warnings, *result.unknown))
    with saying(report(result), options.json, result, warnings) as written:
        source = printable(', '.join(bag.absolute().name for bag in options.bags))
        write_whole(options.output, parameter_file(result, source))
        written.append(options.output)
        if options.kalibr:
            beside = (
                None if found is None else found.matrix
                for found in (result.accelerometer, result.sensitivity)
            )
            write_whole(options.kalibr, to_kalibr(result.noise, topics[0], result.matrix, *beside))
            written.append(options.kalibr)
        if options.plot:
            written += draw(options.plot, result, recordings)
    if options.kalibr and (text := lacking(result.noise)):
        tell(f'note: {text}')
    return INCOMPLETE if result.unknown else 0


def _convert(options: argparse.Namespace) -> None:
    """Write the calibration of another program as a parameter file.

    Raises:
        GyroDriftFilterError: It can't be read, or is no calibration of a gyroscope.
    """
    import yaml

    from gyro_drift_filter.calibrate.exchange import from_imu_tk, from_kalibr
    from gyro_drift_filter.cli.calibration_report import foreign_file

    path = options.bags[0]
    if len(options.bags) > 1:
        raise GyroDriftFilterError(f'{path} is a calibration: name it alone')
    given = [
        name
        for name, value in vars(options).items()
        if name not in _OF_CALIBRATIONS and value != options.parser.get_default(name)
    ]
    if given:
        raise GyroDriftFilterError(
            f'{path} is a calibration, not a recording: leave out --{", --".join(given)}'
        )
    try:
        text = path.read_text(encoding='utf-8')
        kalibr = path.suffix != '.calib'
        found = from_kalibr(yaml.safe_load(text)) if kalibr else from_imu_tk(text)
    except UnicodeDecodeError as error:
        raise GyroDriftFilterError(f'{path} is no text in UTF-8') from error
    except (yaml.YAMLError, RecursionError) as error:
        raise GyroDriftFilterError(f'{path} is no YAML: {yaml_reason(error)}') from error
    write_whole(options.output, foreign_file(found, printable(path.name)))
    say(f'wrote {options.output}')


def _read(bag: Path, options: argparse.Namespace) -> tuple[str, 'Samples']:
    """Return the topic and the samples of a bag."""
    from gyro_drift_filter.bags.orientations import read_orientations
    from gyro_drift_filter.calibrate.calibration import Samples
    from gyro_drift_filter.calibrate.reference import Reference
    from gyro_drift_filter.identify.series import stacked
    from gyro_drift_filter.recordings.samples import read_samples

    with Progress(enabled=True) as progress:
        found = read_samples(bag, options.topic, between(options), progress)
    for note in found.notes():
        tell(f'note: {bag}: {note}')
    going_on, reference = found.going_on(), None
    if options.reference:
        seen = read_orientations(bag, options.reference)
        reference = Reference(going_on(seen.stamps), seen.orientations)
    stamps = going_on(found.stamps[:])
    samples = Samples(stamps, stacked(found.rates), stacked(found.accelerations), reference)
    return found.topic, samples
