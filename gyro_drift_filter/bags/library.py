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

"""What is used of rosbags, or one sentence on how to get it."""

# All of this is imported from here.
# flake8: noqa: F401

from gyro_drift_filter.errors import GyroDriftFilterError

try:
    import apsw
    import backports.zstd  # mcap/records.py's, which rosbags before 0.11.7 does not bring
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
    from rosbags.rosbag1 import Reader as Ros1LibraryReader
    from rosbags.rosbag2 import (
        CompressionFormat,
        CompressionMode,
        StoragePlugin,
        Writer,
        WriterError,
    )
    from rosbags.rosbag2 import Reader as Ros2LibraryReader
    from rosbags.rosbag2.reader import DirectoryReader
    from rosbags.rosbag2.storage_mcap import McapReader
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader
    from rosbags.typesys import (
        Stores,
        TypesysError,
        get_types_from_idl,
        get_types_from_msg,
        get_typestore,
    )
    from rosbags.typesys.store import Typestore
except ImportError as error:
    raise GyroDriftFilterError(
        f'bags need the Python package rosbags ({error}): install it with '
        '\'pip install "rosbags>=0.11.7,<0.12"\', on Ubuntu within a venv'
    ) from error
