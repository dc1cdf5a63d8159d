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

"""Ask the running node, and know what it has to answer."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterValue, SetParametersResult
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.parameter import Parameter

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.messages.message_filter import MessageFilter
from harness.live_node import LiveNode
from support.sensor import DEGREE

NODE = '/gyro_drift_filter'
TRUTH = np.array([1.0, -2.0, 0.5]) * DEGREE


def call(live: LiveNode, kind: Any, name: str, request: Any) -> Any:
    """Call a service of the node and return its answer."""
    client = live.node.create_client(kind, f'{NODE}/{name}')
    live.wait(client.service_is_ready, f'service {name}')
    future = client.call_async(request)
    live.wait(future.done, f'an answer of {name}')
    live.node.destroy_client(client)
    return future.result()


def set_parameters(live: LiveNode, **values: Any) -> list[SetParametersResult]:
    """Set parameters, one by one, and return the node's answers; `__` stands for a dot."""
    request = SetParameters.Request(
        parameters=[
            Parameter(name.replace('__', '.'), value=value).to_parameter_msg()
            for name, value in values.items()
        ]
    )
    return list(call(live, SetParameters, 'set_parameters', request).results)


def get_parameter(live: LiveNode, name: str) -> ParameterValue:
    """Return a parameter of the node."""
    values = call(live, GetParameters, 'get_parameters', GetParameters.Request(names=[name])).values
    return values[0]


def diagnostics(
    live: LiveNode, condition: Callable[[dict[str, DiagnosticStatus]], object]
) -> dict[str, DiagnosticStatus]:
    """Return {name: status} of the first /diagnostics that meets a condition."""
    found = []

    def take(array: DiagnosticArray) -> None:
        statuses = {status.name: status for status in array.status}
        if condition(statuses):
            found.append(statuses)

    subscription = live.node.create_subscription(DiagnosticArray, '/diagnostics', take, 10)
    live.wait(lambda: found, 'diagnostics')
    live.node.destroy_subscription(subscription)
    return found[0]


def values(status: DiagnosticStatus) -> dict[str, str]:
    """Return the values of a status by their keys."""
    return {pair.key: pair.value for pair in status.values}


def offline(data: Sequence[bytes], **parameters: Any) -> list[bytes | None]:
    """Return what the node has to publish for each message."""
    filter_ = MessageFilter(Parameters(**parameters))
    return [filter_.take(message) for message in data]
