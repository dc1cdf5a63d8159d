"""The topics of a replay: which are read, and what those that are written are called."""

from dataclasses import dataclass

from gyro_drift_filter.bags.recording import BagError, Recording
from gyro_drift_filter.messages.health import NODE_NAME
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.messages.motion_hint import HINT_TYPES


@dataclass(frozen=True)
class Topics:
    """Names of the outputs that belong to an input topic."""

    filtered: str
    node: str
    temperature: str

    @classmethod
    def of(cls, topic: str) -> 'Topics':
        """Return the names: beside the input, in its namespace.

        /robot1/imu/data_raw gives /robot1/imu/data_filtered and /robot1/gyro_drift_filter;
        an input of another name, /camera/imu, gives /camera/imu_filtered.
        """
        topic = '/' + topic.strip('/')
        parent = topic.rpartition('/')[0]
        if topic.endswith('/imu/data_raw'):
            node = f'{parent.rpartition("/")[0]}/{NODE_NAME}'
            return cls(f'{parent}/data_filtered', node, f'{parent}/temperature')
        filtered = f'{topic}_filtered'
        if topic.endswith('/data_raw'):
            filtered = f'{parent}/data_filtered'
        return cls(filtered, f'{parent}/{NODE_NAME}', f'{parent}/temperature')

    def sample(self, name: str) -> str:
        """Return the name of a topic below the node's, such as one of `SAMPLE_TOPICS`."""
        return f'{self.node}/{name}'


def choose_topic(recording: Recording, wanted: str | None) -> str:
    """Return the Imu topic to filter: the one wanted, or the only one.

    Raises:
        BagError: There is none, there are several, or the wanted one is of another type; the text
            lists what there is.
    """
    types = {connection.topic: connection.msgtype for connection in recording.connections}
    imus = sorted(topic for topic, kind in types.items() if kind == IMU_TYPE)
    if wanted is not None:
        for topic, kind in types.items():
            if topic.strip('/') == wanted.strip('/'):
                if kind == IMU_TYPE:
                    return topic
                raise BagError(f'topic {topic} is of type {kind}, not {IMU_TYPE}')
        raise BagError(f'no topic {wanted} in the bag; Imu topics: {", ".join(imus) or "none"}')
    if not types:
        raise BagError('the bag is empty: it holds no topic')
    if not imus:
        listed = ', '.join(f'{topic} ({kind})' for topic, kind in sorted(types.items()))
        raise BagError(f'no topic of type {IMU_TYPE} in the bag; it holds {listed}')
    outputs = {Topics.of(topic).filtered for topic in imus}
    inputs = [topic for topic in imus if topic not in outputs]
    if len(inputs) == 1:
        return inputs[0]
    raise BagError(f'several Imu topics: choose one with --topic: {", ".join(imus)}')


def choose_hint(recording: Recording, wanted: str) -> str:
    """Return the topic that hints at motion.

    Raises:
        BagError: The bag has no topic of that name, or of a type that could.
    """
    for connection in recording.connections:
        if connection.topic.strip('/') == wanted.strip('/'):
            if connection.msgtype in HINT_TYPES.values():
                return connection.topic
            listed = ', '.join(HINT_TYPES.values())
            raise BagError(f'topic {wanted} is of type {connection.msgtype}, not one of {listed}')
    raise BagError(f'no topic {wanted} in the bag')
