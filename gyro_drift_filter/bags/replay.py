"""Replay a bag through the filter: the input's topics and the filter's beside them."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gyro_drift_filter.bags.chunk_replay import chunked_file, replay_chunks
from gyro_drift_filter.bags.library import AnyReader
from gyro_drift_filter.bags.recording import (
    BagError,
    BagWriter,
    messages,
    open_bag,
)
from gyro_drift_filter.bags.replay_run import (
    BATCH_SPAN,
    LARGEST_BATCH,
    Message,
    ReplayRun,
    Summary,
    Topics,
)
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.cdr import IMU_TYPE
from gyro_drift_filter.messages.motion_hint import HINT_TYPES

Progress = Callable[[int, int], None]


def choose_topic(reader: AnyReader, wanted: str | None) -> str:
    """Return the Imu topic to filter: the one wanted, or the only one.

    Raises:
        BagError: There is none, there are several, or the wanted one is of another type; the text
            lists what there is.
    """
    types = {connection.topic: connection.msgtype for connection in reader.connections}
    imus = sorted(topic for topic, kind in types.items() if kind == IMU_TYPE)
    if wanted is not None:
        for topic, kind in types.items():
            if topic.strip('/') == wanted.strip('/'):
                if kind == IMU_TYPE:
                    return topic
                raise BagError(f'topic {topic} is of type {kind}, not {IMU_TYPE}')
        raise BagError(f'no topic {wanted} in the bag; Imu topics: {", ".join(imus) or "none"}')
    if not types:
        raise BagError('the bag is empty: it holds no topic')
    if not imus:
        listed = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(types.items()))
        raise BagError(f'no topic of type {IMU_TYPE} in the bag; it holds {listed}')
    outputs = {Topics.of(topic).filtered for topic in imus}
    inputs = [topic for topic in imus if topic not in outputs]
    if len(inputs) == 1:
        return inputs[0]
    raise BagError(f'several Imu topics: choose one with --topic: {", ".join(imus)}')


def choose_hint(reader: AnyReader, wanted: str) -> str:
    """Return the topic that tells of motion.

    Raises:
        BagError: The bag has no topic of that name, or of a type that could.
    """
    for connection in reader.connections:
        if connection.topic.strip('/') == wanted.strip('/'):
            if connection.msgtype in HINT_TYPES.values():
                return connection.topic
            listed = ', '.join(HINT_TYPES.values())
            raise BagError(f'topic {wanted} is of type {connection.msgtype}, not one of {listed}')
    raise BagError(f'no topic {wanted} in the bag')


def _batches(stream: Iterable[Message]) -> Iterator[list[Message]]:
    """Cut a stream of messages into pieces of at most a second and of bounded length."""
    batch: list[Message] = []
    for message in stream:
        if batch and (len(batch) == LARGEST_BATCH or message[1] - batch[0][1] >= BATCH_SPAN):
            yield batch
            batch = []
        batch.append(message)
    if batch:
        yield batch


def _is_within(path: Path, folder: Path) -> bool:
    """Tell whether a path is a folder or in it."""
    resolved = path.resolve()
    return folder.resolve() in (resolved, *resolved.parents)


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
    topic: str | None = None,
    diagnostics: bool = False,
    hint: str | None = None,
    force: bool = False,
    progress: Progress = lambda done, total: None,
) -> Summary:
    """Filter the Imu topic of a bag and write all into a new bag.

    Messages go through the filter in the order of their log times, and what comes out has the log
    time of what went in. `/diagnostics` is written about once a second.

    Args:
        source: rosbag2 folder or bare .mcap or .db3 file.
        destination: rosbag2 folder to be made.
        parameters: Of the filter.
        topic: The Imu topic, needed where there are several.
        diagnostics: Whether the per-sample topics are written, too.
        hint: Topic by which the robot says whether it moves: Twist, TwistStamped or Odometry.
        force: Whether a bag at the destination is replaced.
        progress: Called with the number of messages done and their total.

    Raises:
        BagError: The source can't be read, holds no Imu, or the destination can't be written.
    """
    if destination.exists() and not force:
        raise BagError(
            f'{destination} exists already: remove it, choose another name or use --force'
        )
    if force and _is_within(source, destination):
        raise BagError(f'{destination} is the bag to be read: choose another name')
    with open_bag(source) as reader:
        chosen = choose_topic(reader, topic)
        hinted = None if hint is None else choose_hint(reader, hint)
        total = reader.message_count
        with _reporting_memory(source), BagWriter(destination, replace=force) as writer:
            run = ReplayRun(reader, writer, chosen, parameters, diagnostics, hinted)
            file = chunked_file(reader)
            if file is not None:
                replay_chunks(file, run, lambda done: progress(done, total))
            else:
                done = 0
                for batch in _batches(messages(reader)):
                    run.take(batch)
                    run.end_batch(batch[0][1], batch[-1][1])
                    done += len(batch)
                    progress(done, total)
            summary = run.finish()
            if summary.received == 0:
                raise BagError(f'topic {chosen} has no messages')
    return summary
