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

"""Write a bag: a rosbag2 folder, by rosbags, with an MCAP file of our own in it."""

import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.definitions import IDL_BEGIN, types_of
from gyro_drift_filter.bags.library import (
    CompressionFormat,
    CompressionMode,
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
    StoragePlugin,
    Stores,
    TypesysError,
    Writer,
    WriterError,
    get_types_from_msg,
    get_typestore,
)
from gyro_drift_filter.bags.mcap_storage import McapStorage
from gyro_drift_filter.bags.message_types import types_with
from gyro_drift_filter.bags.qos import RELIABLE
from gyro_drift_filter.bags.recording import (
    ROSBAG2_SUFFIXES,
    Identity,
    OutputError,
    identity,
)
from gyro_drift_filter.bags.unfinished import UnfinishedFolder, remove_abandoned
from gyro_drift_filter.errors import reason

_log = logging.getLogger(__name__)
_METADATA_VERSION: Literal[9] = 9  # of rosbag2 in Jazzy


class _Writer(Writer):
    """rosbags' writer, with metadata.yaml and all, on our own MCAP files."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {StoragePlugin.MCAP: McapStorage}


def why_not_replaced(path: Path) -> str:
    """Return why what stands at a path is replaced by no bag, in words; empty where it can be."""
    names = {file.name for file in path.iterdir()} if path.is_dir() else set()
    others = {n for n in names if n != 'metadata.yaml' and not n.endswith(ROSBAG2_SUFFIXES)}
    if 'metadata.yaml' not in names:
        return 'is no rosbag2 folder, and is not replaced'
    if others:
        return f'holds more than a bag, and is not replaced: {min(others)}'
    return ''


class BagWriter:
    """Write a rosbag2 folder; it gets its name when it is complete.

    Until then it stands in a hidden folder beside, which is removed if writing fails; those of
    killed processes are removed at the start.
    """

    def __init__(self, path: Path, *, replace: bool = False) -> None:
        """Begin the bag; with `replace` one that is there is replaced when this is complete.

        Where the path is a symbolic link, it is what that leads to.

        Raises:
            OutputError: The path exists already, can't be written, or is that of a file.
        """
        self._path = Path(os.path.realpath(path)) if path.is_symlink() else path.absolute()
        if path.suffix in ROSBAG2_SUFFIXES:
            raise OutputError(f'{path}: what is written is a folder: name it without {path.suffix}')
        self._replace = replace
        self._copies: dict[Identity, Connection] = {}
        self._definitions: dict[str, tuple[str, str]] = {}  # with their hashes, by type
        with self._reporting():
            self._path.parent.mkdir(parents=True, exist_ok=True)
            remove_abandoned(self._path)
            if self._path.exists():
                self._check_replacement()
                if path.is_symlink():
                    _log.warning('%s is a link: the bag %s is replaced', path, self._path)
            self._folder = UnfinishedFolder(self._path)
            # The MCAP file is named after the final folder, as `ros2 bag` names it.
            self._written = self._folder.path / self._path.name
            self._writer = _Writer(
                self._written, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
            )
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()

    def __enter__(self) -> 'BagWriter':
        """Return the writer itself."""
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        """Give the bag its name, or remove it where writing failed."""
        with self._folder:
            try:
                if kind is None:
                    with self._reporting():
                        self._count()
                        self._writer.close()
                        self._take_name()
            finally:
                with suppress(Exception):
                    self._writer.abort()  # does nothing after close

    def _take_name(self) -> None:
        """Give the bag its name; an old one is removed only when the new one stands there."""
        if not self._path.exists():
            self._written.rename(self._path)
            return
        self._check_replacement()
        old = self._folder.replaced  # which goes with the hidden folder
        self._path.rename(old)
        try:
            self._written.rename(self._path)
        except BaseException:
            if not self._path.exists():
                old.rename(self._path)
            raise

    def _check_replacement(self) -> None:
        if not self._replace:
            raise OutputError(f'{self._path} exists already: remove it or choose another name')
        if why := why_not_replaced(self._path):
            raise OutputError(f'{self._path} {why}')

    def _count(self) -> None:
        """Tell rosbags' writer, for metadata.yaml, what has gone past it into the storage."""
        writer = self._writer
        assert isinstance(writer.storage, McapStorage)
        writer.storage.flush()
        writer.counts.update(writer.storage.counts)
        if any(writer.counts.values()):
            writer.min_timestamp = writer.storage.first
            writer.max_timestamp = writer.storage.last

    @contextmanager
    def _reporting(self) -> Iterator[None]:
        """Turn what goes wrong with the disk or the writer into one line."""
        try:
            yield
        except (OSError, WriterError) as error:
            raise OutputError(f'{self._path} can not be written: {reason(error)}') from error

    def copy_connection(self, connection: Connection) -> Connection:
        """Add a topic as it is in a recording, with its QoS and message definition.

        That may hold the same topic several times, one for each publisher: they become one.
        """
        known = self._copies.get(identity(connection))
        if known is not None:
            return known
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)
        # The file holds one definition of each type, and readers compare the hashes with that.
        kind = connection.msgtype
        if kind not in self._definitions:
            self._definitions[kind] = _definition(connection)
        definition, digest = self._definitions[kind]
        with self._reporting():
            copy = self._writer.add_connection(
                connection.topic,
                connection.msgtype,
                msgdef=definition,
                rihs01=digest or 'unknown',
                serialization_format=extension.serialization_format,
                offered_qos_profiles=extension.offered_qos_profiles,
            )
            # rosbags asks for a hash here, though it takes none where it reads.
            self._writer.connections[-1] = copy = copy._replace(digest=digest)
        self._copies[identity(copy)] = copy
        return copy

    def add_connection(self, topic: str, message_type: str) -> Connection:
        """Add a topic of a type that Jazzy knows."""
        with self._reporting():
            return self._writer.add_connection(
                topic,
                message_type,
                typestore=types_with(message_type),
                offered_qos_profiles=[RELIABLE],
            )

    def write(self, connection: Connection, log_time: int, data: bytes) -> None:
        """Write a serialized message with its log time in ns.

        Raises:
            OutputError: The disk is full or the like.
        """
        with self._reporting():
            self._writer.write(connection, log_time, data)

    def write_records(self, records: NDArray[np.uint8], ends: NDArray[np.int64]) -> None:
        """Write MCAP message records that lie behind each other: see `McapWriter`.

        Raises:
            OutputError: The disk is full or the like.
        """
        storage = self._writer.storage
        assert isinstance(storage, McapStorage)
        with self._reporting():
            storage.write_records(records, ends)


def _definition(connection: Connection) -> tuple[str, str]:
    """Return message definition and hash of a type.

    They are as they stand in the recording. Bare files have no hash, so it is made anew; that of a
    definition which can't be read is unknown, and empty. Old bags have neither.
    """
    name, written, digest = connection.msgtype, connection.msgdef.data, connection.digest
    in_idl = connection.msgdef.format != MessageDefinitionFormat.MSG
    if written.strip() and (not in_idl or written.startswith(IDL_BEGIN)):
        with suppress(Exception):  # whatever an odd definition brings about
            digest = digest or types_of(connection).hash_rihs01(name)
        return written, digest
    for store in types_of(connection), types_with(name):
        with suppress(TypesysError, KeyError):
            return store.generate_msgdef(name, ros_version=2)[0], store.hash_rihs01(name)
    # A type that nobody knows keeps its messages under an empty definition, and the hash of that:
    # readers compare the two.
    unknown = get_typestore(Stores.EMPTY)
    unknown.register(get_types_from_msg('', name))
    return '', unknown.hash_rihs01(name)
