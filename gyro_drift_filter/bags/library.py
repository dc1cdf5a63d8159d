"""What is used of rosbags, or one sentence on how to get it."""

from gyro_drift_filter.errors import GyroDriftFilterError

try:
    from rosbags.highlevel import AnyReader, AnyReaderError
    from rosbags.interfaces import (
        Connection,
        ConnectionExtRosbag1,
        ConnectionExtRosbag2,
        MessageDefinition,
        MessageDefinitionFormat,
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )
    from rosbags.interfaces.typing import RPath
    from rosbags.rosbag2 import (
        CompressionFormat,
        CompressionMode,
        StoragePlugin,
        Writer,
        WriterError,
    )
    from rosbags.rosbag2.reader import DirectoryReader
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.typesys import Stores, TypesysError, get_types_from_msg, get_typestore
    from rosbags.typesys.store import Typestore
except ImportError as error:
    raise GyroDriftFilterError(
        f'bags need the Python package rosbags ({error}): install it with '
        '\'pip install "rosbags>=0.11,<0.12"\', on Ubuntu within a venv'
    ) from error

__all__ = [
    'AnyReader',
    'AnyReaderError',
    'CompressionFormat',
    'CompressionMode',
    'Connection',
    'ConnectionExtRosbag1',
    'ConnectionExtRosbag2',
    'DirectoryReader',
    'McapReader',
    'MessageDefinition',
    'MessageDefinitionFormat',
    'Qos',
    'QosDurability',
    'QosHistory',
    'QosLiveliness',
    'QosReliability',
    'QosTime',
    'RPath',
    'StoragePlugin',
    'Stores',
    'Typestore',
    'TypesysError',
    'Writer',
    'WriterError',
    'get_types_from_msg',
    'get_typestore',
]
