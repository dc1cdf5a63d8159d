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

"""The message definitions that a bag holds, also those that rosbags can't read.

Those of ROS 2 are copied as they are: `ros2 bag` reads none either. Messages of ROS 1 are converted
by theirs. rosbags' own readers stop at one that is not UTF-8, or in a language that ROS does not
have: here they get what they can read.
"""

import struct
from collections.abc import Mapping
from contextlib import suppress
from functools import lru_cache
from io import BytesIO
from pathlib import Path, PosixPath
from threading import Lock
from typing import Any, BinaryIO

from gyro_drift_filter.bags.library import (
    Connection,
    DirectoryReader,
    McapReader,
    MessageDefinition,
    MessageDefinitionFormat,
    Ros1LibraryReader,
    Ros2LibraryReader,
    RPath,
    Sqlite3Reader,
    Stores,
    Typestore,
    apsw,
    get_types_from_idl,
    get_types_from_msg,
    get_typestore,
)
from gyro_drift_filter.mcap.records import MAGIC, SCHEMA, Fields, record, records, text
from gyro_drift_filter.mcap.recovery import summary_of

# What stands between the definitions of several types in one text, and begins one in IDL.
_LINE = '=' * 80 + '\n'
IDL_BEGIN = f'{_LINE}IDL: '
_ASCII = bytes(range(128)) + b'?' * 128
_LANGUAGES = 'ros2msg', 'ros2idl', 'omgidl'


def types_of(*connections: Connection) -> Typestore:
    """Return the types of connections as they are defined there, but those that can't be read."""
    return _types_as_defined(*((c.msgdef, c.msgtype) for c in connections))


@lru_cache  # a definition takes 10 ms, and is read for each message and each bag
def _types_as_defined(*defined: tuple[MessageDefinition, str]) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    for definition, kind in defined:
        with suppress(Exception):  # whatever the text brings about
            found = _parsed(definition, kind)
            store.register({name: found[name] for name in found.keys() - store.fielddefs.keys()})
    return store


def _parsed(definition: MessageDefinition, name: str) -> Any:
    """Return the types of a definition; lines may end as on Windows, behind a mark of Unicode."""
    written = definition.data.replace('\r\n', '\n').removeprefix('\ufeff')
    if definition.format == MessageDefinitionFormat.MSG:
        return get_types_from_msg(written, name)
    if not written.startswith(IDL_BEGIN):
        return get_types_from_idl(written)
    found: dict[str, Any] = {}
    for part in written.split(_LINE)[1:]:
        found |= get_types_from_idl(part.partition('\n')[2])
    return found


def _utf8(data: bytes) -> bytes:
    """Return a text of the same length that can be read: only its comments may hold other signs."""
    try:
        data.decode()
    except UnicodeDecodeError:
        return data.translate(_ASCII)
    return data


class _Mcap(McapReader):
    """An MCAP file."""

    def read_index(self) -> None:
        """Read the summary."""
        file = self.bio
        assert file
        file.seek(self.data_end)
        self._take(file.read().removesuffix(MAGIC))

    def meta_scan(self) -> None:
        """Read in all of the file what its summary does not tell."""
        assert self.bio
        self.connections.clear()  # those of a summary without schemas have no type
        self._take(summary_of(self.bio))

    def _take(self, summary: bytes) -> None:
        """Have a summary read from which the definitions that can't be read are taken out."""
        file, begin = self.bio, self.data_end
        readable = (
            record(opcode, _schema(content) if opcode == SCHEMA else content)
            for opcode, content in records(summary)
        )
        self.bio, self.data_end = BytesIO(b''.join(readable)), 0
        try:
            super().read_index()
        finally:
            self.bio, self.data_end = file, begin


def _schema(content: bytes) -> bytes:
    """Return the content of a schema record, without a definition that is not one of ROS."""
    fields = Fields(content)
    key, name, language = fields.read('H'), fields.text(), fields.text()
    definition = fields.read(f'{fields.read("I")}s')
    if language not in _LANGUAGES:
        language, definition = '', b''
    return struct.pack('<H', key) + text(name) + text(language) + text(_utf8_text(definition))


# The hooks of apsw are those of all connections, also of other threads.
_hooks = Lock()


class _Sqlite3(Sqlite3Reader):
    """An sqlite3 file."""

    def open(self) -> None:
        """Open the file."""
        with _hooks:
            apsw.connection_hooks.append(_hide_definitions)
            try:
                super().open()
            finally:
                apsw.connection_hooks.remove(_hide_definitions)


def _hide_definitions(connection: apsw.Connection) -> None:
    """Have a view stand before the definitions, with those that are ones of ROS."""
    connection.create_scalar_function('utf8', _utf8_text, 1)
    connection.execute(
        'CREATE TEMP VIEW message_definitions AS SELECT id, topic_type, encoding, '
        'utf8(CAST(encoded_message_definition AS BLOB)) AS encoded_message_definition, '
        'type_description_hash FROM main.message_definitions '
        "WHERE encoding IN ('ros2msg', 'ros2idl')"
    )


def _utf8_text(*definition: Any) -> str:
    return _utf8(*definition).decode()


class _Utf8Path(PosixPath):
    """A path whose text is read as UTF-8: rosbags reads metadata.yaml as the locale has text."""

    def read_text(self, encoding: str | None = None, errors: str | None = None) -> str:
        """Return what a file holds as text."""
        return super().read_text(encoding or 'utf-8', errors)


class _Folder(DirectoryReader):
    """A folder of rosbag2."""

    STORAGE_PLUGINS: Mapping[str, Any] = {'mcap': _Mcap, 'sqlite3': _Sqlite3}

    def __init__(self, path: RPath) -> None:
        super().__init__(_Utf8Path(path) if isinstance(path, Path) else path)


class LibraryOfRos2(Ros2LibraryReader):
    """What rosbags reads of ROS 2."""

    STORAGE_PLUGINS: Mapping[str, Any] = {'dir': _Folder, '.mcap': _Mcap, '.db3': _Sqlite3}


class LibraryOfRos1(Ros1LibraryReader):
    """What rosbags reads of ROS 1."""

    def read_connection(self) -> Connection:
        """Read a topic."""
        file = self.bio
        assert file
        head, fields = _sized(file), _sized(file)
        start = max(fields.find(b'message_definition='), 0)
        end = start + int.from_bytes(fields[start - 4 : start], 'little')
        fields = fields[:start] + _utf8(fields[start:end]) + fields[end:]
        self.bio = BytesIO(head + fields)
        try:
            return super().read_connection()
        finally:
            self.bio = file


def _sized(file: BinaryIO) -> bytes:
    """Return the next part of a file, with the length that it begins with."""
    length = file.read(4)
    return length + file.read(int.from_bytes(length, 'little'))
