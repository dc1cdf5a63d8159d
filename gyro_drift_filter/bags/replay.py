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

"""Replay a bag through the filter: the input's topics and the filter's beside them."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from gyro_drift_filter.bags.bias_memory import check_replaceable
from gyro_drift_filter.bags.opening import check_path, open_bag
from gyro_drift_filter.bags.output import Output
from gyro_drift_filter.bags.recording import BagError
from gyro_drift_filter.bags.replay_run import ReplayRun, Watch, why_nothing
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.bags.writer import BagWriter, why_not_replaced
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.summary import Summary


@contextmanager
def _reporting_memory(source: Path) -> Iterator[None]:
    """Turn a lack of memory, as a file that lies may bring it about, into one line."""
    try:
        yield
    except MemoryError as error:
        raise BagError(f'{source} holds messages that the memory is too small for') from error


def replay(
    source: Path,
    destination: Path,
    *,
    parameters: Parameters,
    selection: Selection = Selection(),  # noqa: B008  # frozen
    diagnostics: bool = False,
    memory: Path | None = None,
    force: bool = False,
    watch: Watch = Watch(),  # noqa: B008  # frozen
) -> list[Summary]:
    """Filter Imu topics of a bag, each by its own filter, and write all into a new bag.

    Messages go through the filter in the order of their log times, and what comes out has the log
    time of what went in. `/diagnostics` is written about once a second. Reading, filtering and
    writing work side by side, as kernels and compression let go of the interpreter's lock.

    Args:
        source: rosbag2 folder, bare .mcap or .db3 file, or .bag file of ROS 1.
        destination: rosbag2 folder to be made.
        parameters: Of the filters.
        selection: Which topics, and which time.
        diagnostics: Whether the per-sample topics are written, too.
        memory: File of the bias that the recording before has left; it is written at the end.
        force: Whether a bag at the destination is replaced.
        watch: Who is told of what goes on.

    Returns:
        What was done, for each Imu topic.

    Raises:
        BagError: The source can't be read, holds no Imu or none that can be filtered, or the
            destination can't be written.
        MemoryFileError: `memory` can't be written, or holds something else.
    """
    check_path(source)
    _check_destination(destination, source, force=force)
    if memory is not None:
        check_replaceable(memory)
    with open_bag(source) as recording:
        inputs, kept = selection.inputs(recording), selection.keeps(recording)
        if memory is not None and len(inputs) > 1:
            raise BagError('a file of the bias is of one gyroscope: name one Imu topic')
        hint = selection.hint_topic(recording)
        with _reporting_memory(source), BagWriter(destination, replace=force) as writer:
            output = Output(recording, writer, inputs, kept, diagnostics=diagnostics)
            run = ReplayRun(recording, output, parameters, inputs, watch.watcher, hint, memory)
            for piece in selection.pieces(recording, watch.progress):
                run.take(piece)
            summaries = run.finish()
            if not any(summary.written for summary in summaries):
                raise BagError(why_nothing(summaries[0], selection.when))
        run.save_memory()
    return summaries


def _check_destination(destination: Path, source: Path, *, force: bool) -> None:
    """Look whether a bag can be written there.

    Raises:
        BagError: It can't; the text says whether `force` would help.
    """
    # Without symbolic links, but for those that lead back to themselves.
    read, written = (Path(os.path.realpath(path)) for path in (source, destination))
    is_source = written in (read, *read.parents)
    if force and is_source:
        raise BagError(f'{destination} is the bag to be read, or holds it: choose another name')
    folder = read.parent if (read.parent / 'metadata.yaml').is_file() else read
    if folder in written.parents:
        raise BagError(f'{destination} lies within the bag to be read: choose another name')
    if force or not destination.exists():
        return
    head = f'{destination} exists already'
    if why := why_not_replaced(destination):
        raise BagError(f'{head}: choose another name, as it {why}')
    if is_source:
        raise BagError(f'{head}, and is the bag to be read: choose another name')
    raise BagError(f'{head}: remove it, choose another name or use --force')
