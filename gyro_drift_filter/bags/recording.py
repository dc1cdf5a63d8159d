"""Bags in and out, by rosbags: whatever it opens is read, a rosbag2 folder with MCAP is written."""

import logging
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.bags.library import (
    AnyReader,
    AnyReaderError,
    CompressionFormat,
    CompressionMode,
    Connection,
    ConnectionExtRosbag2,
    MessageDefinitionFormat,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
    StoragePlugin,
    Stores,
    Typestore,
    TypesysError,
    Writer,
    WriterError,
    get_types_from_msg,
    get_typestore,
)
from gyro_drift_filter.bags.message_types import all_types, types_with
from gyro_drift_filter.errors import GyroDriftFilterError, reason
from gyro_drift_filter.mcap.records import McapError
from gyro_drift_filter.mcap.recovery import is_cut_off, recover
from gyro_drift_filter.mcap.writer import McapStorage

_log = logging.getLogger(__name__)

_METADATA_VERSION: Literal[9] = 9  # of rosbag2 in Jazzy
_FOREVER = QosTime(2**31 - 1, 2**32 - 1)

_BAG_FILES = ('.mcap', '.db3')

Kind = tuple[str, str, str, tuple[Qos, ...]]

# Reliable, depth 10: what the node publishes with.
RELIABLE = Qos(
    QosHistory.KEEP_LAST,
    10,
    QosReliability.RELIABLE,
    QosDurability.VOLATILE,
    _FOREVER,
    _FOREVER,
    QosLiveliness.AUTOMATIC,
    _FOREVER,
    avoid_ros_namespace_conventions=False,
)


class BagError(GyroDriftFilterError):
    """A bag can't be read or written; the text says which and why."""


@contextmanager
def open_bag(path: Path) -> Iterator[AnyReader]:
    """Open a rosbag2 folder or a bare .mcap or .db3 file for reading.

    Raises:
        BagError: The path is missing, or is no bag that rosbags can read.
    """
    _check_path(path)
    with tempfile.TemporaryDirectory() as folder:
        reader = _opened(_recovered(path, Path(folder)), path)
        try:
            yield reader
        finally:
            reader.close()


def _opened(path: Path, name: Path) -> AnyReader:
    # A file that lies raises nearly anything out of the parser: all of it is a bag that can't be
    # read. Errors of the caller's own pass, as the reader is open by then.
    try:
        reader = AnyReader([path])
        try:
            reader.open()
        except AnyReaderError:  # as of a bag that holds no definitions
            reader = AnyReader([path], default_typestore=all_types())
            reader.open()
    except Exception as error:
        hint = ''
        cut = [file for file in path.glob('*.mcap') if is_cut_off(file)] if path.is_dir() else []
        if cut:
            hint = f' ({cut[0].name} was cut off: name that file, to read it as far as it goes)'
        raise BagError(f'{name} can not be read as a bag: {reason(error)}{hint}') from error
    return reader


def _recovered(path: Path, folder: Path) -> Path:
    """Return a path to open: where an MCAP file was cut off, to a copy of what is whole of it."""
    try:
        if path.suffix != '.mcap' or not is_cut_off(path):
            return path
        copy = folder / path.name
        count = recover(path, copy)
    except McapError as error:
        raise BagError(f'{path} was cut off, and what is there {error}') from error
    except OSError as error:
        raise BagError(
            f'{path} was cut off, and can not be recovered in {folder}: {reason(error)}'
        ) from error
    if count == 0:
        raise BagError(f'{path} was cut off before its first whole message')
    _log.warning(
        '%s was cut off, as when the recorder is killed: read to its last whole message (%d)',
        path,
        count,
    )
    return copy


def _check_path(path: Path) -> None:
    try:
        if not path.exists():
            raise BagError(f'no such bag: {path}')
        if path.is_dir() and not (path / 'metadata.yaml').exists():
            raise BagError(
                f'{path} holds no metadata.yaml, so it is no rosbag2 folder: name the .mcap file '
                'in it'
            )
        if path.suffix == '.bag':
            # rosbags judges by the name.
            raise BagError(
                f'{path}: rename the folder, as names in .bag are taken for ROS 1'
                if path.is_dir()
                else f"{path} is a ROS 1 bag: convert it with 'rosbags-convert' first"
            )
    except OSError as error:
        raise BagError(f'{path} can not be opened: {error.strerror}') from error


def messages(reader: AnyReader) -> Iterator[tuple[Connection, int, bytes]]:
    """Yield connection, log time in ns and bytes of each message, in the order of log times.

    Raises:
        BagError: The bag is damaged from some message on.
    """
    # An empty selection of connections makes rosbags read all, and fail where there are none.
    if not reader.connections:
        return
    iterator = reader.messages()
    while True:
        try:
            connection, log_time, data = next(iterator)
        except StopIteration:
            return
        except Exception as error:
            raise BagError(
                f'{reader.paths[0]} is damaged and can be read no further: {reason(error)}'
            ) from error
        yield connection, log_time, bytes(data)


class _Writer(Writer):
    """rosbags' writer, with metadata.yaml and all, on our own MCAP files."""

    STORAGE_PLUGINS: Mapping[StoragePlugin, Any] = {StoragePlugin.MCAP: McapStorage}


class BagWriter:
    """Write a rosbag2 folder; it gets its name when it is complete.

    Until then it stands in a hidden folder beside, which is removed if writing fails.
    """

    def __init__(self, path: Path, *, replace: bool = False) -> None:
        """Prepare; with `replace` a bag that is there is replaced when the new one is complete."""
        self._path = path.absolute()
        self._replace = replace
        self._copies: dict[Kind, Connection] = {}

    def __enter__(self) -> 'BagWriter':
        """Begin the bag.

        Raises:
            BagError: The path exists already or can't be written.
        """
        with self._reporting():
            if self._path.exists():
                self._check_replacement()
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._folder = tempfile.TemporaryDirectory(
                prefix=f'.{self._path.name}.', suffix='.incomplete', dir=self._path.parent
            )
            # The MCAP file is named after the final folder, as `ros2 bag` names it.
            self._written = Path(self._folder.name) / self._path.name
            self._writer = _Writer(
                self._written, version=_METADATA_VERSION, storage_plugin=StoragePlugin.MCAP
            )
            self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
            self._writer.open()
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
        # With the hidden folder it goes.
        old = Path(self._folder.name) / 'replaced'
        self._path.rename(old)
        try:
            self._written.rename(self._path)
        except BaseException:
            if not self._path.exists():
                old.rename(self._path)
            raise

    def _check_replacement(self) -> None:
        if not self._replace:
            raise BagError(f'{self._path} exists already: remove it or choose another name')
        names = {file.name for file in self._path.iterdir()} if self._path.is_dir() else set()
        others = {n for n in names if n != 'metadata.yaml' and not n.endswith(_BAG_FILES)}
        if 'metadata.yaml' not in names:
            raise BagError(f'{self._path} is no rosbag2 folder, and is not replaced')
        if others:
            raise BagError(
                f'{self._path} holds more than a bag, and is not replaced: {min(others)}'
            )

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
            raise BagError(f'{self._path} can not be written: {reason(error)}') from error

    def copy_connection(self, connection: Connection, reader: AnyReader) -> Connection:
        """Add a topic as it is in another bag, with its QoS and message definition.

        A bag may hold the same topic several times, one for each publisher: they become one.
        """
        known = self._copies.get(kind(connection))
        if known is not None:
            return known
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)
        definition, digest = connection.msgdef.data, connection.digest
        if connection.msgdef.format == MessageDefinitionFormat.NONE or not digest:
            definition, digest = _definition(connection, reader)
        with self._reporting():
            copy = self._writer.add_connection(
                connection.topic,
                connection.msgtype,
                msgdef=definition,
                rihs01=digest,
                serialization_format=extension.serialization_format,
                offered_qos_profiles=extension.offered_qos_profiles,
            )
        self._copies[kind(copy)] = copy
        return copy

    def add_connection(
        self, topic: str, message_type: str, qos: Sequence[Qos] = (RELIABLE,)
    ) -> Connection:
        """Add a topic of a type that Jazzy knows."""
        with self._reporting():
            return self._writer.add_connection(
                topic, message_type, typestore=types_with(message_type), offered_qos_profiles=qos
            )

    def write(self, connection: Connection, log_time: int, data: bytes) -> None:
        """Write a serialized message with its log time in ns.

        Raises:
            BagError: The disk is full or the like.
        """
        with self._reporting():
            self._writer.write(connection, log_time, data)

    def write_bulk(
        self, records: NDArray[np.uint8], channels: NDArray[Any], index: NDArray[Any]
    ) -> None:
        """Write serialized MCAP message records, and say where they stand: see `McapWriter`.

        Raises:
            BagError: The disk is full or the like.
        """
        storage = self._writer.storage
        assert isinstance(storage, McapStorage)
        with self._reporting():
            storage.write_bulk(records, channels, index)


def kind(connection: Connection) -> Kind:
    """Return what tells connections apart for a reader: topic, type, serialization and QoS."""
    extension = connection.ext
    assert isinstance(extension, ConnectionExtRosbag2)
    qos = tuple(extension.offered_qos_profiles)
    return connection.topic, connection.msgtype, extension.serialization_format, qos


def is_cdr(connection: Connection) -> bool:
    """Tell whether a topic's messages are serialized as ROS 2 does; rosbags writes no others."""
    extension = connection.ext
    return isinstance(extension, ConnectionExtRosbag2) and extension.serialization_format == 'cdr'


def _generated(store: Typestore, name: str) -> tuple[str, str]:
    definition, _ = store.generate_msgdef(name, ros_version=2)
    return definition, store.hash_rihs01(name)


def _definition(connection: Connection, reader: AnyReader) -> tuple[str, str]:
    """Return message definition and hash of a type, for bags from before they stood in them."""
    name = connection.msgtype
    with suppress(TypesysError, KeyError):
        return _generated(reader.typestore, name)
    with suppress(TypesysError, KeyError):
        return _generated(types_with(name), name)
    # A type that nobody knows keeps its messages under an empty definition, and the hash of that:
    # readers compare the two.
    unknown = get_typestore(Stores.EMPTY)
    unknown.register(get_types_from_msg('', name))
    return '', unknown.hash_rihs01(name)
