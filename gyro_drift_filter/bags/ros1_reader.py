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

"""Read a ROS 1 bag as if ROS 2 had recorded it: message by message, converted by rosbags.

Types keep their definitions, but for the header, which has lost its sequence number in ROS 2, and
for the one type that was given another name.
"""

import errno
from collections.abc import Iterator
from contextlib import suppress

from gyro_drift_filter.bags.definitions import LibraryOfRos1, types_of
from gyro_drift_filter.bags.library import (
    Connection,
    ConnectionExtRosbag1,
    ConnectionExtRosbag2,
    MessageDefinition,
    MessageDefinitionFormat,
    Stores,
    Typestore,
    get_typestore,
)
from gyro_drift_filter.bags.message_types import types_with
from gyro_drift_filter.bags.qos import RELIABLE, RELIABLE_AND_LATCHED
from gyro_drift_filter.bags.recording import OF_ROS1, BagError, is_cdr
from gyro_drift_filter.bags.rosbags_reader import RosbagsReader, reason_of_library
from gyro_drift_filter.errors import reason

# What to do about a damaged bag.
REINDEX = 'run `rosbag reindex` of ROS 1 on a copy of it, and name that'

_HEADER = 'std_msgs/msg/Header'
_RENAMED = {'tf/msg/tfMessage': 'tf2_msgs/msg/TFMessage'}


class Ros1Reader(RosbagsReader):
    """A `Recording` that is a ROS 1 bag."""

    def __init__(self, library: LibraryOfRos1) -> None:
        """Take over what rosbags has opened."""
        super().__init__(library)
        types = types_of(*library.connections)
        self._types = _types_of_ros2(types)
        self.connections = [self._as_of_ros2(c, types) for c in library.connections]
        self._by_id = {connection.id: connection for connection in self.connections}

    def _reason(self, error: Exception) -> str:
        """Return why no further message can be read: rosbags tells of its own code."""
        return reason(error) if is_of_the_system(error) else f'a part of it is damaged: {REINDEX}'

    def _messages(self) -> Iterator[tuple[Connection, int, bytes]]:
        for of_ros1, log_time, data in super()._messages():
            connection = self._by_id[of_ros1.id]
            if not is_cdr(connection):
                yield connection, log_time, data
                continue
            try:
                converted = bytes(self._types.ros1_to_cdr(data, connection.msgtype))
            except Exception as error:
                raise BagError(
                    f'{self.path}: a message of {connection.topic} can not be converted to ROS 2: '
                    f'{reason_of_library(error)}'
                ) from error
            yield connection, log_time, converted

    def _as_of_ros2(self, connection: Connection, types: Typestore) -> Connection:
        """Return a connection as of ROS 2, in CDR where its messages can be converted."""
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag1)
        qos = RELIABLE_AND_LATCHED if extension.latching else RELIABLE
        name = _RENAMED.get(connection.msgtype, connection.msgtype)
        serialization, written, digest = OF_ROS1, '', ''
        with suppress(Exception):  # whatever an odd definition brings about
            if types.generate_msgdef(connection.msgtype)[1] == connection.digest:
                serialization = 'cdr'
                written = self._types.generate_msgdef(name, ros_version=2)[0]
                digest = self._types.hash_rihs01(name)
        return connection._replace(
            msgtype=name,
            msgdef=MessageDefinition(MessageDefinitionFormat.MSG, written),
            digest=digest,
            ext=ConnectionExtRosbag2(serialization, [qos]),
        )


def is_of_the_system(error: Exception) -> bool:
    """Return whether a file can't be read whatever it holds; a place that is none is damage."""
    return isinstance(error, OSError) and error.errno != errno.EINVAL


def _types_of_ros2(types: Typestore) -> Typestore:
    """Return the types of a ROS 1 bag with the names and the header of ROS 2."""
    store = get_typestore(Stores.EMPTY)
    fields = {_RENAMED.get(name, name): of_type for name, of_type in types.fielddefs.items()}
    store.register(fields | {_HEADER: types_with(_HEADER).fielddefs[_HEADER]})
    return store
