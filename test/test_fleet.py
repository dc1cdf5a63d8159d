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

"""Fleets: bags found, streamed, measured once by their content; the table; who gets worse."""

import hashlib
import json
import math
import random as random_numbers
import re
import shutil
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import chain, repeat

import fsspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from distributed import Client

from gyro_drift_filter.cli.fleet import tell_what_is_gone
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import GyroDriftFilterError, Parameters
from gyro_drift_filter.fleet.bag_report import report_path
from gyro_drift_filter.fleet.changes import Found, Series, Usual, find_change
from gyro_drift_filter.fleet.columns import COLUMNS, schema
from gyro_drift_filter.fleet.health import judge_fleet
from gyro_drift_filter.fleet.measuring import Job, content_of, measure, written_path
from gyro_drift_filter.fleet.results import Results
from gyro_drift_filter.fleet.run import FleetRun
from gyro_drift_filter.fleet.sources import find_bags, shown
from gyro_drift_filter.fleet.streamed import BLOCK, Content, StreamedPath
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import imu_messages
from gyro_drift_filter.simulation.sensor import START
from harness.fleet_recordings import Fault, FleetSettings, robot_name, write_fleet
from support.bags import read, simulated, write, write_imus
from support.fleets import SECRET, cluster, run_fleet
from support.messages import even_stamps
from support.sensor import at_rest

JOB = Job(Parameters())


@pytest.fixture(scope='module')
def small(tmp_path_factory):
    """Path of a fleet of two robots with four bags each, of which one is broken."""
    folder = tmp_path_factory.mktemp('fleet') / 'robots'
    write_fleet(folder, FleetSettings(2, 4, 12.0, faults={}, broken_every=7))
    return folder


@pytest.fixture(scope='module')
def client():
    with cluster() as found:
        yield found


@pytest.fixture(scope='module')
def measured(small, client, tmp_path_factory):
    """Path of what was made of the small fleet."""
    out = tmp_path_factory.mktemp('out') / 'out'
    run_fleet(client, small, out)
    return out


@pytest.mark.slow
def test_the_figures_are_those_of_replay_and_doctor(small, tmp_path):
    bag = small / 'robot_00' / 'day_01'
    (found,) = find_bags([str(bag)], None)
    rows = measure(found, Job(Parameters(), bags=tmp_path / 'bags')).rows
    main(['replay', str(bag), '-o', str(tmp_path / 'out'), '--json', str(tmp_path / 'v.json')])
    main(['doctor', str(bag), '--json', str(tmp_path / 'd.json')])
    (verdict,) = json.loads((tmp_path / 'v.json').read_text())['verdicts']
    findings = json.loads((tmp_path / 'd.json').read_text())['findings']
    assert [row['axis'] for row in rows] == ['x', 'y', 'z']
    for axis, row in enumerate(rows):
        assert row['noise'] == verdict['rests']['raw_deviation'][axis]
        assert row['bias'] == verdict['bias']['rates'][axis]
        assert row['drift_before'] == verdict['heading']['raw']
        assert row['outcome'] == verdict['outcome']
        assert row['faults'] == sorted(f['name'] for f in findings if f['verdict'] == 'fault')
        assert row['robot' if 'robot' in row else 'topic'] == '/imu/data_raw'
    written = written_path(tmp_path / 'bags', found)
    assert written == tmp_path / 'bags' / 'day_01'
    ours, theirs = (
        (folder / f'{folder.name}.mcap').read_bytes() for folder in (written, tmp_path / 'out')
    )
    # The name of the file stands in the metadata at its end, and nothing else differs.
    common = next(k for k, (a, b) in enumerate(zip(ours, theirs, strict=False)) if a != b)
    assert common > 0.9 * len(theirs)


def test_the_report_on_a_bag_is_there_whole_or_not_at_all(small, tmp_path):
    (bag,) = find_bags([str(small / 'robot_00' / 'day_01')], None)
    reports = tmp_path / 'reports'
    result = measure(bag, Job(Parameters(), reports=reports))
    (page,) = reports.iterdir()
    assert page == report_path(reports, result.content)
    text = page.read_text()
    assert 'robot_00, day_01' in text
    assert text.rstrip().endswith('</html>')
    page.rename(tmp_path / 'page')
    page.mkdir()
    result = measure(bag, Job(Parameters(), reports=reports))
    assert 'can not be written' in result.rows[0]['error']
    assert not result.lasting
    assert list(reports.iterdir()) == [page]


@pytest.mark.slow
def test_raw_and_fused_imu_beside_each_other_are_both_measured(tmp_path):
    """The pair of REP-145, whose filtered topics would have one name."""
    imu = simulated(300)
    topics = [('/imu/data_raw', IMU_TYPE), ('/imu/data', IMU_TYPE)]
    write(tmp_path / 'in', dict.fromkeys(topics, imu))
    (bag,) = find_bags([str(tmp_path / 'in')], None)
    rows = measure(bag, Job(Parameters(), bags=tmp_path / 'bags')).rows
    expected = [(topic, axis) for topic in ('/imu/data', '/imu/data_raw') for axis in 'xyz']
    assert [(row['topic'], row['axis']) for row in rows] == expected
    written = written_path(tmp_path / 'bags', bag)
    outputs = {'/imu/data_filtered', '/imu/data_raw_filtered'}
    assert outputs < set(read(written)[0])
    # What was written is not filtered once more.
    (again,) = find_bags([str(written)], None)
    assert {row['topic'] for row in measure(again, JOB).rows} == {'/imu/data', '/imu/data_raw'}


@pytest.mark.slow
def test_noise_is_measured_where_stamps_are_zero_and_a_rate_is_given(tmp_path, random):
    rates, accelerations = at_rest(random, 60)
    messages = imu_messages(np.zeros(len(rates), np.int64), rates, accelerations)
    log_times = START + 10**7 * np.arange(len(rates))
    rows = [(int(time), data) for time, (_, data) in zip(log_times, messages, strict=True)]
    write(tmp_path / 'in', {('/imu/data_raw', IMU_TYPE): rows})
    (bag,) = find_bags([str(tmp_path / 'in')], None)
    of_log = measure(bag, JOB).rows
    of_rate = measure(bag, Job(Parameters(sample_rate=100.0))).rows
    name = 'angle_random_walk'
    assert [row[name] for row in of_rate] == pytest.approx([row[name] for row in of_log])


@pytest.mark.slow
def test_each_column_says_what_it_is(measured):
    fields = pq.read_schema(measured / 'fleet.parquet')
    assert [field.name for field in fields] == [column.name for column in COLUMNS]
    assert all(field.metadata[b'description'] for field in fields)
    assert fields.field('noise').metadata[b'unit'] == b'rad/s'


@pytest.mark.slow
def test_a_broken_bag_is_a_row_with_its_error(measured):
    rows = pq.read_table(measured / 'fleet.parquet').to_pylist()
    failed = [row for row in rows if row['error']]
    assert [row['source'][-15:] for row in failed] == ['robot_00/day_00', 'robot_01/day_02']
    assert all(row['axis'] is None and row['content'] for row in failed)
    assert 'seems to be empty' in failed[0]['error']
    assert len(rows) == 2 + 3 * 6


@pytest.mark.slow
def test_the_same_input_gives_the_same_bytes(small, measured, client, tmp_path):
    run_fleet(client, small, tmp_path / 'again')
    again = tmp_path / 'again' / 'fleet.parquet'
    assert again.read_bytes() == (measured / 'fleet.parquet').read_bytes()


@pytest.mark.slow
def test_interrupted_at_random_and_resumed(small, measured, client, tmp_path):
    """What is kept when it ends is not measured again, and the table is the same."""
    random, out, before = random_numbers.Random(19), tmp_path / 'out', 0
    for _ in range(10):
        left = random.randrange(3)

        def progress(done, total, left=left, first=before):
            if done - first > left:
                raise KeyboardInterrupt

        try:
            run = run_fleet(client, small, out, progress)
            assert run.reused >= before
        except KeyboardInterrupt:
            pass
        kept = len(list((out / 'results').glob('*/*/*.json')))
        assert kept > before or kept == 8
        before = kept
    assert run.measured == 0
    assert (out / 'fleet.parquet').read_bytes() == (measured / 'fleet.parquet').read_bytes()


@pytest.mark.slow
def test_what_was_measured_is_known_by_its_content(small, measured, client, tmp_path):
    """Bags that were moved are known; one that has changed under its old name is not."""
    shutil.copytree(measured, tmp_path / 'out')
    moved = tmp_path / 'moved'
    shutil.copytree(small, moved)
    (moved / 'robot_00').rename(moved / 'other')
    run = run_fleet(client, moved, tmp_path / 'out')
    assert (run.reused, run.measured) == (8, 0)
    file = moved / 'robot_01' / 'day_00' / 'day_00.mcap'
    shutil.copy(moved / 'robot_01' / 'day_01' / 'day_01.mcap', file)
    run = run_fleet(client, moved, tmp_path / 'out')
    assert (run.reused, run.measured) == (7, 1)


@pytest.mark.slow
def test_what_is_not_kept_is_not_counted_as_kept(small, client, tmp_path):
    """An interrupted run told of bags that it had kept and measured them all again."""
    (tmp_path / 'file').touch()
    run = run_fleet(client, small, tmp_path / 'out', bags=tmp_path / 'file' / 'bags')
    assert run.measured == 8
    assert run.kept == len(list((tmp_path / 'out' / 'results').glob('*/*/*.json'))) < 8


@pytest.mark.slow
def test_an_interrupt_while_bags_are_hashed_does_not_tell_that_none_is_kept(
    small, measured, tmp_path, monkeypatch, capsys
):
    def interrupted(_):
        raise KeyboardInterrupt

    shutil.copytree(measured, tmp_path / 'out')
    monkeypatch.setattr(FleetRun, '_not_measured', interrupted)
    arguments = ['fleet', str(small), '-o', str(tmp_path / 'out'), '--workers', '1', '--resume']
    assert main(arguments) == 130
    assert 'interrupted; what earlier runs have measured is kept: go on' in capsys.readouterr().err


@pytest.fixture
def impatient(monkeypatch):
    monkeypatch.setattr('gyro_drift_filter.fleet.run._PATIENCE', 0.1)
    monkeypatch.setattr('gyro_drift_filter.fleet.run._LOOK', 0.01)


@pytest.mark.slow
@pytest.mark.usefixtures('impatient')
def test_a_cluster_whose_processes_have_died_is_not_waited_for(small, tmp_path):
    with (
        cluster(workers=0) as client,
        pytest.raises(GyroDriftFilterError, match=r'have died.* raise --memory-limit'),
    ):
        run_fleet(client, small, tmp_path / 'out')


@pytest.mark.slow
@pytest.mark.usefixtures('impatient')
def test_a_scheduler_without_workers_is_told_and_waited_for(small, tmp_path, caplog):
    with (
        cluster(workers=0) as owner,
        Client(owner.cluster.scheduler_address) as client,
        ThreadPoolExecutor() as pool,
    ):
        run = pool.submit(run_fleet, client, small, tmp_path / 'out')
        limit = time.monotonic() + 30.0
        while 'the scheduler has no worker: waiting for one' not in caplog.messages:
            assert time.monotonic() < limit
            time.sleep(0.02)
        owner.cluster.scale(1)
        assert run.result(60).measured == 8
    assert caplog.messages.count('the scheduler has no worker: waiting for one') == 1


def test_results_of_other_parameters_are_others(measured):
    other = Results(measured / 'results', Parameters(outlier_threshold=5.0))
    assert Results(measured / 'results', Parameters()).are_there()
    assert not other.are_there()


def test_a_bag_that_was_cut_off_has_figures_and_a_note(small, tmp_path):
    data = (small / 'robot_00' / 'day_01' / 'day_01.mcap').read_bytes()
    (tmp_path / 'cut.mcap').write_bytes(data[:-2000])
    (bag,) = find_bags([str(tmp_path / 'cut.mcap')], None)
    result = measure(bag, JOB)
    assert result.rows[0]['axis'] == 'x'
    assert result.rows[0]['notes'][0].startswith('the bag was cut off')
    assert result.content == hashlib.sha256(data[:-2000]).hexdigest()


def test_a_bag_without_messages_has_no_start(tmp_path):
    write(tmp_path / 'in', {('/imu/data_raw', IMU_TYPE): []})
    (bag,) = find_bags([str(tmp_path / 'in')], None)
    (row,) = measure(bag, JOB).rows
    assert 'has no message with an angular velocity' in row['error']
    assert (row['start'], row['duration'], row['messages']) == (None, None, 0)


class Counted:
    """A store that counts what is read of a file, and may fail."""

    def __init__(self, data, fails_from=math.inf):
        self.data, self.fails_from, self.blocks = data, fails_from, []

    def open(self, path, mode, **options):
        data, counted = self.data, self

        class File(fsspec.spec.AbstractBufferedFile):  # type: ignore[misc]
            def _fetch_range(self, start, end):
                if end > counted.fails_from:
                    raise TimeoutError('the store is gone')
                counted.blocks.append(start)
                return data[start:end]

        return File(self, path, mode, size=len(data), **options)


def test_a_bag_is_streamed_once_and_hashed_on_the_way(small, monkeypatch):
    """Each block is asked for once, and few are in memory."""
    data = (small / 'robot_00' / 'day_01' / 'day_01.mcap').read_bytes()
    (bag,) = find_bags([str(small / 'robot_00' / 'day_01' / 'day_01.mcap')], None)
    monkeypatch.setattr('gyro_drift_filter.fleet.streamed.BLOCK', 2**14)
    store = Counted(data)
    monkeypatch.setattr('gyro_drift_filter.fleet.sources._store', lambda address: (store, 'x'))
    result = measure(bag, JOB)
    assert result.content == hashlib.sha256(data).hexdigest() == content_of(bag)
    once = store.blocks[: len(store.blocks) // 2]
    assert len(data) > 5 * 2**14
    assert sorted(set(once)) == list(range(0, len(data), 2**14))
    assert len(once) <= len(set(once)) + 2  # the first and the last, for the index


def test_a_store_that_fails_is_asked_again_the_next_time(small, monkeypatch):
    path = small / 'robot_00' / 'day_01' / 'day_01.mcap'
    data = path.read_bytes()
    (bag,) = find_bags([str(path)], None)
    store = Counted(data, fails_from=len(data) // 2)
    monkeypatch.setattr('gyro_drift_filter.fleet.streamed.BLOCK', 2**14)
    monkeypatch.setattr('gyro_drift_filter.fleet.sources._store', lambda address: (store, 'x'))
    result = measure(bag, JOB)
    assert not result.lasting
    assert 'the store is gone' in result.rows[0]['error']


def test_a_disk_that_is_full_is_asked_again_the_next_time(small, tmp_path):
    (bag,) = find_bags([str(small / 'robot_00' / 'day_01')], None)
    (tmp_path / 'file').touch()
    taken = tmp_path / 'bags'
    (written_path(taken, bag) / 'other').mkdir(parents=True)
    for folder, why in ((tmp_path / 'file' / 'bags', 'can not be written'), (taken, 'replaced')):
        result = measure(bag, Job(Parameters(), bags=folder))
        assert why in result.rows[0]['error']
        assert not result.lasting


def test_a_streamed_path_is_one_to_all_who_read_it():
    files = fsspec.filesystem('memory')
    files.pipe('/here/a.mcap', b'0123456789')
    content = Content(files, '/here/a.mcap', 10)
    path = StreamedPath({'a.mcap': content}, '', '')
    assert path.is_dir()
    assert path.exists()
    assert not (path / 'b.mcap').exists()
    assert [str(p) for p in path.glob('*.mcap')] == ['the bag/a.mcap']
    with (path / 'a.mcap').open('rb') as file:
        file.seek(-3, 2)
        assert file.read() == b'789'
        assert file.tell() == 10
        file.seek(1)
        buffer = bytearray(4)
        assert file.readinto(buffer) == 4  # type: ignore[attr-defined]
        assert buffer == b'1234'
        with pytest.raises(OSError, match='no place'):
            file.seek(-1)
    assert content.digest() == hashlib.sha256(b'0123456789').hexdigest()
    with pytest.raises(FileNotFoundError):
        (path / 'b.mcap').open('rb')
    assert BLOCK > 2**20


@pytest.mark.parametrize(
    ('text', 'left'),
    [
        (f'sftp://joe:{SECRET}@host/a.mcap', 'sftp://host/a.mcap'),
        (f'at https://b.example/a.mcap?X-Sig={SECRET}&b=1: denied', 'at https://b.example/a.mcap'),
        (f"'s3://{SECRET}@bucket/a' is missing", "'s3://bucket/a' is missing"),
        (f'a\nb https://{SECRET}:x@c/d#{SECRET}', 'a b https://c/d'),
        ('what is wrong? nothing', 'what is wrong? nothing'),
    ],
)
def test_no_credential_is_shown(text, left):
    assert shown(text).startswith(left)
    assert SECRET not in shown(text)


def test_bags_are_found_and_have_a_robot(small, tmp_path):
    bags = find_bags([str(small)], None)
    assert [bag.below for bag in bags][:2] == ['robot_00/day_00', 'robot_00/day_01']
    assert {bag.robot for bag in bags} == {'robot_00', 'robot_01'}
    assert len(find_bags([f'{small}/robot_*', str(small), f'file://{small}'], None)) == 16
    # A name may have what else makes a pattern.
    shutil.copytree(small / 'robot_00', tmp_path / 'more' / 'r[1]')
    named = find_bags([str(tmp_path / 'more' / 'r[1]')], None)
    assert [(bag.robot, bag.below) for bag in named[:1]] == [('r[1]', 'day_00')]
    shutil.rmtree(tmp_path / 'more')
    only = find_bags([f'{small}/*1'], r'/(robot_\d)')
    assert {bag.robot for bag in only} == {'robot_0'}
    assert only[0].below == 'robot_01/day_00'
    for source, pattern, why in (
        (str(tmp_path), None, 'no bag under'),
        (str(tmp_path / 'nowhere'), None, 'no bag under'),
        (str(small), '(', 'no regular expression'),
        (str(small), 'robot', 'no group'),
        (str(small), '(nobody)', r'^--robot \(nobody\) finds no name in '),
        ('nosuchstore://x', None, 'can not be opened'),
    ):
        with pytest.raises(GyroDriftFilterError, match=why):
            find_bags([source], pattern)


def test_links_to_folders_are_followed_and_no_bag_is_found_twice(small, tmp_path):
    """A folder of links to bags on other disks held no bag, and of a mixed one a part was lost."""
    robots = tmp_path / 'robots'
    robots.mkdir()
    (robots / 'robot_00').symlink_to(small / 'robot_00')
    (robots / 'robot_01').mkdir()
    for bag in sorted((small / 'robot_01').iterdir()):
        (robots / 'robot_01' / bag.name).symlink_to(bag)
    (robots / 'robot_01' / 'latest').symlink_to('day_01')
    (robots / 'up').symlink_to('..')
    linked, direct = (find_bags([str(source)], None) for source in (robots, small))
    assert [(bag.below, bag.robot, bag.sizes) for bag in linked] == [
        (bag.below, bag.robot, bag.sizes) for bag in direct
    ]


def test_what_is_written_is_not_found(small, tmp_path):
    """With --resume the filtered bags in OUT counted as bags of the robots beside them."""
    shutil.copytree(small, tmp_path / 'robots')
    shutil.copytree(small, tmp_path / 'out' / 'bags' / 'robots')
    sources = [str(tmp_path), f'{tmp_path}/*', f'file://{tmp_path}']
    assert len(find_bags(sources[:1], None)) == 16
    for source in sources:
        assert len(find_bags([source], None, tmp_path / 'out' / 'bags')) == 8


def test_wrong_options_are_told_in_one_line(small, measured, tmp_path, capsys):
    out = str(tmp_path / 'out')
    for options, why in (
        (['-o', str(measured)], 'go on with --resume'),
        (['-o', out, '--workers', '0'], 'at least 1'),
        (['-o', out, '--memory-limit', '0'], 'above 0'),
        (['-o', out, '--memory-limit', 'inf'], 'at most 1e+06 (GB), not inf'),
        (['-o', '/proc/out'], '/proc can not be written'),
    ):
        assert main(['fleet', str(small), *options]) == 1
        told = capsys.readouterr().err
        assert why in told
        assert told.count('\n') == 1
    both = [str(small / name) for name in ('robot_00', 'robot_01')]
    assert main(['fleet', *both, '-o', out, '--write']) == 1
    assert 'would both be written to' in capsys.readouterr().err


def test_nothing_is_left_where_no_scheduler_answers(small, tmp_path, monkeypatch, capsys):
    """The folder that was left made the next run say that it exists already."""

    def silent(*_, **__):
        raise OSError('timed out')

    monkeypatch.setattr('gyro_drift_filter.fleet.cluster.Client', silent)
    out = tmp_path / 'out'
    arguments = ['fleet', str(small), '-o', str(out), '--scheduler', 'tcp://127.0.0.1:1']
    assert main(arguments) == 1
    assert 'no Dask scheduler answers' in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.slow
def test_noise_is_there_for_rests_beyond_the_largest_bias_and_one_bag_is_one(
    tmp_path, random, capsys
):
    rates, accelerations = at_rest(random, 40, (0.0, 0.0, 0.3))
    source = write_imus(tmp_path / 'in', even_stamps(len(rates)), rates, accelerations)
    out = tmp_path / 'out'
    assert main(['fleet', str(source), '-o', str(out), '--workers', '1']) == 0
    assert capsys.readouterr().out.startswith('1 bag\n')
    rows = pq.read_table(out / 'fleet.parquet').to_pylist()
    assert [row['rest'] for row in rows] == [0.0, 0.0, 0.0]
    assert all(row['angle_random_walk'] > 0.0 for row in rows)


def test_bags_that_a_new_table_leaves_out_are_told(small, measured, capsys):
    tell_what_is_gone(measured / 'fleet.parquet', find_bags([str(small)], None))
    assert capsys.readouterr().err == ''
    tell_what_is_gone(measured / 'fleet.parquet', find_bags([str(small / 'robot_01')], None))
    told = capsys.readouterr().err
    assert told.startswith('note: of the table before, 4 bags will be left out, as not named now: ')
    assert 'robot_00' in told
    assert told.endswith(' and others\n')


def test_a_folder_without_a_table_is_told(tmp_path, capsys):
    assert main(['fleet-report', str(tmp_path), '-o', str(tmp_path / 'page.html')]) == 1
    told = capsys.readouterr().err
    assert 'fleet.parquet can not be read, as it is missing: name the folder that `gyro_dr' in told


def steps(random, *means):
    return np.concatenate([m + random.standard_normal(6) for m in means])


def fleet_of(random, *shape):
    """Return what is usual among robots whose values are white noise of deviation 1."""
    return Usual([Series(str(k), v, 0.0) for k, v in enumerate(random.standard_normal(shape))])


def change_of(usual, values, both_ways=False):
    return find_change(Series('the one', values, 0.1), usual, 2000, both_ways=both_ways)


def test_a_change_is_found_where_it_is_and_its_size_is_known(random):
    usual = fleet_of(random, 40, 12)
    found = change_of(usual, steps(random, 0.0, 20.0))
    assert found.certain
    assert found.since == 6
    assert 12.0 < found.size < 30.0
    assert change_of(usual, steps(random, 20.0, 0.0)) is None  # it got better
    assert change_of(usual, steps(random, 20.0, 0.0), both_ways=True).certain
    assert change_of(usual, np.arange(3.0)) is None


@pytest.mark.parametrize('both_ways', [False, True])
def test_what_was_repaired_is_no_finding(random, both_ways):
    usual = fleet_of(random, 40, 18)
    found = change_of(usual, steps(random, 0.0, 30.0, 0.0), both_ways)
    assert found is None or not found.certain


def test_one_odd_bag_of_the_last_two_is_no_change(random):
    usual = fleet_of(random, 40, 12)
    values = steps(random, 0.0, 0.0)
    values[-1] += 30.0
    assert not change_of(usual, values).certain
    values[-2] += 30.0
    assert change_of(usual, values).certain


def judged_fleets(draw, fleets=10):
    """Return in how many fleets of sixty series chance makes a finding."""
    named = 0
    for _ in range(fleets):
        fleet = [Series(str(k // 3), values, 0.1) for k, values in enumerate(draw())]
        usual, tests = Usual(fleet), sum(len(series.values) for series in fleet)
        found = [find_change(series, usual, tests, both_ways=True) for series in fleet]
        named += any(change and change.certain for change in found)
    return named


@pytest.mark.slow
def test_chance_makes_no_finding(random):
    assert judged_fleets(lambda: random.standard_normal((60, 10)), fleets=30) == 0


@pytest.mark.slow
def test_days_that_are_like_the_one_before_are_no_finding(random):
    """What each sensor does, as with the weather, is nothing that one of them has."""

    def wander():
        values = random.standard_normal((60, 24))
        for day in range(1, 24):
            values[:, day] = 0.9 * values[:, day - 1] + math.sqrt(0.19) * values[:, day]
        return values

    assert judged_fleets(wander) == 0


@pytest.mark.slow
def test_odd_days_are_no_finding(random):
    """Student's t of three degrees of freedom has some of ten deviations."""
    assert judged_fleets(lambda: random.standard_t(3.0, (60, 8)), fleets=20) == 0


@pytest.mark.slow
def test_a_few_sensors_of_a_worse_kind_are_no_finding(random):
    """Short histories of their own do not tell it, but the fleet does."""
    kinds = np.where(np.arange(60) % 15 < 3, 10.0, 1.0)[:, None]
    assert judged_fleets(lambda: kinds * random.standard_normal((60, 6)), fleets=20) == 0


def rows_of_fleet(random, robots=5):
    """Return the rows of a fleet that does well."""
    return [
        {
            'robot': f'{robot}', 'source': f'{robot}/{day:02}', 'content': f'{robot}/{day}',
            'topic': '/imu', 'frame_id': 'imu', 'axis': axis,
            'start': START + day * 10**14, 'duration': 60.0,
            'messages': 6000, 'gaps': 0, 'noise': 2e-3 * math.exp(0.02 * random.standard_normal()),
            'noise_samples': 3000, 'bias': 1e-3 * random.standard_normal(),
            'bias_deviation': 1e-4, 'outlier_share': 0.0,
        }
        for robot in range(robots) for day in range(10) for axis in 'xyz'
    ]  # fmt: skip


def judged(rows):
    return judge_fleet(pa.Table.from_pylist(rows, schema()))


def test_a_frozen_axis_is_found_though_it_has_no_noise_to_be_compared(random):
    rows = rows_of_fleet(random)
    for row in rows:
        if (row['robot'], row['axis']) == ('3', 'y') and row['start'] >= START + 8 * 10**14:
            row['noise'] = 0.0
    first, second, *_ = judged(rows)
    assert (first.robot, second.size) == ('3', 0.0)
    (change,) = (change for change in first.changes if change.certain)
    assert (change.quantity, change.axis, change.after) == ('frozen', 'y', 100.0)


def test_a_change_that_is_certain_stands_before_a_larger_one_that_is_not(random, monkeypatch):
    of_axes = [Found(5, 0.0, 1.0, 9.0, certain=False), Found(5, 0.0, 1.0, 4.0, certain=True)]
    told = chain(of_axes, repeat(None))
    monkeypatch.setattr('gyro_drift_filter.fleet.health.find_change', lambda *_, **__: next(told))
    (sensor,) = judged(rows_of_fleet(random, robots=1))
    (change,) = sensor.changes
    assert (change.quantity, change.axis, sensor.size) == ('noise', 'y', 4.0)


def rows_with_an_odd_end(random, last=1):
    """Return the rows of a fleet of which one robot has more noise in its last bags."""
    rows = rows_of_fleet(random)
    for row in rows:
        if row['robot'] == '3' and row['source'] >= f'3/{10 - last:02}':
            row['noise'] *= 3.0
    return rows


@pytest.mark.parametrize('content', ['3/9', 'of its replay', None])
def test_a_copy_of_a_bag_is_not_counted(random, content):
    """What only the last bag shows was reported where there was a copy of that bag."""
    rows = rows_with_an_odd_end(random)
    copies = [
        row | {'source': f'3/09 {k}', 'content': content}
        for row in rows
        for k in range(2)
        if row['source'] == '3/09'
    ]
    sensors = judged(rows + copies)
    assert not any(sensor.size for sensor in sensors)
    (noted,) = (sensor for sensor in sensors if sensor.notes)
    assert noted.notes == ['3/09 0 is not counted, as it is a copy of 3/09; nor is 1 more']
    assert len(noted.bags) == 10
    # Two bags that show it are none of one another.
    assert [s.robot for s in judged(rows_with_an_odd_end(random, last=2)) if s.size] == ['3']


@pytest.mark.slow
@pytest.mark.parametrize('content', ['0/9', 'of its replay'])
def test_a_bag_that_two_robots_have_is_told(random, content):
    """It counts for both, as nothing tells whose it is: a partial backup must take no history."""
    rows = rows_of_fleet(random)
    copy = [
        row | {'robot': '00', 'source': '00/09', 'content': content}
        for row in rows
        if row['source'] == '0/09'
    ]
    found = {sensor.robot: sensor for sensor in judged(rows + copy)}
    assert {robot: len(sensor.bags) for robot, sensor in found.items()} == {
        '00': 1, '0': 10, '1': 10, '2': 10, '3': 10, '4': 10
    }  # fmt: skip
    what = 'leave out what is no folder of one robot, as a backup'
    assert found['00'].notes == [f'00/09 is a bag of robot 0 as well: {what}']
    assert found['0'].notes == [f'0/09 is a bag of robot 00 as well: {what}']
    assert not found['1'].notes
    backup = [
        row | {'robot': 'all', 'source': f'all/{row["source"]}'}
        for row in rows
        if row['source'][0] in '01'
    ]
    rows = [row for row in rows if row['source'] != '1/00']
    found = {sensor.robot: sensor for sensor in judged(rows + backup)}
    assert {robot: len(sensor.bags) for robot, sensor in found.items()} == {
        'all': 20, '0': 10, '1': 9, '2': 10, '3': 10, '4': 10
    }  # fmt: skip
    assert found['0'].notes == [f'0/00 is a bag of robot all as well, and so are 9 more: {what}']


def test_bags_of_a_clock_that_was_not_set_have_no_place_in_time(random):
    """They came first, and a sensor that fails seemed to be repaired."""
    rows = rows_with_an_odd_end(random, last=5)
    assert [sensor.robot for sensor in judged(rows) if sensor.size] == ['3']
    for row in rows:
        if row['robot'] == '3' and row['source'] >= '3/07':
            row['start'] -= START
    first, *others = judged(rows)
    assert (first.robot, len(first.bags)) == ('3', 7)
    assert first.size
    (note,) = first.notes
    assert note == (
        '3/07 is not counted, as its log times are in 1970: the clock of the recorder was not '
        'set; nor are 2 more'
    )
    assert not any(sensor.notes for sensor in others)
    for row in rows:
        row['start'] %= START
    assert not any(sensor.bags or sensor.is_judged for sensor in judged(rows))


@pytest.mark.parametrize(('seconds', 'overlap'), [(30, True), (59.5, False)])
def test_bags_of_the_same_time_are_told_as_of_two_robots(random, seconds, overlap):
    """The name of a folder may be that of a day or a site, and two robots were made one."""
    rows = rows_of_fleet(random)
    other = [
        row | {'source': 'other', 'content': 'other', 'start': row['start'] + int(seconds * 1e9)}
        for row in rows_of_fleet(random)
        if row['source'] == '3/04'
    ]
    notes = [note for sensor in judged(rows + other) for note in sensor.notes]
    expected = '3/04 and other were recorded at the same time, which one sensor can not do: if '
    assert [note.startswith(expected) for note in notes] == [True] * overlap


@pytest.mark.slow
def test_planted_faults_come_first_and_nobody_else_is_named(tmp_path, capsys):
    """Through the command with its own processes, killed once and resumed."""
    faults = {0: Fault.BIAS, 2: Fault.NOISE, 3: Fault.OUTLIERS}
    broken = write_fleet(
        tmp_path / 'robots', FleetSettings(4, 9, 20.0, faults=faults, broken_every=9)
    )
    out = tmp_path / 'out'
    arguments = ['fleet', str(tmp_path / 'robots'), '-o', str(out), '--workers', '2']
    command = [sys.executable, '-m', 'gyro_drift_filter.cli.main', *arguments, '--quiet']
    process = subprocess.Popen(command)
    limit = time.monotonic() + 120.0
    while len(list(out.glob('results/*/*/*.json'))) < 5:
        assert process.poll() is None
        assert time.monotonic() < limit
        time.sleep(0.02)
    process.kill()
    process.wait()
    assert not (out / 'fleet.parquet').exists()
    assert main([*arguments, '--resume']) == 0
    told = capsys.readouterr()
    known = re.search(r'36 bags, (\d+) of them known from before', told.out)
    assert known
    assert int(known[1]) >= 5
    assert 'INFO' not in told.err
    table = pq.read_table(out / 'fleet.parquet')
    sensors = judge_fleet(table)
    worse = {sensor.robot: sensor.changes[0].quantity for sensor in sensors if sensor.size}
    assert worse == {robot_name(0): 'bias', robot_name(2): 'noise', robot_name(3): 'outliers'}
    failed = {row['source'] for row in table.to_pylist() if row['error']}
    assert failed == {str(bag) for bag in broken}
