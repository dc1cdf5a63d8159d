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

"""`gyro_drift explain`: why samples of a recording were flagged, and what became of them."""

import argparse
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from gyro_drift_filter.cli.bag_options import add_bag_argument, add_topic_option
from gyro_drift_filter.cli.filter_options import (
    add_hint_option,
    add_method_option,
    add_params_option,
    chosen_parameters,
)
from gyro_drift_filter.cli.progress import Progress, prepare_kernels
from gyro_drift_filter.cli.result_files import add_json_option, check_targets, saying
from gyro_drift_filter.cli.time_options import add_time_options, between
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.errors import printable
from gyro_drift_filter.phrases import counted

if TYPE_CHECKING:
    from gyro_drift_filter.report.flagged import FlaggedSequence, UnflaggedSamples

# As long as a page that somebody reads.
_MOST_LISTED = 200
_HEAD = '       s axis samples     rate innovation  threshold least_jump deviations'


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add description and arguments to the parser of the subcommand."""
    command.description = (
        'Send a recording through the filter and list the samples that it flagged, '
        'of several in a row the first one: when, on which axis, by how much they missed their '
        'prediction, the limits that this was held against, why it was too much, and what the next '
        'sample showed.'
    )
    add_bag_argument(command)
    add_topic_option(command)
    add_params_option(command)
    add_method_option(command)
    add_hint_option(command)
    add_json_option(command, 'all lines')
    add_time_options(command)


def run(options: argparse.Namespace) -> None:
    """Run the subcommand."""
    from gyro_drift_filter.bags.recording import BagError
    from gyro_drift_filter.bags.selection import Selection
    from gyro_drift_filter.recordings.filtered import read_flagged

    start, end = between(options)
    check_targets({'--json': options.json})
    parameters = chosen_parameters(options)
    prepare_kernels()
    # The whole recording, so that each sample meets the filter as it met it on the robot.
    topics = (options.topic,) if options.topic else ()
    selection = Selection(imu_topics=topics, hint=options.motion_hint)
    with Progress(enabled=True) as progress:
        summary, log = read_flagged(options.bag, parameters, selection, progress)
    if start > summary.seconds:
        raise BagError(f'the recording lasts for {summary.seconds:g} s, and ends before --start')
    sequences = [
        sequence
        for sequence in log.sequences
        if start <= 1e-9 * (sequence.log_time - summary.start) <= end
    ]
    unflagged = log.unflagged(summary.start, start, end)
    named = _named(sequences, unflagged, parameters)
    source = f'{options.bag.absolute().name}, topic {summary.topic}, {parameters.method}'
    text = page(source, sequences, summary.start, named, unflagged)
    plain = {
        'bag': str(options.bag),
        'topic': summary.topic,
        'method': parameters.method,
        'start': summary.start,
        'parameters': named,
        'flagged': sequences,
        'unflagged': unflagged,
    }
    with saying(text, options.json, plain):
        pass  # there are no other files


def page(
    source: str,
    sequences: Sequence['FlaggedSequence'],
    start: int,
    named: Mapping[str, Any],
    unflagged: Sequence['UnflaggedSamples'] = (),
) -> str:
    """Return the page: why and what came of it, of all together, then three lines for each.

    Times are counted from `start`, a log time in ns. `named` are the values of the parameters that
    are named in what is said of samples.
    """
    samples = sum(sequence.samples for sequence in sequences)
    sequences_flagged = counted(len(sequences), 'sequence')
    flagged = (
        f'{counted(samples, "sample")} flagged in {sequences_flagged} (each axis counted by itself)'
    )
    lines = [f'{printable(source)}: {flagged if sequences else "no sample flagged"}']
    if sequences:
        lines += ['', 'Why:', *_tally(sequence.reason for sequence in sequences)]
        lines += ['', 'What the next sample showed:', *_tally(map(_outcome, sequences))]
    if unflagged:
        lines += ['', 'Not flagged, and decided by other rules than the two limits:']
        lines += [line for each in unflagged for line in _lines_of_unflagged(each, start)]
    if named:
        lines += ['', 'The parameters that are named here:']
        lines += [f'{value!s:>8}  {name}' for name, value in named.items()]
    if not sequences:
        return '\n'.join(lines)
    listed = _farthest(sequences)
    which = 'each sequence'
    if len(listed) < len(sequences):
        which = f'the {len(listed)} sequences with most deviations'
    lines += ['', f'The first sample of {which}, with rates in rad/s:', '', _HEAD]
    for sequence in listed:
        lines += _lines_of_sequence(sequence, start)
    if more := len(sequences) - len(listed):
        of_time = '--start and --end show those of a time'
        lines += ['', f'and {counted(more, "more sequence")}: {of_time}, --json writes all']
    return '\n'.join(lines)


def _farthest(sequences: Sequence['FlaggedSequence']) -> list['FlaggedSequence']:
    """Return those that are listed, in order: where they are too many, with most deviations."""
    numbers = range(len(sequences))
    farthest = sorted(numbers, key=lambda k: _deviations(sequences[k]) or 0.0, reverse=True)
    return [sequences[k] for k in sorted(farthest[:_MOST_LISTED])]


def _deviations(sequence: 'FlaggedSequence') -> float | None:
    """Return by how many deviations a rate missed its prediction, None where it was no rate."""
    if sequence.innovation == 0.0 or sequence.deviation <= 0.0:
        return None
    return abs(sequence.innovation) / sequence.deviation


def _lines_of_unflagged(samples: 'UnflaggedSamples', start: int) -> list[str]:
    """Return two lines: of which samples, and what was decided of them."""
    first, last, longest = (
        f'{1e-9 * (time - start):.3f}'
        for time in (samples.first, samples.last, samples.longest_start)
    )
    when = f'at {first} s' if samples.samples == 1 else f'from {first} to {last} s'
    if samples.longest > 1:
        when += f', up to {samples.longest} in a row, at {longest} s'
    of_axis = f'{samples.samples:8}  {AXES[samples.axis]}, {when}'
    return [of_axis, f'             {samples.reason}']


def _lines_of_sequence(sequence: 'FlaggedSequence', start: int) -> list[str]:
    """Return three lines: the first sample below `_HEAD`, why it was flagged, what came of it."""
    seconds = 1e-9 * (sequence.log_time - start)
    deviations = _deviations(sequence)
    innovation = None if deviations is None else sequence.innovation
    limits = sequence.innovation_threshold, sequence.least_jump
    return [
        f'{seconds:8.3f} {AXES[sequence.axis]:>4} {sequence.samples:7} {sequence.rate:8.3g} '
        + ' '.join(map(_cell, (innovation, *limits, deviations))),
        f'         {sequence.reason}',
        f'         -> {_outcome(sequence)}',
    ]


def _named(
    sequences: Sequence['FlaggedSequence'],
    unflagged: Sequence['UnflaggedSamples'],
    parameters: Parameters,
) -> dict[str, Any]:
    """Return the values of the parameters that are named in what is said of samples."""
    texts = {text for sequence in sequences for text in (sequence.reason, _outcome(sequence))}
    texts |= {samples.reason for samples in unflagged}
    words = {word for text in texts for word in re.findall(r'[a-z_.]*[a-z_]', text)}
    return {name: value for name, value in parameters.names().items() if name in words}


def _cell(value: float | None) -> str:
    """Return a number as wide as its column, or a dash where there is none."""
    return f'{"-":>10}' if value is None else f'{value:10.3g}'


def _tally(texts: Iterable[str]) -> list[str]:
    """Return a line for each text that there is, the most frequent one first."""
    return [f'{count:8}  {text}' for text, count in Counter(texts).most_common()]


def _outcome(sequence: 'FlaggedSequence') -> str:
    """Return what the next sample showed."""
    return 'the recording ends here' if sequence.outcome is None else sequence.outcome
