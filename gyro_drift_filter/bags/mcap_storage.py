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

"""Our MCAP files as a storage that rosbags writes bags to."""

import struct
from pathlib import Path

from gyro_drift_filter.bags.library import (
    CompressionMode,
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
)
from gyro_drift_filter.mcap.records import CHANNEL, METADATA, SCHEMA, record, text
from gyro_drift_filter.mcap.writer import McapWriter


class McapStorage(McapWriter):
    """Storage of `rosbags.rosbag2.Writer`; the interface is rosbags' own."""

    def __init__(self, path: Path, compression: CompressionMode) -> None:
        zstd_ = compression == CompressionMode.STORAGE
        super().__init__(path / f'{path.name}.mcap', 'zstd' if zstd_ else '')
        self._keys: dict[str, int] = {}

    def add_msgtype(self, connection: Connection) -> None:
        """Add a message type, before its first connection."""
        plain = connection.msgdef.format == MessageDefinitionFormat.MSG
        key = self._keys[connection.msgtype] = len(self._keys) + 1
        encoding = 'ros2msg' if plain else 'ros2idl'
        fields = text(connection.msgtype), text(encoding), text(connection.msgdef.data)
        self.add_schema(key, record(SCHEMA, struct.pack('<H', key), *fields))

    def add_connection(self, connection: Connection, offered_qos_profiles: str) -> None:
        """Add a topic."""
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)
        metadata = text('offered_qos_profiles') + text(offered_qos_profiles)
        channel = record(
            CHANNEL,
            struct.pack('<HH', connection.id, self._keys[connection.msgtype]),
            text(connection.topic),
            text(extension.serialization_format),
            struct.pack('<I', len(metadata)),
            metadata,
        )
        self.add_channel(connection.id, channel)

    def write(self, connection: Connection, timestamp: int, data: bytes | memoryview) -> None:
        """Write a message with its log time in ns."""
        self.write_message(connection.id, timestamp, data)

    def close(self, version: int, metadata: str) -> None:
        """Write what is left, and the metadata of the bag; close the file."""
        content = text('serialized_metadata') + text(metadata)
        self.finish(record(METADATA, text('rosbag2'), struct.pack('<I', len(content)), content))
