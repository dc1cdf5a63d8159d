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

"""The node: serialized Imu in, filtered serialized Imu out, and what the filter thinks of it."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from geometry_msgs.msg import Vector3Stamped
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock
from rclpy.clock_type import ClockType
from rclpy.event_handler import (
    PublisherEventCallbacks,
    QoSPublisherMatchedInfo,
    SubscriptionEventCallbacks,
)
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy, qos_profile_sensor_data
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.time import Time
from sensor_msgs.msg import Imu, Temperature
from std_msgs.msg import Bool
from std_srvs.srv import Trigger

from gyro_drift_filter.accelerate.kernels import is_cache_cold, why_plain
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.errors import GyroDriftFilterError, ParameterError
from gyro_drift_filter.messages import diagnostics
from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.health import NOTHING_RECEIVED, Health
from gyro_drift_filter.messages.imu import EXAMPLE
from gyro_drift_filter.messages.message_filter import MessageFilter, MessageOutcome
from gyro_drift_filter.messages.names import INPUT_STATUS, NODE_NAME
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
from gyro_drift_filter.messages.telemetry import MessageReport
from gyro_drift_filter.phrases import counted
from gyro_drift_filter.ros.arguments import reason_of_rcl
from gyro_drift_filter.ros.bias_memory import NodeBiasMemory
from gyro_drift_filter.ros.cold_start import ColdStart
from gyro_drift_filter.ros.losses import Losses
from gyro_drift_filter.ros.motion_hint import MotionHint
from gyro_drift_filter.ros.neighbours import Neighbours
from gyro_drift_filter.ros.parameters import LiveParameters

_REPORT_SECONDS = 1.0
_LOG_PAUSE = 10_000_000_000  # ns
_BESIDE = 'imu/temperature', 'motion_hint', '/diagnostics'
# After so many messages what was lost is counted: several times while a full queue is emptied.
_COUNT_EVERY = 50
# Best effort matches every publisher, reliable matches every subscriber. The input's depth rides
# out half a second without the processor at 400 Hz.
_INPUT_QOS = QoSProfile(depth=200, reliability=ReliabilityPolicy.BEST_EFFORT)
_LATCHED_QOS = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_OUTPUT_QOS = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)


@contextmanager
def _reporting_qos(topic: str) -> Iterator[None]:
    """Turn what rclpy raises of a wrong qos_overrides, which may be anything, into one line."""
    try:
        yield
    except (RuntimeError, AssertionError, ValueError) as error:
        reason = reason_of_rcl(error) or 'wrong type'
        raise ParameterError(
            f'{topic} can not be set up with its qos_overrides: {reason}'
        ) from error


def _check_depth(qos: QoSProfile) -> SetParametersResult:
    """Refuse a depth of which rcl says nothing but 'invalid allocator'.

    Raises:
        ValueError: It is negative.
    """
    if qos.depth < 0:
        raise ValueError(f'depth must be at least 0, not {qos.depth}')
    return SetParametersResult(successful=True)


class GyroDriftFilterNode(Node):
    """Filter `imu/data_raw` into `imu/data_filtered`.

    Args:
        parameter_files: Those that the process was given, to tell of one that is not for it.
        options: For `rclpy.node.Node`.

    Raises:
        ParameterError: A parameter has a wrong name or value.
        GyroDriftFilterError: Two of its topics are one, as input and output.
    """

    def __init__(self, parameter_files: Sequence[Path] = (), **options: Any) -> None:
        try:
            super().__init__(
                NODE_NAME, automatically_declare_parameters_from_overrides=True, **options
            )
        except ValueError as error:
            raise ParameterError(f'a parameter was given no value: {error}') from error
        simulated = self.get_parameter('use_sim_time').value
        if not isinstance(simulated, bool):  # rclpy goes on with the system's time
            raise ParameterError(
                f"parameter 'use_sim_time' must be true or false without quotes, not {simulated!r}"
            )
        parameters = LiveParameters(self, self._configure, parameter_files)
        self._refuse_shared_topics()
        self._messages = MessageFilter(parameters.current)
        if not is_cache_cold():
            # The first step loads the kernels: before there is a message to wait for it.
            MessageFilter(parameters.current).take(EXAMPLE)
        self._health = Health(self.get_fully_qualified_name())
        self._memory = NodeBiasMemory(self, self._messages)
        self._logged: dict[str, tuple[diagnostics.DiagnosticStatus, Time]] = {}
        self._steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._reported = self._steady.now()

        overridable = QoSOverridingOptions.with_default_policies(callback=_check_depth)
        with _reporting_qos('imu/data_filtered'):
            self._output = self.create_publisher(
                Imu, 'imu/data_filtered', _OUTPUT_QOS, qos_overriding_options=overridable
            )
        self._listened: dict[str, Publisher] = {}
        self._sample_outputs = {name: self._create_sample_output(name) for name in SAMPLE_TOPICS}
        self._outcome = int(MessageOutcome.NOTHING)  # the last one whose rates were filtered
        self._rest_output = self.create_publisher(Bool, '~/at_rest', _LATCHED_QOS)
        self._diagnostics = self.create_publisher(DiagnosticArray, '/diagnostics', 10)
        self.create_service(Trigger, '~/reset', self._reset)
        self.create_service(Trigger, '~/calibrate', self._calibrate)
        self.create_timer(_REPORT_SECONDS, self._report, clock=self._steady)
        self._until_count = _COUNT_EVERY  # messages
        self._losses = Losses(self._receive, lambda: int(self._messages.reception['received']))
        with _reporting_qos('imu/data_raw'):
            self._input = self.create_subscription(
                Imu,
                'imu/data_raw',
                self._receive,
                _INPUT_QOS,
                raw=True,
                qos_overriding_options=overridable,
                event_callbacks=SubscriptionEventCallbacks(message_lost=self._losses.note_event),
            )
        self._neighbours = Neighbours(self, self._input, self._output)
        self.create_subscription(
            Temperature, 'imu/temperature', self._note_temperature, qos_profile_sensor_data
        )
        self._hint = MotionHint(self, self._note_hint, parameters.current.motion_hint)
        # Last, as it starts a process that has to be stopped.
        self._cold_start = ColdStart(self)
        self.get_logger().info(
            f'filtering {self._input.topic_name} into {self._output.topic_name} by '
            f'{parameters.current.method}'
            + (f', in plain Python: {why}' if (why := why_plain()) else '')
        )

    def _refuse_shared_topics(self) -> None:
        own = (*(f'~/{name}' for name in SAMPLE_TOPICS), '~/at_rest')
        known: dict[str, str] = {}
        for name in ('imu/data_raw', 'imu/data_filtered', *_BESIDE, *own):
            topic = self.resolve_topic_name(name)
            if topic not in known:
                known[topic] = name
                continue
            both = f'{known[topic]} and {name}'
            if name == 'imu/data_filtered':
                raise GyroDriftFilterError(
                    f'input and output are both {topic}: the filter would filter its own output; '
                    f'remap one of {both}'
                )
            raise GyroDriftFilterError(
                f'{both} are both {topic}: each needs a topic of its own; remap one of them'
            )

    def _create_sample_output(self, name: str) -> Publisher:
        def matched(info: QoSPublisherMatchedInfo) -> None:
            if info.current_count > 0:
                self._listened[name] = self._sample_outputs[name]
            else:
                self._listened.pop(name, None)

        return self.create_publisher(
            Vector3Stamped,
            f'~/{name}',
            _OUTPUT_QOS,
            event_callbacks=PublisherEventCallbacks(matched=matched),
        )

    def _configure(self, parameters: Parameters) -> None:
        self._cold_start.call(self._memory.configure, parameters, is_command=True)
        self._hint.listen(parameters.motion_hint)

    def _receive(self, data: bytes) -> None:
        self._cold_start.call(self._filter, data)
        self._until_count -= 1
        if self._until_count == 0:
            # First, as counting may take a message, and so come here again.
            self._until_count = _COUNT_EVERY
            self._count_losses()

    def _filter(self, data: bytes) -> None:
        if not self._memory.recalled:
            self._memory.recall(data)
        messages = self._messages
        filtered = messages.take(data)
        if filtered is None:
            return
        self._output.publish(filtered)
        outcome = messages.outcome
        if outcome == MessageOutcome.PASSED_ON:
            return
        if outcome != self._outcome:
            self._outcome = outcome
            self._rest_output.publish(Bool(data=outcome == MessageOutcome.AT_REST))
        for name, output in self._listened.items():
            output.publish(messages.sample_message(name))

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._cold_start.call(lambda _: self._messages.filter.reset(), None, is_command=True)
        response.success = True
        response.message = 'the filter starts from the next sample; parameters and bias are kept'
        return response

    def _calibrate(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if not self._cold_start.is_ready:
            response.success = False
            response.message = 'the filter is being compiled for its first start: try again later'
            return response
        try:
            self._messages.filter.calibrate()
        except GyroDriftFilterError as error:
            response.success, response.message = False, str(error)
            return response
        bias = np.degrees(self._messages.filter.state['bias']['bias'])
        response.success = True
        response.message = 'bias {:.4f}, {:.4f}, {:.4f} deg/s'.format(*bias)
        return response

    def _note_temperature(self, message: Temperature) -> None:
        self._cold_start.call(self._messages.filter.note_temperature, message.temperature)

    def _note_hint(self, moves: bool) -> None:  # noqa: FBT001  # MotionHint calls it
        self._cold_start.call(self._messages.filter.hint, moves)

    def destroy_node(self) -> None:
        """Keep what was learned, and end."""
        self._cold_start.stop()
        self._memory.save()
        super().destroy_node()

    def _report(self) -> None:
        self._memory.note_publishers(self._input.get_publisher_count())
        self._memory.save_if_due()
        self._messages.reception['lost'] = self._losses.total
        now = self._steady.now()
        seconds = (now - self._reported).nanoseconds * 1e-9
        self._reported = now
        array = DiagnosticArray()
        array.header.stamp = self.get_clock().now().to_msg()
        # In a simulation the messages follow its clock, which may be of any speed.
        paced = not self.get_parameter('use_sim_time').value
        statuses = self._health.judge(self._message_report(), seconds, paced=paced)
        for status in map(self._with_surroundings, statuses):
            self._log_change(status)
            array.status.append(
                DiagnosticStatus(
                    level=bytes([status.level]),
                    name=status.name,
                    message=status.message,
                    hardware_id=status.hardware_id,
                    values=[KeyValue(key=k, value=v) for k, v in status.values.items()],
                )
            )
        self._diagnostics.publish(array)

    def _message_report(self) -> MessageReport:
        if self._cold_start.is_ready:
            return self._messages.report()
        # A report of its own would compile the filter in here, where nobody is answered meanwhile.
        return NOTHING_RECEIVED._replace(parameters=self._messages.filter.parameters)

    def _count_losses(self) -> None:
        # What is kept for later is not received yet, and of two publishers each has its own count.
        if not self._cold_start.is_ready or self._input.get_publisher_count() != 1:
            self._losses.forget()
        else:
            self._losses.count(self._input)

    def _with_surroundings(
        self, status: diagnostics.DiagnosticStatus
    ) -> diagnostics.DiagnosticStatus:
        """Add what the messages don't show: a first start, and who else is on the topics."""
        if not self._cold_start.is_ready:
            kept = counted(self._cold_start.messages, 'message')
            message = f'compiling for the first start: {kept} kept'
            return status._replace(level=Level.WARN, message=message)
        if not status.name.endswith(INPUT_STATUS):
            return status
        if status.level not in (Level.OK, Level.STALE):
            # Two sensors in turns look like many a fault of one.
            mixture = self._neighbours.mixture()
            return status._replace(message=f'{mixture}; {status.message}') if mixture else status
        fault = self._neighbours.fault()
        if fault is None and status.level == Level.OK:
            fault = self._hint.fault()
        if fault is not None:
            return status._replace(level=max(Level.WARN, status.level), message=fault)
        if status.level == Level.STALE:
            return status._replace(message=self._neighbours.silence())
        return status

    def _log_change(self, status: diagnostics.DiagnosticStatus) -> None:
        """Log a status whose message has changed, but not often while its level is the same."""
        if not self._cold_start.is_ready:
            return
        now = self._steady.now()
        known = self._logged.get(status.name)
        if known is not None:
            logged, when = known
            is_soon = (now - when).nanoseconds < _LOG_PAUSE
            if logged.message == status.message or (logged.level == status.level and is_soon):
                return
        self._logged[status.name] = status, now
        if status.level != Level.OK:
            self.get_logger().warning(status.message)
        elif known is not None:
            self.get_logger().info(status.message)
