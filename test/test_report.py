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

"""The report page: its figures, its text, and how it does in a real browser."""

import errno
import itertools
import json
import re
import shutil
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.cli.report import shortest_names
from gyro_drift_filter.core import Filter, GyroDriftFilterError, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.fleet.measuring import Job, measure
from gyro_drift_filter.fleet.sources import find_bags
from gyro_drift_filter.identify.allan import allan_deviation
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.report import pictures
from gyro_drift_filter.report.figures import Drawer, autocorrelation, reduced
from gyro_drift_filter.report.page import LARGEST_PAGE, points_for
from gyro_drift_filter.report.sample_times import each_sample_seconds, no_sample_times
from gyro_drift_filter.report.signals import Signals
from gyro_drift_filter.simulation.bag import TOPIC, imu_message, imu_messages, write_simulation
from gyro_drift_filter.simulation.experiments import SimulationSettings, simulate
from gyro_drift_filter.simulation.sensor import START
from support.bags import write, write_imus
from support.browser import check_quiet, opened, wait_for
from support.chunks import filtered_imus
from support.messages import EVIL
from support.paths import PACKAGE
from support.sensor import at_rest


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Path of a simulated bag: twenty seconds at rest, twenty in motion with outliers."""
    folder = tmp_path_factory.mktemp('report')
    write_simulation(folder / 'bag', simulate(SimulationSettings(7, 100.0, 20.0, 20.0)))
    return folder / 'bag'


def report(source, folder, *options, others=()):
    """Return the page of a bag and others as text, and their verdicts."""
    arguments = ['report', str(source), *map(str, others), '-o', str(folder / 'page.html')]
    arguments += ['--json', str(folder / 'v.json'), *map(str, options)]
    assert main(arguments) == 0
    verdicts = json.loads((folder / 'v.json').read_text())['verdicts']
    return (folder / 'page.html').read_text(), verdicts


class Cells(HTMLParser):
    """Collects the figures of a page, and the text of all but scripts and styles."""

    def __init__(self, page):
        super().__init__()
        self.values, self.tags, self.text, self._within = {}, [], '', ''
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self._within = tag
        self.tags.append((tag, dict(attributes)))
        found = dict(attributes)
        if 'data-name' in found:
            self.values.setdefault(found['data-name'], float(found['data-value']))

    def handle_data(self, data):
        if self._within not in ('script', 'style'):
            self.text += data


def value_in(verdict, name):
    """Return the figure of a name like bias.rates.2 in a verdict that was read from JSON."""
    for part in name.split('.'):
        verdict = verdict[int(part) if part.isdigit() else part]
    return verdict


def check_figures(values, verdict):
    checked = 0
    for name, value in values.items():
        if name in ('median_ratio', 'largest_change', 'outliers'):  # made of several
            continue
        assert value == value_in(verdict, name), name
        checked += 1
    return checked


def test_the_page_shows_the_figures_of_the_verdict(source, tmp_path, capsys):
    text, (verdict,) = report(source, tmp_path)
    cells = Cells(text)
    assert check_figures(cells.values, verdict) == 21
    assert 'It helped: ' in cells.text
    assert 'It helped: ' in capsys.readouterr().out
    main(['replay', str(source), '-o', str(tmp_path / 'out'), '--json', str(tmp_path / 'r.json')])
    (replayed,) = json.loads((tmp_path / 'r.json').read_text())['verdicts']
    assert replayed == verdict
    figures = [attributes['id'] for tag, attributes in cells.tags if tag == 'figure']
    assert figures == [
        f'{name}-0'
        for name in (
            'rates', 'angles', 'bias', 'innovations', 'noise',
            'spectrum', 'allan', 'autocorrelation', 'histogram',
        )
    ]  # fmt: skip


def test_the_page_asks_for_nothing_beside_itself(source, tmp_path):
    cells = Cells(report(source, tmp_path)[0])
    for _, attributes in cells.tags:
        assert not {'src', 'href', 'srcset', 'action'} & attributes.keys()
    (policy,) = [a['content'] for t, a in cells.tags if t == 'meta' and 'http-equiv' in a]
    assert "default-src 'none'" in policy
    assert 'unsafe-inline' not in policy.split('script-src')[1].split(';')[0]


def evil_bag(path):
    stamps = 10**18 + 10**7 * np.arange(700)
    rates = [(0.1, k % 7 * 1e-3, 0.0) for k in range(700)]
    imu = imu_messages(stamps, rates, (0, 0, 9.8), frame=EVIL)
    return write(path, {(f'/imu/{EVIL}', IMU_TYPE): imu})


def test_what_the_bag_names_stays_text(tmp_path):
    text, _ = report(evil_bag(tmp_path / 'in'), tmp_path)
    assert 'alert(1)</script>' not in text
    cells = Cells(text)
    assert f'/imu/{EVIL}' in cells.text
    assert f'frame {EVIL}' in cells.text
    kinds = [dict(attributes).get('type') for tag, attributes in cells.tags if tag == 'script']
    assert kinds.count(None) == 2  # the library and what draws; all else is data
    assert set(kinds) == {None, 'application/json'}
    assert not any(tag == 'img' for tag, _ in cells.tags)


@pytest.mark.slow
def test_a_replayed_bag_is_told_to_be_the_same_or_another_one(source, tmp_path):
    replay(source, tmp_path / 'same', parameters=Parameters())
    replay(source, tmp_path / 'other', parameters=Parameters(outlier_threshold=3.0))
    (tmp_path / 'a').mkdir()
    (tmp_path / 'b').mkdir()
    same = Cells(report(tmp_path / 'same', tmp_path / 'a')[0])
    assert 'is what the filter makes here, bit for bit' in same.text
    assert 'filtered, as recorded' not in same.text
    other = Cells(report(tmp_path / 'other', tmp_path / 'b')[0])
    assert 'is another one than the filter makes here' in other.text
    assert 'filtered, as recorded' in other.text


@pytest.mark.slow
def test_methods_and_bags_are_compared(source, tmp_path):
    other = shutil.copytree(source, tmp_path / source.name)
    text, verdicts = report(source, tmp_path, '--methods', 'kalman', 'adaptive', others=[other])
    assert [v['method'] for v in verdicts] == ['kalman', 'adaptive'] * 2
    assert len(text) < LARGEST_PAGE
    cells = Cells(text)
    assert 'noise at rest, ratio' in cells.text
    assert [a['id'] for t, a in cells.tags if t == 'section'] == ['bag-0', 'bag-1']
    assert f'{source.parent.name}/bag' in cells.text
    assert f'{tmp_path.name}/bag' in cells.text


def test_bags_have_the_shortest_names_that_tell_them_apart(tmp_path):
    assert shortest_names([tmp_path / 'a' / 'run']) == ['run']
    assert shortest_names([tmp_path / 'a' / 'run', tmp_path / 'b' / 'drive']) == ['run', 'drive']
    same = [tmp_path / 'a' / 'run', tmp_path / 'b' / 'run', tmp_path / 'b' / 'drive']
    assert shortest_names(same) == ['a/run', 'b/run', 'b/drive']
    # Pictures go into folders of these names, which must not lead elsewhere.
    assert shortest_names([Path('/run'), tmp_path / 'run']) == ['run', f'{tmp_path.name}/run']
    with pytest.raises(GyroDriftFilterError, match='run is named twice'):
        shortest_names([tmp_path / 'run', tmp_path / 'a' / '..' / 'run'])


def test_a_link_to_itself_is_no_bag(tmp_path, capsys):
    (tmp_path / 'loop').symlink_to('loop')
    assert main(['report', str(tmp_path / 'loop'), '-o', str(tmp_path / 'page.html')]) == 1
    assert 'no such bag: ' in capsys.readouterr().err


@pytest.mark.slow
def test_the_figures_as_pictures(source, tmp_path):
    report(source, tmp_path, '--png', tmp_path / 'png', '--start', 15, '--end', 25)
    pictures = list((tmp_path / 'png').glob('*.png'))
    assert {'rates.png', 'angles.png', 'bias.png'} < {path.name for path in pictures}
    assert all(path.read_bytes().startswith(b'\x89PNG') for path in pictures)


@pytest.mark.slow
def test_pictures_that_the_disk_does_not_take_cost_no_other_result(
    source, tmp_path, monkeypatch, capsys
):
    def savefig(figure, path, **_):
        Path(path).write_bytes(b'a part')
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr('matplotlib.figure.Figure.savefig', savefig)
    page, results, folder = (tmp_path / name for name in ('page.html', 'results.json', 'png'))
    files = ['-o', str(page), '--json', str(results), '--png', str(folder)]
    assert main(['report', str(source), *files, '--start', '15', '--end', '25']) == 1
    printed = capsys.readouterr()
    assert f'{folder}/rates.png can not be written: No space left on device\n' in printed.err
    assert printed.out.endswith(f'\nwrote {page}\n      {results}\n')
    assert page.read_text().endswith('</html>\n')
    assert json.loads(results.read_text())['verdicts']
    assert list(folder.iterdir()) == []


def test_points_share_the_room():
    assert points_for(1) > 500_000
    assert points_for(4) == pytest.approx(points_for(1) / 4, abs=1)


@pytest.mark.slow
@given(st.lists(st.floats(-1e6, 1e6, width=32) | st.just(np.nan), max_size=400), st.integers(4, 60))
def test_a_reduced_signal_keeps_its_extremes(values, room):
    values = np.array(values, np.float32)
    where = reduced(values, room)
    finite = values[np.isfinite(values)]
    assert len(where) <= room or len(where) == len(finite) <= room
    assert (np.diff(where) > 0).all()
    if len(finite):
        assert values[where].min() == finite.min()
        assert values[where].max() == finite.max()


def test_autocorrelation_is_that_of_its_definition(random):
    values = np.convolve(random.standard_normal(5000), [1.0, 0.5, 0.2], 'valid')
    centred = values - values.mean()
    expected = [centred[k:] @ centred[:-k] / (centred @ centred) for k in (1, 2, 3)]
    np.testing.assert_allclose(autocorrelation(values, 3), expected, atol=1e-9)


def test_angles_are_the_integral_by_the_stamps(random):
    """With a gap that the stamps tell, and jumps and rates that count for a period or nothing."""
    n = 600
    stamps = 10**18 + 10**7 * np.arange(n)
    stamps[200:] += 5 * 10**7
    stamps[400:] += 10**11
    rates = 0.1 + 0.01 * random.standard_normal((n, 3))
    rates[300, 0] = np.nan
    filter_ = Filter()
    imus = filtered_imus(filter_, stamps, rates, np.tile([0.0, 0.0, 9.8], (n, 1)))
    signals = Signals(filter_)
    for first, stop in ((0, 1), (1, 250), (250, n)):
        signals.take(imus[first:stop], stamps[first:stop])
    steps = np.diff(stamps, prepend=stamps[0] - 10**7) * 1e-9
    steps[400] = 0.01
    expected = np.cumsum(np.nan_to_num(rates) * steps[:, None], axis=0)
    got = np.column_stack([np.asarray(c) for c in signals.columns['raw_angle']])
    np.testing.assert_allclose(got, expected, rtol=2e-3)
    np.testing.assert_allclose(got[1:250], expected[1:250], rtol=1e-5)


BATCHES = np.arange(3000) // 10 * 10 + 9


@pytest.mark.parametrize(
    'places',
    [
        pytest.param(BATCHES, id='ten samples are stamped as one'),
        pytest.param(np.where(np.arange(3000) < 1000, 5, BATCHES), id='not at the start'),
        pytest.param(np.arange(3000) ^ 1, id='each two samples are swapped'),
        pytest.param(np.zeros(3000, int), id='never'),
    ],
)
def test_time_that_stamps_tell_late_counts_once(places):
    """Samples of 100 Hz, with the stamps that belong to these places."""
    stamps = 10**18 + 10**7 * places
    steps, times = np.empty(3000), no_sample_times()
    times['period'], times['longest'] = 0.01, 1000.0
    each_sample_seconds(stamps, stamps, times, steps)
    assert steps.sum() == pytest.approx(30.0, abs=0.2)
    assert (np.cumsum(steps) < 0.01 * np.arange(3000) + 0.2).all()


@pytest.mark.slow
def test_a_recording_without_rest_or_with_a_dead_axis_has_a_page(tmp_path):
    seconds = np.arange(900) / 100
    rates = np.column_stack([np.sin(3 * seconds), np.cos(2 * seconds), 0 * seconds + 0.5])
    rates[100] = np.nan
    imu = [
        (10**18 + 10**7 * k, imu_message(10**18 + 10**7 * k, rate, (0, 0, 9.8)))
        for k, rate in enumerate(rates)
    ]
    text, (verdict,) = report(write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu}), tmp_path)
    assert verdict['outcome'] == 'useless'
    assert verdict['silent'][2].startswith('dead, always')
    assert 'NaN' not in re.findall(r'<script type="application/json".*?</script>', text, re.S)[0]
    # Zero stood for a bias that is not known.
    assert [shown(text, f'bias.rates.{axis}') for axis in range(3)] == ['-', '-', '-']
    assert shown(text, 'bias.deviations.0') != '-'
    assert shown(text, 'change_in_motion.0') != '-'
    assert shown(text, 'change_in_motion.2') == '-'
    (tmp_path / 'cut').mkdir()
    options = ['--end', '0.5', '--methods', 'kalman', 'sage_husa']
    cut, _ = report(tmp_path / 'in', tmp_path / 'cut', *options)
    # Of less than a second nothing is known of what is changed in motion.
    assert shown(cut, 'largest_change') == shown(cut, 'change_in_motion.0') == '-'


@pytest.mark.slow
def test_page_and_row_are_by_log_times_where_stamps_are_zero(tmp_path, random):
    rates = 0.002 * random.standard_normal((800, 3))
    messages = [
        (10**18 + 5 * 10**7 * k, imu_message(0, rate, (0, 0, 9.8))) for k, rate in enumerate(rates)
    ]
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): messages})
    text, _ = report(source, tmp_path)
    assert '800 Imu messages of 800, 20 Hz' in Cells(text).text
    (bag,) = find_bags([str(source)], None)
    row = measure(bag, Job(Parameters())).rows[0]
    assert row['sample_rate'] == pytest.approx(20.0)
    assert 25.0 < row['rest'] < 41.0


def figures_of(rates, step, stamp_step, pauses=()):
    """Return the figures by name, and what the filter made of the samples.

    Steps are those of log times and of stamps, in ns. Samples (n,) of stamps come late by pauses.
    """
    n = len(rates)
    late = np.zeros(n, np.int64) if not len(pauses) else np.asarray(pauses)
    stamps = 10**18 + stamp_step * np.arange(n) + late
    filter_ = Filter()
    imus = filtered_imus(filter_, stamps, rates, np.tile([0.0, 0.0, 9.8], (n, 1)))
    signals = Signals(filter_)
    signals.take(imus, 10**18 + step * np.arange(n) + late)
    drawer = Drawer({'adaptive': signals}, 10**18, 10_000)
    return {figure.name: figure for figure in drawer.figures()}, imus['result']


def test_the_spectrum_is_by_log_times_where_stamps_stand(random):
    figures, _ = figures_of(0.002 * random.standard_normal((800, 3)), 5 * 10**7, 5 * 10**4)
    assert figures['spectrum'].panels['x'][0].x[-1] == pytest.approx(10.0, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(('pause', 'breaks'), [(0.5, 0), (20.0, 1)])
def test_a_line_ends_where_samples_are_missing_for_long(pause, breaks, random):
    """A slope across 20 s without a sample showed what no filter had said."""
    late = np.where(np.arange(6000) < 2500, 0, int(1e9 * pause))
    figures, _ = figures_of(0.002 * random.standard_normal((6000, 3)), 10**7, 10**7, late)
    for figure in figures.values():
        for trace in itertools.chain(*figure.panels.values()) if figure.in_time else ():
            if trace.style == 'line':
                missing = np.flatnonzero(np.isnan(trace.y))
                assert len(missing) == breaks
                assert (np.abs(trace.x[missing] - 25.5 - pause) <= 0.5).all()
                assert (np.diff(trace.x) >= 0.0).all()
                assert (trace.x[missing - 1] < 25.0).all()


@pytest.mark.slow
@pytest.mark.parametrize('n', [4000, 3008])
def test_outliers_and_the_end_of_a_rest_are_no_noise_in_its_curves(n, random):
    """Whether the recording goes on or ends as the motion begins."""
    deviation = 0.002
    rates = deviation * random.standard_normal((n, 3))
    rates[1000:2500:300] += 0.5
    rates[1500] = np.nan
    rates[3000:] += 0.02 * np.arange(n - 3000)[:, None] / 100
    figures, result = figures_of(rates, 10**7, 10**7)
    first, last = np.flatnonzero(result['at_rest'] > 0)[[0, -1]]
    assert last > 3000
    assert (last < n - 1) == (n == 4000)
    assert (result['outlier'][1000:2500:300] > 0).all()
    # Whole seconds but the last one, as the noise of a rest is counted.
    places = np.arange(first, first + 100 * ((last + 1 - first) // 100 - 1))
    assert places[-1] < 3000
    for axis, name in enumerate('xyz'):
        good = places[np.isfinite(rates[places, axis]) & (result['outlier'][places, axis] == 0)]
        expected = np.interp(places, good, rates[good, axis])
        (allan,) = (trace for trace in figures['allan'].panels[name] if trace.role == 'raw')
        deviations = 3600 * np.degrees(allan_deviation([expected], 0.01).deviations)
        np.testing.assert_allclose(allan.y, deviations, rtol=1e-4)
        (power,) = (trace for trace in figures['spectrum'].panels[name] if trace.role == 'raw')
        # Of white noise the density is twice its variance over the rate.
        assert np.median(power.y) == pytest.approx(2 * np.degrees(deviation) ** 2 / 100, rel=0.3)


def shown(page, name):
    """Return what stands in the cell of a figure."""
    return re.findall(rf'data-name="{re.escape(name)}"[^>]*>([^<]*)<', page)[0]


def test_an_outlier_counts_once_in_the_table_of_methods(tmp_path, random):
    rates = 0.002 * random.standard_normal((3000, 3))
    rates[(1500, 2000), :] += 2.0
    stamps = 10**18 + 10**7 * np.arange(len(rates))
    imu = imu_messages(stamps, rates, (0, 0, 9.8))
    source = write(tmp_path / 'in', {(TOPIC, IMU_TYPE): imu})
    text, (verdict, _) = report(source, tmp_path, '--methods', 'adaptive', 'kalman')
    assert verdict['outliers']['axes'] == [2, 2, 2]
    assert shown(text, 'outliers') == '2'
    assert '2 samples flagged as outliers' in text
    assert 'held back' not in text  # kalman uses what it flags


@pytest.mark.parametrize('command', ['report', 'replay'])
def test_outliers_that_nobody_looks_for_are_told_on_page_and_terminal(
    command, source, tmp_path, capsys
):
    settings = tmp_path / 'settings.yaml'
    settings.write_text('/**:\n  ros__parameters:\n    outlier:\n      enabled: false\n')
    target = tmp_path / 'target'
    assert main([command, str(source), '-o', str(target), '--params', str(settings)]) == 0
    said = 'not looked for: outlier.enabled is false'
    printed = capsys.readouterr().out
    assert f'outliers {said}' in printed
    if command == 'report':
        page = target.read_text()
        assert said in Cells(page).text
        assert [shown(page, f'outliers.axes.{axis}') for axis in range(3)] == ['-'] * 3
    else:
        rows = printed.split('outliers\n')[-1].splitlines()[:3]
        assert [row.split()[-1] for row in rows] == ['-'] * 3


def test_wrong_options_are_told_before_the_work(source, tmp_path, capsys):
    page = tmp_path / 'page.html'
    page.write_text('mine')
    assert main(['report', str(source), '-o', str(page)]) == 1
    assert 'exists already' in capsys.readouterr().err
    assert page.read_text() == 'mine'
    assert main(['report', str(source), '-o', str(tmp_path / 'page.pdf')]) == 1
    assert 'what is written is an HTML page: name it .html' in capsys.readouterr().err
    other = str(tmp_path / 'other.html')
    assert main(['report', str(source), '-o', other, '--start', '5', '--end', '2']) == 1
    assert main(['report', str(source), '-o', other, '--start', '5000']) == 1
    assert f'topic {TOPIC} has no messages from 5000 s on, counted' in capsys.readouterr().err
    assert main(['report', str(source), '-o', other, '--png', str(tmp_path / 'a.png')]) == 1
    assert '--png' in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main(['report', str(source), '-o', other, '--methods', 'magic'])
    for folder in ('png', 'png/b'):
        (tmp_path / folder).mkdir()
        picture = tmp_path / folder / 'rates.png'
        picture.touch()
        arguments = [str(source)] if folder == 'png' else [str(tmp_path / 'b'), str(source)]
        options = ['-o', other, '--png', str(tmp_path / 'png')]
        capsys.readouterr()
        assert main(['report', *arguments, *options]) == 1
        assert 'it holds PNG files already: remove them or choose' in capsys.readouterr().err
        picture.unlink()


def test_libraries_that_are_missing_are_named(source, tmp_path, monkeypatch, capsys):
    monkeypatch.setitem(__import__('sys').modules, 'tsdownsample', None)
    assert main(['report', str(source), '-o', str(tmp_path / 'page.html')]) == 1
    assert 'pip install plotly tsdownsample' in capsys.readouterr().err


def range_of(browser, number):
    script = f"return document.querySelectorAll('.plot')[{number}]._fullLayout.xaxis.range"
    return browser.execute_script(script)


def click(browser, selector):
    browser.execute_script(f'document.querySelector({selector!r}).click()')


@pytest.mark.slow
def test_the_page_in_a_browser(browser, source, tmp_path):
    _, (verdict,) = report(source, tmp_path)
    opened(browser, tmp_path / 'page.html')
    cells = browser.execute_script(
        "return [...document.querySelectorAll('td[data-name]')].map(c => "
        '[c.dataset.name, c.dataset.value, c.textContent])'
    )
    assert check_figures({name: float(value) for name, value, _ in cells}, verdict) == 21
    shown = {name: text for name, _, text in cells}
    assert shown['bias.rates.1'] == f'{np.degrees(verdict["bias"]["rates"][1]):.4f}'
    # All figures are drawn as they come into sight.
    count = browser.execute_script("return document.querySelectorAll('.plot').length")
    for k in range(count):
        node = f"document.querySelectorAll('.plot')[{k}]"
        browser.execute_script(f'{node}.scrollIntoView()')
        wait_for(browser, lambda node=node: browser.execute_script(f'return Boolean({node}.drawn)'))
    browser.execute_script("document.querySelectorAll('.plot')[4].scrollIntoView()")
    # A zoom by a button, by a key and within a figure moves all figures over time.
    click(browser, 'button[data-action=closer]')
    wait_for(browser, lambda: range_of(browser, 4) == pytest.approx([10.0, 30.0], abs=0.1))
    browser.execute_script(
        "document.querySelectorAll('.plot')[4].dispatchEvent(new KeyboardEvent('keydown', "
        "{key: 'ArrowRight', bubbles: true}))"
    )
    wait_for(browser, lambda: range_of(browser, 4) == pytest.approx([15.0, 35.0], abs=0.1))
    browser.execute_script(
        "Plotly.relayout(document.querySelectorAll('.plot')[4], "
        "{'xaxis.range[0]': 25, 'xaxis.range[1]': 26})"
    )
    for k in (3, 0):
        browser.execute_script(f"document.querySelectorAll('.plot')[{k}].scrollIntoView()")
        wait_for(browser, lambda k=k: range_of(browser, k) == pytest.approx([25.0, 26.0]))
    # So close, each sample is there.
    points = browser.execute_script(
        "return document.querySelectorAll('.plot')[0].data.find(t => t.name === 'x raw').x.length"
    )
    assert 100 <= points <= 104
    names = "return document.querySelectorAll('.plot')[0].data.map(t => t.name)"
    assert 'y raw' in browser.execute_script(names)
    click(browser, 'button[data-role=raw]')
    assert 'y raw' not in browser.execute_script(names)
    click(browser, 'button[data-axis=z]')
    assert not [name for name in browser.execute_script(names) if name.startswith('z')]
    back = 'return getComputedStyle(document.body).backgroundColor'
    before = browser.execute_script(back)
    click(browser, '#theme')
    assert browser.execute_script(back) != before
    check_quiet(browser, tmp_path / 'page.html')


def displayed(browser, selector):
    return browser.execute_script(
        f'return [...document.querySelectorAll({selector!r})].map(n => getComputedStyle(n).display)'
    )


@pytest.mark.slow
def test_the_printed_page_has_its_legend_and_all_parameters(browser, source, tmp_path):
    report(source, tmp_path)
    opened(browser, tmp_path / 'page.html')
    click(browser, 'button[data-role=raw]')
    browser.execute_script("dispatchEvent(new Event('beforeprint'))")
    browser.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': 'print'})
    shown = {
        role: displayed(browser, f'button[data-role={role}]')[0] != 'none'
        for role in ('raw', 'adaptive', 'outlier', 'rest')
    }
    assert shown == {'raw': False, 'adaptive': True, 'outlier': True, 'rest': True}
    assert set(displayed(browser, '#theme, [data-axis], [data-action]')) == {'none'}
    is_open = "return document.querySelector('details').open"
    assert browser.execute_script(is_open)
    browser.execute_cdp_cmd('Emulation.setEmulatedMedia', {'media': ''})
    browser.execute_script("dispatchEvent(new Event('afterprint'))")
    assert not browser.execute_script(is_open)
    assert 'none' not in displayed(browser, '#theme')


@pytest.mark.slow
def test_without_scripts_the_page_says_what_is_missing(browser, source, tmp_path):
    report(source, tmp_path)
    browser.execute_cdp_cmd('Emulation.setScriptExecutionDisabled', {'value': True})
    try:
        browser.get((tmp_path / 'page.html').as_uri())
        said = browser.find_element('css selector', 'noscript p')
        assert said.is_displayed()
        assert 'The figures are missing' in said.text
        dead = browser.find_elements('css selector', 'button, figure')
        assert dead
        assert not any(element.is_displayed() for element in dead)
        assert browser.find_element('css selector', 'td[data-name]').is_displayed()
    finally:
        browser.execute_cdp_cmd('Emulation.setScriptExecutionDisabled', {'value': False})


@pytest.mark.slow
def test_labels_of_the_allan_deviation_are_powers_of_ten(browser, source, tmp_path):
    report(source, tmp_path)
    opened(browser, tmp_path / 'page.html')
    node = "document.querySelector('figure[id^=allan] .plot')"
    browser.execute_script(f'{node}.scrollIntoView()')
    wait_for(browser, lambda: browser.execute_script(f'return Boolean({node}.drawn)'))
    labels = browser.execute_script(
        f"return [...{node}.querySelectorAll('.ytick text')].map(t => t.textContent)"
    )
    assert len(labels) >= 2
    assert not [label for label in labels if not label.startswith(('1', '0.1'))], labels


@pytest.mark.slow
def test_a_line_that_ends_in_a_pause_does_so_in_a_browser(browser, tmp_path, random):
    rates, accelerations = at_rest(random, 60)
    stamps = START + 10**7 * np.arange(len(rates))
    stamps[2500:] += 20 * 10**9
    report(write_imus(tmp_path / 'in', stamps, rates, accelerations), tmp_path)
    opened(browser, tmp_path / 'page.html')
    wait_for(
        browser,
        lambda: browser.execute_script("return Boolean(document.querySelector('.plot').drawn)"),
    )
    trace = "document.querySelector('.plot').data.find(t => t.name === 'x raw')"
    values = f'return {trace}.y.map(Number.isNaN).map(Number)'
    times = f'return {trace}.x'
    missing = np.flatnonzero(browser.execute_script(values))
    assert len(missing) == 1
    assert browser.execute_script(times)[missing[0] - 1] == pytest.approx(25.0, abs=0.2)
    check_quiet(browser, tmp_path / 'page.html')


@pytest.mark.slow
def test_what_the_bag_names_runs_nothing_in_a_browser(browser, tmp_path):
    report(evil_bag(tmp_path / 'in'), tmp_path)
    opened(browser, tmp_path / 'page.html')
    heading = browser.execute_script("return document.querySelector('h1').textContent")
    assert EVIL in heading
    check_quiet(browser, tmp_path / 'page.html')


def palettes_of_the_page():
    """Return for each theme of the page the colours of the methods, and those of other roles."""
    page = (PACKAGE / 'report' / 'page.js').read_text()
    palettes = {}
    for theme, colours in re.findall(r'^ +(light|dark): \{(.*)\},$', page, re.MULTILINE):
        (of_methods,) = re.findall(r'methods: \[(.*?)\]', colours)
        palettes[f'{theme} in report/page.js'] = (
            re.findall(r'#\w{6}', of_methods),
            dict(re.findall(r"(\w+): '(#\w{6})'", colours)),
        )
    return palettes


def test_each_method_has_a_colour_of_its_own():
    palettes = palettes_of_the_page()
    assert len(palettes) == 2
    palettes['report/pictures.py'] = pictures.METHOD_COLOURS, pictures._COLOURS
    for where, (of_methods, others) in palettes.items():
        # One more than there are methods: it is for the next one.
        assert len(set(of_methods)) > len(METHOD_NAMES), f'add a colour for a method: {where}'
        # What is drawn in one panel with several methods.
        beside = [others[role] for role in ('raw', 'recorded', 'outlier')]
        drawn = [*of_methods, *beside]
        twice = sorted({colour for colour in drawn if drawn.count(colour) > 1})
        assert not twice, f'{twice} stands for two things, choose another one for a method: {where}'
