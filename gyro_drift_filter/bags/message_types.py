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

"""Message types, as ROS 2 defines them.

rosbags' store of all types of Jazzy takes 50 ms to load, an eighth of the start of `replay`: the
few that are written each time stand here.
"""

from contextlib import suppress
from functools import cache, lru_cache
from typing import Any

from gyro_drift_filter.bags.definitions import types_of
from gyro_drift_filter.bags.library import (
    Connection,
    Stores,
    Typestore,
    get_types_from_msg,
    get_typestore,
)

# The name of the field of a type without fields, which C does not have.
_NO_FIELD = 'structure_needs_at_least_one_member'
_DEFINITIONS = {
    'builtin_interfaces/msg/Time': """
        int32 sec
        uint32 nanosec""",
    'std_msgs/msg/Header': """
        builtin_interfaces/Time stamp
        string frame_id""",
    'std_msgs/msg/Bool': """
        bool data""",
    'geometry_msgs/msg/Vector3': """
        float64 x
        float64 y
        float64 z""",
    'geometry_msgs/msg/Vector3Stamped': """
        std_msgs/Header header
        geometry_msgs/Vector3 vector""",
    'geometry_msgs/msg/Quaternion': """
        float64 x
        float64 y
        float64 z
        float64 w""",
    'sensor_msgs/msg/Imu': """
        std_msgs/Header header
        geometry_msgs/Quaternion orientation
        float64[9] orientation_covariance
        geometry_msgs/Vector3 angular_velocity
        float64[9] angular_velocity_covariance
        geometry_msgs/Vector3 linear_acceleration
        float64[9] linear_acceleration_covariance""",
    'diagnostic_msgs/msg/KeyValue': """
        string key
        string value""",
    'diagnostic_msgs/msg/DiagnosticStatus': """
        byte OK=0
        byte WARN=1
        byte ERROR=2
        byte STALE=3
        byte level
        string name
        string message
        string hardware_id
        diagnostic_msgs/KeyValue[] values""",
    'diagnostic_msgs/msg/DiagnosticArray': """
        std_msgs/Header header
        diagnostic_msgs/DiagnosticStatus[] status""",
}


@cache
def _few_types() -> Typestore:
    store = get_typestore(Stores.EMPTY)
    for name, definition in _DEFINITIONS.items():
        store.register(get_types_from_msg(definition, name))
    return store


@cache
def all_types() -> Typestore:
    """Return rosbags' store of all types of Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


def types_with(name: str) -> Typestore:
    """Return a store that has a type, such as 'sensor_msgs/msg/Imu', if Jazzy has it."""
    return _few_types() if name in _DEFINITIONS else all_types()


def message_type(name: str) -> Any:
    """Return the class of a message type of Jazzy."""
    return types_with(name).types[name]


def read_message(data: bytes, connection: Connection) -> Any:
    """Return a message of a topic from its CDR, with the fields that the bag has for its type.

    Raises:
        Exception: Nearly any one, where it is damaged, or the bag does not define its own type.
    """
    name = connection.msgtype
    store = types_of(connection) if is_another_type(connection) else types_with(name)
    return store.deserialize_cdr(data, name)


def is_another_type(connection: Connection) -> bool:
    """Tell whether a bag has another type of this name than Jazzy: by its hash, or its fields.

    By its fields the bound of a length makes no difference, as messages are the same.
    """
    name = connection.msgtype
    if connection.digest:
        return connection.digest != _digest(name)
    return _fields(name, types_of(connection)) not in ((), _fields(name, types_with(name)))


@cache
def _digest(name: str) -> str:
    """Return the hash of a type of Jazzy, empty where that has none of this name."""
    with suppress(KeyError):
        return types_with(name).hash_rihs01(name)
    return ''


@lru_cache
def _fields(name: str, types: Typestore) -> tuple[Any, ...]:
    """Return names and types of the fields of a type, nothing where it is not fully defined."""
    with suppress(KeyError):
        fields: tuple[Any, ...] = _content(name, types)
        return fields if fields[0][0] != _NO_FIELD else ()
    return ()


def _content(of: Any, types: Typestore) -> Any:
    """Return what a field is made of, down to basic types, by what rosbags has of it."""
    if isinstance(of, str):
        fields = types.fielddefs[of][1]
        return tuple((name, kind, _content(inner, types)) for name, (kind, inner) in fields)
    inner, size = of
    # A basic type has a name and a bound; an array or a sequence has what it repeats, and a size.
    return inner if isinstance(inner, str) else (inner[0], _content(inner[1], types), size)


def serialize(message: Any, name: str) -> bytes:
    """Return a message of such a class in CDR."""
    return bytes(types_with(name).serialize_cdr(message, name))
