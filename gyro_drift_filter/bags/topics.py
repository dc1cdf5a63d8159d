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

"""The topics of a replay: which are read, and what those that are written are called."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from gyro_drift_filter.messages.names import NODE_NAME

DIAGNOSTICS = '/diagnostics'


@dataclass(frozen=True)
class Topics:
    """Names that belong to an Imu topic.

    Attributes:
        filtered: The topic of what was filtered.
        node: The node that would filter it; its other topics are below this name.
        temperature: The topic that the temperature of the sensor is read from.
    """

    filtered: str
    node: str
    temperature: str

    @classmethod
    def of(cls, topic: str) -> 'Topics':
        """Return the names: beside the input, in its namespace.

        /robot1/imu/data_raw gives /robot1/imu/data_filtered and /robot1/gyro_drift_filter;
        an input of another name, /camera/imu, gives /camera/imu_filtered.
        """
        topic = absolute_name(topic)
        parent = topic.rpartition('/')[0]
        if topic.endswith('/imu/data_raw'):
            node = f'{parent.rpartition("/")[0]}/{NODE_NAME}'
            return cls(f'{parent}/data_filtered', node, f'{parent}/temperature')
        filtered = f'{topic}_filtered'
        if topic.endswith('/data_raw'):
            filtered = f'{parent}/data_filtered'
        return cls(filtered, f'{parent}/{NODE_NAME}', f'{parent}/temperature')

    def with_full_name(self, topic: str) -> 'Topics':
        """Return the same with a filtered topic that has the whole name of the input in it."""
        return replace(self, filtered=f'{absolute_name(topic)}_filtered')

    def with_own_node(self, topic: str) -> 'Topics':
        """Return the same with a node that is named after the input topic."""
        return replace(self, node=f'{self.node}_{topic.strip("/").replace("/", "_")}')

    def sample(self, name: str) -> str:
        """Return the name of a topic below the node's, such as one of `SAMPLE_TOPICS`."""
        return f'{self.node}/{name}'


def absolute_name(topic: str) -> str:
    """Return the name of a topic as ROS has it: with a slash before it, and none behind it."""
    return '/' + topic.strip('/')


def topic_named(topics: Iterable[str], wanted: str) -> str | None:
    """Return the one of the topics that a user means, None where there is none."""
    name = absolute_name(wanted)
    return next((topic for topic in topics if absolute_name(topic) == name), None)
