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

"""The page of a fleet: its ranking, its histories, its links, and how it does in a browser."""

import json

import pyarrow.parquet as pq
import pytest

from gyro_drift_filter.cli.fleet import summary
from gyro_drift_filter.cli.fleet_report import ranking_text
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.fleet.columns import read_table, write_table
from gyro_drift_filter.fleet.health import judge_fleet
from gyro_drift_filter.simulation.sensor import START
from support.browser import check_quiet, opened, wait_for
from support.messages import EVIL

DAY = 86_400 * 10**9


def row(robot, day, axis, **figures):
    """Return a row of the table of a sensor that does well, but for some figures."""
    return {
        'robot': robot, 'source': f'/bags/{robot}/day_{day}', 'content': f'{robot}{day}',
        'topic': '/imu', 'frame_id': 'imu_link', 'axis': axis, 'notes': [], 'faults': [],
        # The robots have figures of their own: the same ones would be those of a copy.
        'start': START + day * DAY, 'duration': 60.0 + 0.01 * ord(robot[0]), 'messages': 6000,
        'gaps': 0,
        'noise': 2e-3 * (1.0 + 0.01 * (day % 3)), 'noise_samples': 3000,
        'bias': 0.01 + 1e-4 * (day % 2), 'bias_deviation': 1e-4, 'outlier_share': 0.0,
    } | figures  # fmt: skip


@pytest.fixture
def fleet(tmp_path):
    """Path of what a fleet of three robots has left, with a report on one bag."""
    rows = [
        row(
            robot,
            day,
            axis,
            **({'noise': 6e-3} if (robot, axis) == (EVIL, 'y') and day > 4 else {}),
        )
        for robot in ('a', EVIL, 'c')
        for day in range(9)
        for axis in 'xyz'
    ]
    rows += [
        {'robot': 'c', 'source': f'/bags/{EVIL}', 'error': f'{topic}, {EVIL}'}
        for topic in ('front', 'rear')
    ]
    out = tmp_path / 'out'
    (out / 'reports').mkdir(parents=True)
    write_table(out / 'fleet.parquet', rows)
    (out / 'reports' / 'a3.html').write_text('<title>the report on a bag</title>')
    return out


def made(fleet, folder):
    page = folder / 'fleet.html'
    arguments = ['-o', str(page), '--json', str(folder / 'health.json')]
    assert main(['fleet-report', str(fleet), *arguments]) == 0
    return page, json.loads((folder / 'health.json').read_text())['sensors']


def test_the_figures_are_printed_for_programs(fleet, tmp_path, capsys):
    _, sensors = made(fleet, tmp_path)
    capsys.readouterr()
    assert main(['fleet-report', str(fleet), '-o', str(tmp_path / 'b'), '--json', '-']) == 0
    assert json.loads(capsys.readouterr().out)['sensors'] == sensors
    assert (tmp_path / 'b').exists()


def test_the_page_and_the_figures(fleet, tmp_path, capsys):
    page, sensors = made(fleet, tmp_path)
    assert [sensor['robot'] for sensor in sensors] == [EVIL, 'a', 'c']
    (change,) = sensors[0]['changes']
    assert (change['quantity'], change['axis'], change['certain']) == ('noise', 'y', True)
    assert change['since'] == START + 5 * DAY
    assert not any(sensor['changes'] for sensor in sensors[1:])
    assert 'noise y' in capsys.readouterr().out
    text = page.read_text()
    assert 'alert(1)</script>' not in text
    assert '1 of 3 sensors gets worse' in text
    assert '<summary>1 bag without figures</summary>' in text
    assert 'href="out/reports/a3.html"' in text
    assert "default-src 'none'" in text


@pytest.mark.slow
def test_a_fleet_that_is_too_young_is_not_called_well(tmp_path, capsys):
    """A change takes four bags of a sensor to be seen."""
    some = 'No sensor gets worse; 1 of 2 can not be judged yet: that takes 4 bags.'
    for days, robots, said in (
        (3, 'a', 'No sensor can be judged yet'),
        (4, 'a', 'No sensor gets worse.'),
        (4, 'ab', some),
    ):
        folder = tmp_path / f'{robots}{days}'
        folder.mkdir()
        rows = [row('a', day, axis) for day in range(days) for axis in 'xyz']
        rows += [row(robot, 0, axis) for robot in robots[1:] for axis in 'xyz']
        write_table(folder / 'fleet.parquet', rows)
        page, _ = made(folder, folder)
        assert said in page.read_text()
        assert said in capsys.readouterr().out


def test_a_summary_that_lists_the_worst_counts_all(fleet, tmp_path):
    """Where the first ones are too young, the others are judged all the same."""
    days = {'a': 1, 'b': 4}
    rows = [row(robot, day, axis) for robot in 'ab' for day in range(days[robot]) for axis in 'xyz']
    write_table(tmp_path / 'young.parquet', rows)
    sensors = judge_fleet(read_table(tmp_path / 'young.parquet'))
    assert [sensor.is_judged for sensor in sensors] == [False, True]
    assert ranking_text(sensors, 1).startswith('No sensor gets worse; 1 of 2')
    worse = ranking_text(judge_fleet(read_table(fleet / 'fleet.parquet')), 1)
    assert worse.startswith('1 of 3 sensors gets worse.\n\nrobot')


def test_notes_are_on_the_page_in_the_figures_and_in_the_summary(fleet, tmp_path, capsys):
    out = tmp_path / 'copied'
    out.mkdir()
    rows = read_table(fleet / 'fleet.parquet').to_pylist()
    copies = [
        row | {'source': f'/bags/copy/{EVIL}', 'topic': topic}
        for row in rows
        if row['source'] == '/bags/a/day_3'
        for topic in ('/imu', '/rear', '/rear')
    ]
    copies[-1] |= {'source': '/bags/copy/again'}
    rear = [row | {'topic': '/rear'} for row in rows if row['source'] == '/bags/a/day_3']
    write_table(out / 'fleet.parquet', rows + copies + rear)
    page, sensors = made(out, tmp_path)
    note = f'{EVIL} is not counted, as it is a copy of /bags/a/day_3'
    noted = [sensor['notes'] for sensor in sensors if sensor['notes']]
    assert noted[0] == [f'/bags/copy/{note}']
    assert len(noted) == 2
    assert 'is not counted, as it is a copy of /bags/a/day_3</p>' in page.read_text()
    assert 'alert(1)</script>' not in page.read_text()
    assert 'note: a: /bags/copy/' in capsys.readouterr().out
    sensors = judge_fleet(read_table(out / 'fleet.parquet'))
    assert ranking_text(sensors, 1).endswith('\nand 1 more notes, on the page')


def test_a_sensor_without_a_bag_that_counts_has_notes_and_no_plot(tmp_path):
    rows = [row(robot, day, axis) for robot in 'ab' for day in range(4) for axis in 'xyz']
    for of_a in rows[:12]:
        of_a['start'] -= START
    write_table(tmp_path / 'fleet.parquet', rows)
    page, sensors = made(tmp_path, tmp_path)
    assert [(sensor['robot'], sensor['bags']) for sensor in sensors] == [('a', 0), ('b', 4)]
    text = page.read_text()
    assert 'the clock of the recorder was not set; nor are 3 more</p></section>' in text
    assert [f'data-sensor="{k}"' in text for k in range(2)] == [False, True]


def test_a_bag_of_which_two_topics_fail_counts_once(fleet):
    first, front, rear, *_ = summary(fleet).splitlines()
    assert first == '1 bag without figures'
    assert (front, rear) == tuple(f'/bags/{EVIL}: {topic}, {EVIL}' for topic in ('front', 'rear'))


def test_what_is_no_fleet_is_told(fleet, tmp_path, capsys):
    other = tmp_path / 'other'
    other.mkdir()
    page = str(tmp_path / 'page.html')
    assert main(['fleet-report', str(other), '-o', page]) == 1
    assert 'can not be read' in capsys.readouterr().err
    pq.write_table(
        pq.read_table(fleet / 'fleet.parquet', columns=['robot']), other / 'fleet.parquet'
    )
    assert main(['fleet-report', str(other), '-o', page]) == 1
    assert 'is no table of a fleet: it has no' in capsys.readouterr().err


@pytest.mark.slow
def test_heads_of_the_ranking_stay_whole_in_a_narrow_window(browser, fleet, tmp_path):
    page, _ = made(fleet, tmp_path)
    opened(browser, page)
    size = browser.get_window_size()
    browser.set_window_size(500, 800)
    lines = browser.execute_script("""
        return [...document.querySelectorAll('#ranking th')]
            .filter(head => !head.textContent.includes(' '))
            .map(head => {
                const words = document.createRange();
                words.selectNodeContents(head);
                return new Set([...words.getClientRects()].map(line => line.top)).size;
            });
    """)
    browser.set_window_size(size['width'], size['height'])
    assert lines
    assert set(lines) == {1}


@pytest.mark.slow
def test_the_page_in_a_browser(browser, fleet, tmp_path):
    page, _ = made(fleet, tmp_path)
    opened(browser, page)
    ranking = browser.execute_script(
        "return [...document.querySelectorAll('#ranking tbody tr')].map(r => r.textContent)"
    )
    assert len(ranking) == 1
    assert EVIL in ranking[0]
    assert 'noise y 0.116 to 0.344 deg/s' in ranking[0]
    for k in range(3):
        node = f"document.querySelectorAll('.plot')[{k}]"
        browser.execute_script(f'{node}.scrollIntoView()')
        wait_for(browser, lambda node=node: browser.execute_script(f'return Boolean({node}.drawn)'))
        drawn = browser.execute_script(f'return {node}.data.map(t => [t.name, t.x.length])')
        assert drawn == [[axis, 9] for axis in (*'xyz', *'xyz', *'xyz', '')]
    lines = 'return document.querySelectorAll(".plot")[{}]._fullLayout.shapes.map(s => s.x0)'
    assert browser.execute_script(lines.format(0)) == ['2020-09-18 12:26:40']
    assert browser.execute_script(lines.format(1)) == []
    # A robot in the ranking leads to its history.
    browser.execute_script("document.querySelector('#ranking a').click()")
    assert browser.execute_script('return location.hash') == '#sensor-0'
    back = 'return getComputedStyle(document.body).backgroundColor'
    before = browser.execute_script(back)
    browser.execute_script("document.querySelector('#theme').click()")
    assert browser.execute_script(back) != before
    check_quiet(browser, page)
    # A click on a point opens the report on its bag.
    browser.execute_script(
        "document.querySelectorAll('.plot')[1].emit('plotly_click', {points: [{customdata: 3}]})"
    )
    wait_for(browser, lambda: browser.title == 'the report on a bag')
