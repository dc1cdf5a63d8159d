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

"""Which part of a recording is replayed: its Imu topics, what is kept beside them, and when."""

import logging
import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from gyro_drift_filter.bags.message_types import is_another_type
from gyro_drift_filter.bags.recording import BagError, Damage, Piece, Recording, topic_types
from gyro_drift_filter.bags.topics import DIAGNOSTICS, Topics, absolute_name, topic_named
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.motion_hint import HINT_TYPES

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Selection:
    """What of a recording is replayed; by default all of it, and its only Imu topic.

    Attributes:
        imu_topics: To be filtered, each by a filter of its own.
        all_imu: Whether all there are shall be, but for what an earlier run has written.
        distinct_outputs: Whether topics that would be filtered to the same name keep their whole
            names in those of their outputs: /imu/data_raw beside /imu/data then gives
            /imu/data_raw_filtered. Else they are refused.
        output_topic: What the filtered topic is called, where only one is filtered.
        kept: Topics that are copied; None for all.
        start: In s of log time since the first message of the recording.
        end: Likewise; messages at that time are the last ones.
        hint: Topic by which the robot says whether it moves: Twist, TwistStamped or Odometry.
    """

    imu_topics: tuple[str, ...] = ()
    all_imu: bool = False
    distinct_outputs: bool = False
    output_topic: str | None = None
    kept: tuple[str, ...] | None = None
    start: float = 0.0
    end: float = math.inf
    hint: str | None = None

    @property
    def is_whole(self) -> bool:
        """Whether it is all of the time."""
        return (self.start, self.end) == (0.0, math.inf)

    @property
    def when(self) -> str:
        """The time as the end of a sentence; empty where it is all of the recording."""
        if self.is_whole:
            return ''
        until = f' to {self.end:g} s' if self.end < math.inf else ' s on'
        return f' from {self.start:g}{until}, counted from the first message of the recording'

    def inputs(self, recording: Recording) -> dict[str, Topics]:
        """Return the names of the outputs by the Imu topic that they belong to.

        Raises:
            BagError: There is no such Imu topic, several without a choice, or two outputs would
                have one name; the text lists what there is.
        """
        if self.all_imu:
            chosen = _all_imus(recording)
            for topic in chosen:
                _check_fields(recording, topic)
        elif self.imu_topics:
            chosen = [choose_topic(recording, topic) for topic in self.imu_topics]
        else:
            chosen = [choose_topic(recording, None)]
        inputs = {topic: Topics.of(topic) for topic in chosen}
        inputs = _with_distinct(inputs, lambda names: names.node, Topics.with_own_node)
        if self.distinct_outputs:
            inputs = _with_distinct(inputs, lambda names: names.filtered, Topics.with_full_name)
        if self.output_topic is not None:
            if len(inputs) > 1:
                raise BagError(f'one output topic for several Imu topics: {", ".join(inputs)}')
            name = _checked_name(self.output_topic, recording)
            inputs = {topic: replace(names, filtered=name) for topic, names in inputs.items()}
        outputs = [names.filtered for names in inputs.values()]
        for output in outputs:
            if output in inputs or outputs.count(output) > 1:
                raise BagError(
                    f'the filtered topic would be {output}, which is another one already: filter '
                    'one topic at a time, and name its output'
                )
        return inputs

    def hint_topic(self, recording: Recording) -> str | None:
        """Return the topic that hints at motion, None where none is wanted.

        Raises:
            BagError: The bag has no topic of that name, or of a type that could.
        """
        if self.hint is None:
            return None
        types = topic_types(recording)
        topic = topic_named(types, self.hint)
        if topic is None:
            raise BagError(f'no topic {self.hint} in the bag')
        if not set(types[topic]) & set(HINT_TYPES.values()):
            kinds, listed = ' and '.join(types[topic]), ', '.join(HINT_TYPES.values())
            raise BagError(f'topic {self.hint} is of type {kinds}, not one of {listed}')
        return topic

    def keeps(self, recording: Recording) -> set[str]:
        """Return the topics that are copied.

        Raises:
            BagError: One that is wanted is not there.
        """
        topics = {connection.topic for connection in recording.connections}
        if self.kept is None:
            return topics
        wanted = {absolute_name(name) for name in self.kept}
        found = {topic for topic in topics if absolute_name(topic) in wanted}
        if missing := wanted - {absolute_name(topic) for topic in found}:
            listed = ', '.join(sorted(topics))
            raise BagError(f'no topic {min(missing)} in the bag; it holds {listed}')
        return found

    def _check_damage(self, damage: Damage, begin: int | None) -> None:
        """Look whether messages are lost within the time, which counts from a log time in ns.

        Raises:
            BagError: They are.
        """
        first, last = damage.seconds(begin)
        if first <= self.end and last >= self.start:
            raise BagError(damage.text(begin))

    def pieces(self, recording: Recording, progress: Callable[[int, int], None]) -> Iterator[Piece]:
        """Yield what lies within the time; tell how many messages are done, and their total.

        Raises:
            BagError: The recording is damaged within the time.
        """
        begin, done = None, 0
        for piece in recording.pieces():
            if piece.damage is not None:
                begin = piece.damage.first if begin is None else begin
                self._check_damage(piece.damage, begin)
            times = piece.rows['log_time']
            if not len(times):
                continue
            begin = int(times[0]) if begin is None else begin
            done += len(times)
            if self.is_whole:
                yield piece
            else:
                # Not by bisection: files of one bag may overlap in time.
                seconds = 1e-9 * (times - begin)
                if recording.in_order and (seconds > self.end).all():
                    return
                within = (seconds >= self.start) & (seconds <= self.end)
                yield Piece(piece.data, piece.rows[within])
            progress(done, recording.message_count)
        if self.is_whole and done < recording.message_count:
            # Of a folder rosbags reads what metadata.yaml has with the same type and QoS.
            _log.warning(
                '%d of %d messages could be read: the metadata.yaml of a folder may be that of '
                'other files; name a file in it instead',
                done,
                recording.message_count,
            )


def choose_topic(recording: Recording, wanted: str | None) -> str:
    """Return the Imu topic to filter: the one wanted, or the only one that has messages.

    Raises:
        BagError: There is none, there are several, or the wanted one is of another type; the text
            lists what there is.
    """
    topic = _only_topic(recording) if wanted is None else _wanted_topic(recording, wanted)
    _check_fields(recording, topic)
    return topic


def _wanted_topic(recording: Recording, wanted: str) -> str:
    types = topic_types(recording)
    topic = topic_named(types, wanted)
    if topic is None:
        imus = ', '.join(_imu_topics(types)) or 'none'
        raise BagError(f'no topic {wanted} in the bag; Imu topics: {imus}')
    if IMU_TYPE not in types[topic]:
        raise BagError(f'topic {topic} is of type {" and ".join(types[topic])}, not {IMU_TYPE}')
    return topic


def _only_topic(recording: Recording) -> str:
    inputs = _all_imus(recording)
    counted = {connection.topic for connection in recording.connections if connection.msgcount}
    filled = [topic for topic in inputs if topic in counted] or inputs
    if len(filled) == 1:
        return filled[0]
    imus = ', '.join(_imu_topics(topic_types(recording)))
    if not recording.message_count:
        raise BagError(f'the Imu topics have no messages: {imus}')
    raise BagError(f'several Imu topics: choose one with --topic: {imus}')


def _imu_topics(types: Mapping[str, Sequence[str]]) -> list[str]:
    """Return the Imu topics of all with their types."""
    return sorted(topic for topic, kinds in types.items() if IMU_TYPE in kinds)


def _check_fields(recording: Recording, topic: str) -> None:
    """Look whether the Imu messages of a topic are of the type that is known.

    Raises:
        BagError: They are of another one.
    """
    for connection in recording.connections:
        is_read = (connection.topic, connection.msgtype) == (topic, IMU_TYPE)
        if is_read and connection.msgcount and is_another_type(connection):
            digest = connection.digest
            raise BagError(
                f'{recording.path}: the {IMU_TYPE} of {topic} is not that of ROS 2, as '
                + (f'its hash is {digest}' if digest else 'its definition has other fields')
            )


def _all_imus(recording: Recording) -> list[str]:
    """Return all Imu topics but those that an earlier run has written."""
    types = topic_types(recording)
    imus = _imu_topics(types)
    if not types:
        raise BagError('the bag is empty: it holds no topic')
    if not imus:
        listed = ', '.join(f'{name} ({" and ".join(types[name])})' for name in sorted(types))
        raise BagError(f'no topic of type {IMU_TYPE} in the bag; it holds {listed}')
    outputs = {names.filtered for topic in imus for names in _possible_names(topic)}
    return [topic for topic in imus if topic not in outputs] or imus


def _checked_name(wanted: str, recording: Recording) -> str:
    """Return the name of a new topic.

    Raises:
        BagError: ROS has no such names, or the topic is there.
    """
    name = absolute_name(wanted)
    if not re.fullmatch(r'(/[A-Za-z_][A-Za-z0-9_]*)+', name):
        raise BagError(f'{wanted!r} is no name of a topic')
    if name in {*topic_types(recording), DIAGNOSTICS}:
        raise BagError(f'there is a topic {name} already: choose another name for the output')
    return name


def _possible_names(topic: str) -> tuple[Topics, Topics]:
    names = Topics.of(topic)
    return names, names.with_full_name(topic)


def _with_distinct(
    inputs: dict[str, Topics],
    name: Callable[[Topics], str],
    renamed: Callable[[Topics, str], Topics],
) -> dict[str, Topics]:
    """Return the names, renamed where several topics share one of them."""
    names = [name(of_topic) for of_topic in inputs.values()]
    return {
        topic: of_topic if names.count(name(of_topic)) == 1 else renamed(of_topic, topic)
        for topic, of_topic in inputs.items()
    }
