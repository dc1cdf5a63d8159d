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

"""The layouts of live plots: well-formed, and of what the node publishes."""

import json
import re
import xml.etree.ElementTree as ElementTree

import pytest
from geometry_msgs.msg import Vector3Stamped
from sensor_msgs.msg import Imu
from std_msgs.msg import Bool

from gyro_drift_filter.bags.topics import DIAGNOSTICS, Topics
from gyro_drift_filter.messages.sample_messages import SAMPLE_TOPICS
from support.paths import PACKAGE, REPOSITORY

LAYOUTS = REPOSITORY / 'config' / 'layouts'
INPUT = '/imu/data_raw'
TOPICS = Topics.of(INPUT)
TYPES = {
    INPUT: Imu,
    TOPICS.filtered: Imu,
    **{TOPICS.sample(name): Vector3Stamped for name in SAMPLE_TOPICS},
    TOPICS.sample('at_rest'): Bool,
}


def check(topic, fields):
    """Check that fields lead to a number of a message on a topic."""
    message = TYPES[topic]()
    for name in fields:
        message = getattr(message, name)
    assert isinstance(message, (bool, float))


def check_path(path):
    """Check a topic with the fields behind it, with slashes all the way."""
    topic = max((topic for topic in TYPES if path.startswith(f'{topic}/')), key=len)
    check(topic, path[len(topic) + 1 :].split('/'))


def test_plotjuggler():
    root = ElementTree.parse(LAYOUTS / 'plotjuggler.xml').getroot()
    assert root.tag == 'root'
    tabs = root.findall('tabbed_widget/Tab')
    assert [tab.get('tab_name') for tab in tabs] == ['rates', 'innovation']
    for tab in tabs:
        containers = tab.findall('Container')
        assert len(containers) == int(tab.get('containers', ''))
        (splitter,) = containers[0]
        assert splitter.tag == 'DockSplitter'
        sizes = [float(size) for size in splitter.get('sizes', '').split(';')]
        assert len(splitter) == int(splitter.get('count', '')) == len(sizes)
        assert sum(sizes) == pytest.approx(1.0, abs=1e-3)
        for area in splitter:
            assert area.tag == 'DockArea'
            assert [child.tag for child in area] == ['plot']
    curves = [curve.get('name', '') for curve in root.iter('curve')]
    for name in curves:
        check_path(name)
    assert {'/'.join(name.split('/')[:3]) for name in curves} == set(TYPES) - {
        TOPICS.sample('at_rest')
    }
    assert all(re.fullmatch('#[0-9a-f]{6}', c.get('color', '')) for c in root.iter('curve'))


def leaves(layout):
    """Yield the panels of a layout of Foxglove."""
    if isinstance(layout, str):
        yield layout
        return
    assert set(layout) == {'direction', 'first', 'second', 'splitPercentage'}
    assert layout['direction'] in ('row', 'column')
    assert 0 < layout['splitPercentage'] < 100
    yield from leaves(layout['first'])
    yield from leaves(layout['second'])


def test_foxglove():
    content = json.loads((LAYOUTS / 'foxglove.json').read_text())
    panels = content['configById']
    assert sorted(leaves(content['layout'])) == sorted(panels)
    named = set()
    for name, panel in panels.items():
        kind = name.partition('!')[0]
        assert kind in ('Plot', 'StateTransitions', 'DiagnosticSummary')
        for path in panel.get('paths', []):
            topic, *fields = path['value'].split('.')
            check(topic, fields)
            named.add(topic)
        if kind == 'DiagnosticSummary':
            assert panel['topicToRender'] == DIAGNOSTICS
    assert named == set(TYPES)


def test_rqt_plot():
    """Its layout is a command line, in the page on tuning."""
    page = (REPOSITORY / 'docs' / 'tuning.md').read_text()
    commands = re.findall(r'ros2 run rqt_plot rqt_plot ((?:.*\\\n)*.*)', page)
    assert commands
    for command in commands:
        paths = command.replace('\\\n', ' ').split()
        assert paths
        for path in paths:
            check_path(path)


def test_the_topics_are_those_of_the_node():
    """By its source, as the tests of the node listen on them by the same names."""
    source = (PACKAGE / 'ros' / 'node.py').read_text()
    for name in ("'imu/data_raw'", "'imu/data_filtered'", "f'~/{name}'", "'~/at_rest'"):
        assert name in source
    assert f"'{DIAGNOSTICS}'" in source
