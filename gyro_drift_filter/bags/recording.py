"""Bags in and out, by rosbags: whatever it opens is read, a rosbag2 folder with MCAP is written."""

import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Literal

from gyro_drift_filter.core.errors import GyroDriftFilterError

try:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.interfaces import (
        Connection,
        ConnectionExtRosbag2,
        MessageDefinitionFormat,
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.rosbag2 import (
        CompressionFormat,
        CompressionMode,
        ReaderError,
        StoragePlugin,
        Writer,
        WriterError,
    )
    from rosbags.typesys import Stores, TypesysError, get_typestore
except ImportError as error:
    raise GyroDriftFilterError(
        f"bags need the Python package rosbags ({error}): install it with 'pip install rosbags'"
    ) from error

_JAZZY = get_typestore(Stores.ROS2_JAZZY)
_UNKNOWN_HASH = 'RIHS01_' + 64 * '0'
_METADATA_VERSION: Literal[9] = 9  # of rosbag2 in Jazzy
_FOREVER = QosTime(2**31 - 1, 2**32 - 1)

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
    if not path.exists():
        raise BagError(f'no such bag: {path}')
    if path.is_dir() and not (path / 'metadata.yaml').exists():
        raise BagError(
            f'{path} holds no metadata.yaml, so it is no rosbag2 folder: name the .mcap file in it'
        )
    if path.suffix == '.bag':
        raise BagError(f"{path} is a ROS 1 bag: convert it with 'rosbags-convert' first")
    # A file that lies raises nearly anything out of the parser: all of it is a bag that can't be
    # read. Errors of the caller's own pass, as the reader is open by then.
    try:
        reader = AnyReader([path], default_typestore=_JAZZY)
        reader.open()
    except Exception as error:
        raise BagError(f'{path} can not be read as a bag: {one_line(error)}') from error
    try:
        yield reader
    finally:
        reader.close()


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
                f'{reader.paths[0]} is damaged and can be read no further: {one_line(error)}'
            ) from error
        yield connection, log_time, bytes(data)


def one_line(error: BaseException) -> str:
    """Return the text of an error without line breaks, or its name where it has no text."""
    return ' '.join(str(error).split()) or type(error).__name__


class BagWriter:
    """Write a rosbag2 folder; it gets its name when it is complete.

    While it is written it is called NAME.incomplete, and is removed if writing fails.
    """

    def __init__(self, path: Path) -> None:
        """Begin a bag.

        Raises:
            BagError: The path exists already or can't be written.
        """
        self._path = path
        self._partial = path.with_name(f'{path.name}.incomplete')
        if path.exists():
            raise BagError(f'{path} exists already: remove it or choose another name')
        shutil.rmtree(self._partial, ignore_errors=True)
        # The MCAP file is named after the final folder, as `ros2 bag` names it.
        self._writer = Writer(
            self._partial / path.name,
            version=_METADATA_VERSION,
            storage_plugin=StoragePlugin.MCAP,
        )
        self._writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
        try:
            self._writer.open()
        except (OSError, WriterError) as error:
            raise BagError(f'{path} can not be written: {one_line(error)}') from error

    def __enter__(self) -> 'BagWriter':
        """Return itself."""
        return self

    def __exit__(self, kind: Any, error: Any, trace: Any) -> None:
        """Give the bag its name, or remove it where writing failed."""
        if kind is None:
            self._writer.close()
            (self._partial / self._path.name).rename(self._path)
        else:
            with suppress(Exception):
                self._writer.abort()
        shutil.rmtree(self._partial, ignore_errors=True)

    def copy_connection(self, connection: Connection, reader: AnyReader) -> Connection:
        """Add a topic as it is in another bag, with its QoS and message definition."""
        extension = connection.ext
        assert isinstance(extension, ConnectionExtRosbag2)
        definition, digest = connection.msgdef.data, connection.digest
        if connection.msgdef.format == MessageDefinitionFormat.NONE or not digest:
            definition, digest = _definition(connection, reader)
        return self._writer.add_connection(
            connection.topic,
            connection.msgtype,
            msgdef=definition,
            rihs01=digest,
            serialization_format=extension.serialization_format,
            offered_qos_profiles=extension.offered_qos_profiles,
        )

    def add_connection(
        self, topic: str, message_type: str, qos: Sequence[Qos] = (RELIABLE,)
    ) -> Connection:
        """Add a topic of a type that Jazzy knows."""
        return self._writer.add_connection(
            topic, message_type, typestore=_JAZZY, offered_qos_profiles=qos
        )

    def write(self, connection: Connection, log_time: int, data: bytes) -> None:
        """Write a serialized message with its log time in ns.

        Raises:
            BagError: The disk is full or the like.
        """
        try:
            self._writer.write(connection, log_time, data)
        except OSError as error:
            raise BagError(f'{self._path} can not be written: {one_line(error)}') from error


def _definition(connection: Connection, reader: AnyReader) -> tuple[str, str]:
    """Return message definition and hash of a type, for bags from before they stood in them."""
    for store in (reader.typestore, _JAZZY):
        with suppress(TypesysError, KeyError):
            definition, _ = store.generate_msgdef(connection.msgtype, ros_version=2)
            return definition, store.hash_rihs01(connection.msgtype)
    return connection.msgdef.data, connection.digest or _UNKNOWN_HASH


def message_type(name: str) -> Any:
    """Return the class of a message type, such as 'sensor_msgs/msg/Imu'."""
    return _JAZZY.types[name]


def serialize(message: Any, name: str) -> bytes:
    """Return a message of rosbags' classes in CDR."""
    return bytes(_JAZZY.serialize_cdr(message, name))


__all__ = [
    'AnyReader',
    'AnyReaderError',
    'BagError',
    'BagWriter',
    'Connection',
    'ReaderError',
    'messages',
    'open_bag',
]
