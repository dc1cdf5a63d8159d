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

"""Who is on the topics of a node that takes the place of the driver's topic by remap rules."""

from contextlib import contextmanager

import pytest
import rclpy
from geometry_msgs.msg import Twist
from rclpy.qos import DurabilityPolicy, QoSProfile, qos_profile_sensor_data
from sensor_msgs.msg import Imu

from gyro_drift_filter.ros import motion_hint
from gyro_drift_filter.ros.motion_hint import MotionHint
from gyro_drift_filter.ros.neighbours import Neighbours
from harness.live_node import own_domain

pytestmark = pytest.mark.node

# Of each pair, one topic has the name from which the other is remapped.
TAKES_THE_PLACE = {'imu/data_raw': '/imu/raw', 'imu/data_filtered': '/imu/data_raw'}
SWAPPED = {'imu/data_raw': '/imu/data_filtered', 'imu/data_filtered': '/imu/data_raw'}
FEEDS_THE_NEXT = {'imu/data_raw': '/imu/data_filtered', 'imu/data_filtered': '/imu/clean'}


@contextmanager
def nodes(rules, *names):
    """Yield a node with remap rules, and others beside it."""
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain())
    remaps = [word for rule in rules.items() for word in ('-r', '{}:={}'.format(*rule))]
    node = rclpy.create_node('filter', context=context, cli_args=['--ros-args', *remaps])
    others = [rclpy.create_node(name, context=context) for name in names]
    try:
        yield node, *others
    finally:
        for each in (node, *others):
            each.destroy_node()
        context.try_shutdown()


def neighbours_of(node, qos=10):
    return Neighbours(
        node,
        node.create_subscription(Imu, 'imu/data_raw', print, qos),
        node.create_publisher(Imu, 'imu/data_filtered', 10),
    )


@pytest.mark.parametrize('rules', [TAKES_THE_PLACE, SWAPPED, FEEDS_THE_NEXT])
def test_each_topic_is_looked_at_by_the_name_that_it_is_remapped_to(rules):
    source, result = rules.values()
    with nodes(rules, 'driver', 'camera') as (node, driver, camera):
        neighbours = neighbours_of(node)
        assert neighbours.silence().startswith(f'nobody publishes {source}: ')
        driver.create_publisher(Imu, source, 10)
        assert neighbours.fault() is None
        assert neighbours.silence() == f'no message, though /driver publishes {source}'
        second = camera.create_publisher(Imu, source, 10)
        assert neighbours.fault().startswith(f'2 publishers on {source}: /camera, /driver. ')
        camera.destroy_publisher(second)
        camera.create_publisher(Imu, result, 10)
        assert neighbours.fault().startswith(f'/camera publishes {result}, too: ')


def test_a_mismatch_is_told_of_the_topic_that_it_is_on():
    source, result = TAKES_THE_PLACE.values()
    with nodes(TAKES_THE_PLACE, 'radio', 'logger') as (node, radio, logger):
        neighbours = neighbours_of(node)
        latched = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        logger.create_subscription(Imu, result, print, latched)
        assert neighbours.fault().startswith(f'/logger gets nothing of {result}: Volatile')
        radio.create_publisher(Imu, source, qos_profile_sensor_data)
        assert neighbours.fault().startswith(f'nothing comes from /radio on {source}: ')


def test_the_hint_is_looked_for_on_the_topic_that_it_is_remapped_to(monkeypatch):
    monkeypatch.setattr(motion_hint, '_DISCOVERY_SECONDS', 0.0)
    rules = {'motion_hint': '/cmd_vel', 'cmd_vel': '/joystick'}
    with nodes(rules, 'planner') as (node, planner):
        hint = MotionHint(node, print, 'twist')
        assert hint.fault().startswith('motion_hint is twist, but nobody publishes /cmd_vel: ')
        planner.create_publisher(Twist, '/cmd_vel', 10)
        assert hint.fault() is None
