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

"""`gyro_drift doctor`: whether a recording can be trusted."""

import argparse
import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.bag_options import add_bag_argument, add_topic_option
from gyro_drift_filter.cli.packages import needing
from gyro_drift_filter.cli.progress import Progress, prepare_kernels
from gyro_drift_filter.cli.result_files import add_json_option, check_targets, saying
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.errors import printable
from gyro_drift_filter.phrases import counted

if TYPE_CHECKING:
    from gyro_drift_filter.doctor.findings import Finding

# Exit status of a recording with findings.
FOUND = 3
_WIDTH = 100
_HEADS = {'sound': 'ok', 'fault': 'FAULT', 'unknown': '?'}


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Send a recording through the filter, look at units, axes, stamps, counts, '
        'noise and covariances, and print a line for each with what to do. The exit status is 0 '
        'if the recording is sound, and 3 if it has faults.'
    )
    add_bag_argument(command)
    add_topic_option(command)
    add_json_option(command, 'all lines')
    add_time_options(command)


def run(options: argparse.Namespace) -> int:
    """Run the subcommand; return its exit status."""
    when = between(options)
    check_targets({'--json': options.json})
    with needing('the doctor', 'scipy'):
        import scipy.signal  # noqa: F401
    from gyro_drift_filter.doctor.examination import examine
    from gyro_drift_filter.recordings.examined import read_recording

    prepare_kernels()
    with Progress(enabled=True) as progress:
        topic, examined = read_recording(options.bag, options.topic, when, progress)
    findings = examine(examined)
    sound = not any(finding.is_fault for finding in findings)
    text = page(f'{options.bag.absolute().name}, topic {topic}', findings)
    plain = {'bag': str(options.bag), 'topic': topic, 'sound': sound, 'findings': findings}
    with saying(text, options.json, plain):
        pass  # there are no other files
    return 0 if sound else FOUND


def page(source: str, findings: Sequence['Finding']) -> str:
    """Return the page: a verdict on the whole, and two lines or so for each finding."""
    faults = sum(finding.is_fault for finding in findings)
    verdict = 'sound' if not faults else counted(faults, 'fault')
    lines = [f'{printable(source)}: {verdict}', '']
    for finding in findings:
        lines += _wrapped(_HEADS[finding.verdict], f'{finding.name}: {finding.text}')
        if finding.advice:
            lines += _wrapped('   ->', finding.advice)
    return '\n'.join(lines)


def _wrapped(head: str, text: str) -> list[str]:
    return textwrap.wrap(
        printable(text), _WIDTH, initial_indent=f'{head:<6}', subsequent_indent=' ' * 6
    )
