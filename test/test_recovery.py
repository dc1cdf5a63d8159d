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

"""Bags that were cut off in mid-write, at any byte, and bags that are replaced."""

import struct
import tempfile
from pathlib import Path

import pytest
from mcap.writer import CompressionType

from gyro_drift_filter.bags.opening import open_bag
from gyro_drift_filter.bags.recording import BagError, messages
from gyro_drift_filter.bags.replay import replay
from gyro_drift_filter.bags.selection import Selection
from gyro_drift_filter.cli.main import main
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.mcap.reader import read_layout
from gyro_drift_filter.mcap.records import CHUNK, CHUNK_HEAD, FOOTER_FIELDS, MAGIC, MESSAGE, PREFIX
from gyro_drift_filter.mcap.recovery import has_damaged_summary, is_cut_off, recover
from gyro_drift_filter.messages.imu import IMU_TYPE
from gyro_drift_filter.simulation.bag import TOPIC, imu_message
from support.bags import mixed, read, simulated_folder, with_damage, write_mcap
from support.messages import START, TEXT, text

FORMS: dict[str, dict[str, object]] = {
    'plain': {'compression': CompressionType.NONE},
    'zstd': {'compression': CompressionType.ZSTD, 'chunk_size': 30_000},
    'lz4': {'compression': CompressionType.LZ4, 'chunk_size': 10_000},
    'flat': {'use_chunking': False},
}


def found(path):
    """Return (topic, log time, data) of all messages of a bag."""
    with open_bag(path) as reader:
        return [(c.topic, time, data) for c, time, data in messages(reader)]


@pytest.mark.slow
@pytest.mark.parametrize('form', FORMS)
def test_all_whole_messages_are_read(form, tmp_path, random, caplog):
    rows = [
        (topic, kind, time + k, data) for k, (topic, kind, time, data) in enumerate(mixed(random))
    ]
    wanted = [(topic, time, data) for topic, _, time, data in rows]
    path = write_mcap(tmp_path / 'in.mcap', rows, **FORMS[form])
    whole = path.read_bytes()
    assert found(path) == wanted
    assert caplog.records == []
    counts = []
    for cut in [len(whole) - 1, *sorted(random.integers(5_000, len(whole), 12).tolist())]:
        path.write_bytes(whole[:cut])
        copy = tmp_path / 'copy.mcap'
        got = found(path) if recover(path, copy) else []
        copy.unlink()
        assert got == wanted[: len(got)]
        counts.append(len(got))
        if form in ('plain', 'flat') and got:
            # The next message was not whole: its bytes are not in the file.
            following = wanted[len(got)][2] if len(got) < len(wanted) else b''
            assert not following or len(following) < 300 or following not in whole[:cut]
    assert counts[0] == len(rows)
    assert counts[1:] == sorted(counts[1:])
    assert counts[-1] > 0.5 * len(rows)
    assert 'was cut off, as when the recorder is killed: read to its last whole' in caplog.text


def test_the_last_message_of_an_open_chunk(tmp_path):
    """Message by message: cut within one, those before are all there."""
    rows = [
        (TOPIC, IMU_TYPE, START + k, imu_message(START + k, (0.001 * k, 0, 0), (0, 0, 9.8)))
        for k in range(20)
    ]
    for form in ('plain', 'flat'):
        path = write_mcap(tmp_path / f'{form}.mcap', rows, **FORMS[form])
        whole = path.read_bytes()
        for k, (_, _, _, data) in enumerate(rows):
            end = whole.index(data) + len(data)
            for cut, count in ((end, k + 1), (end - 1, k)):
                path.write_bytes(whole[:cut])
                copy = tmp_path / 'copy.mcap'
                assert recover(path, copy) == count
                assert read_layout(copy) is not None or count == 0
                copy.unlink()


@pytest.mark.slow
@pytest.mark.parametrize('form', ['plain', 'zstd', 'lz4'])
def test_a_cut_in_the_head_of_a_chunk(form, tmp_path, random):
    """Whatever is there of its fields, all chunks before are read."""
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **FORMS[form] | {'chunk_size': 30_000})
    whole = path.read_bytes()
    first, *_, last = read_layout(path).chunks()
    copy = tmp_path / 'copy.mcap'
    counts = []
    for cut in range(last.start, last.start + 80):
        path.write_bytes(whole[:cut])
        counts.append(recover(path, copy))
        copy.unlink()
    assert counts == sorted(counts)
    assert counts[0] > 100
    # The length is there, what was written is not.
    path.write_bytes(whole[: last.start + 100] + bytes(last.length))
    assert recover(path, copy) >= counts[0]
    copy.unlink()
    for cut in range(first.start, first.start + 60):
        path.write_bytes(whole[:cut])
        assert recover(path, copy) == 0
        copy.unlink()


def test_what_a_power_cut_leaves_behind_the_last_chunk_costs_no_message(tmp_path, random):
    """Disks keep the length of a file, and what is there of it may be anything."""
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), chunk_size=30_000)
    whole = path.read_bytes()
    *_, last = read_layout(path).chunks()
    copy = tmp_path / 'copy.mcap'
    path.write_bytes(whole[: last.start])
    count = recover(path, copy)
    assert count > 100
    copy.unlink()
    short = PREFIX.pack(MESSAGE, 4) + bytes(4)
    head = CHUNK_HEAD.pack(0, 0, len(short), 0, 0) + struct.pack('<Q', len(short))
    chunk = PREFIX.pack(CHUNK, len(head + short)) + head + short
    wild = PREFIX.pack(CHUNK, 2**64 - 1) + random.bytes(4000)
    for tail in (b'', bytes(5000), random.bytes(5000), wild, short, chunk):
        path.write_bytes(whole[: last.start] + tail)
        assert recover(path, copy) == count
        copy.unlink()


def test_a_folder_with_a_file_that_was_cut_off(tmp_path, random):
    source = write_mcap(tmp_path / 'in.mcap', mixed(random))
    folder = tmp_path / 'folder'
    replay(source, folder, parameters=Parameters())
    file = folder / 'folder.mcap'
    file.write_bytes(file.read_bytes()[:-500])
    with pytest.raises(BagError, match=r'folder\.mcap was cut off: name that file'):
        found(folder)
    assert found(file)


@pytest.mark.slow
def test_what_to_do_about_the_other_files_of_a_folder(tmp_path, random, caplog):
    folder = tmp_path / 'folder'
    replay(write_mcap(tmp_path / 'in.mcap', mixed(random)), folder, parameters=Parameters())
    wanted, file = found(folder), folder / 'folder.mcap'
    (folder / 'more.mcap').write_bytes(file.read_bytes())
    assert found(folder) == wanted
    assert 'left out, as metadata.yaml does not list it: more.mcap; `ros2 bag rei' in caplog.text
    for content in (file.read_bytes()[:-500], b'', None):
        file.unlink()
        if content is not None:
            file.write_bytes(content)
        with pytest.raises(BagError, match=r'name them one by one, or .* `ros2 bag reindex`'):
            found(folder)
        file.touch()


@pytest.mark.parametrize('checksum', [True, False])
def test_a_damaged_summary_costs_no_message(checksum, tmp_path, random, caplog):
    """Whatever is damaged in it: the file is read from its beginning, and that is told."""
    rows = [
        (topic, kind, time + k, data) for k, (topic, kind, time, data) in enumerate(mixed(random))
    ]
    path = write_mcap(tmp_path / 'in.mcap', rows, **FORMS['zstd'], enable_crcs=checksum)
    whole = path.read_bytes()
    footer = len(whole) - len(MAGIC) - FOOTER_FIELDS.size - PREFIX.size
    (summary,) = struct.unpack_from('<Q', whole, footer + PREFIX.size)
    assert not has_damaged_summary(path)
    places = [footer, footer + 3, footer + PREFIX.size + 6]
    if checksum:
        places += [len(whole) - len(MAGIC) - 1, *range(summary, footer, 97)]
    wanted = [(topic, time, data) for topic, _, time, data in rows]
    for place in places:
        path.write_bytes(with_damage(whole, place))
        assert has_damaged_summary(path)
        caplog.clear()
        assert found(path) == wanted
        assert 'damaged summary at its end: read to its last whole message (705)' in caplog.text


def test_a_folder_with_a_file_whose_summary_is_damaged(tmp_path, random):
    """An index that lies may hide a chunk, which nobody would notice."""
    folder = tmp_path / 'folder'
    replay(write_mcap(tmp_path / 'in.mcap', mixed(random)), folder, parameters=Parameters())
    file = folder / 'folder.mcap'
    whole = file.read_bytes()
    assert found(folder)
    file.write_bytes(with_damage(whole, len(whole) - len(MAGIC) - 1))
    with pytest.raises(BagError, match=r'folder\.mcap has a damaged summary.*: name that file'):
        found(folder)
    assert found(file)


def test_a_summary_and_a_chunk_that_are_damaged(tmp_path, random, caplog):
    """What lies before the chunk is read, and how much is not read is told."""
    form = FORMS['plain'] | {'chunk_size': 30_000}
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **form)
    whole = path.read_bytes()
    wanted = found(path)
    chunk = list(read_layout(path).chunks())[2]
    damaged = with_damage(whole, len(whole) - len(MAGIC) - 1)
    path.write_bytes(with_damage(damaged, chunk.start + chunk.length // 2))
    got = found(path)
    assert got == wanted[: len(got)]
    assert 100 < len(got) < len(wanted)
    behind = len(whole) - chunk.start - chunk.length
    assert f'chunk is wrong: this and the {behind} bytes behind it are not read' in caplog.text


@pytest.mark.slow
def test_all_commands_read_a_file_with_a_damaged_summary(tmp_path, capsys):
    folder = simulated_folder(tmp_path)
    for name in ('motionless', 'turns'):
        file = folder / name / f'{name}.mcap'
        whole = file.read_bytes()
        file.write_bytes(with_damage(whole, len(whole) - len(MAGIC) - 1))
    motionless, turns = (str(folder / name / f'{name}.mcap') for name in ('motionless', 'turns'))
    for arguments in (
        ['doctor', motionless],
        ['explain', motionless],
        ['identify', motionless, '-o', str(tmp_path / 'identified.yaml')],
        ['report', motionless, '-o', str(tmp_path / 'page.html')],
        ['replay', motionless, '-o', str(tmp_path / 'out')],
        ['calibrate', turns, '-o', str(tmp_path / 'calibrated.yaml')],
    ):
        main(arguments)
        printed = capsys.readouterr()
        assert 'has a damaged summary at its end: read to its last whole message' in printed.err
        assert 'error' not in printed.err


@pytest.mark.parametrize('folder', [True, False])
def test_a_file_that_may_not_be_read_was_not_cut_off(folder, tmp_path, random, monkeypatch):
    replay(write_mcap(tmp_path / 'in.mcap', mixed(random)), tmp_path / 'b', parameters=Parameters())
    file, opened = tmp_path / 'b' / 'b.mcap', Path.open

    def refuse(path, *arguments, **options):
        if path == file:
            raise PermissionError(13, 'Permission denied', str(path))
        return opened(path, *arguments, **options)

    monkeypatch.setattr(Path, 'open', refuse)
    with pytest.raises(BagError, match='Permission denied') as error:
        found(tmp_path / 'b' if folder else file)
    assert 'cut off' not in str(error.value)


def test_replay_and_its_warning(tmp_path, random):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **FORMS['zstd'])
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) * 2 // 3])
    assert main(['replay', str(path), '-o', str(tmp_path / 'out'), '--quiet']) == 0
    topics, _ = read(tmp_path / 'out')
    assert 100 < len(topics['/imu/data_filtered']) < 600
    assert topics['/words']


def test_what_can_not_be_recovered_is_one_line(tmp_path, random):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **FORMS['zstd'])
    whole = path.read_bytes()
    for data, reason in (
        (whole[: len(MAGIC) + 3], 'was cut off before its first whole message'),
        (whole[:3000].replace(b'zstd', b'zst?'), 'was cut off before its first whole message'),
        (MAGIC + PREFIX.pack(6, 2**60) + b'abc', 'has a record at byte 17 that is too long'),
        (MAGIC + PREFIX.pack(99, 2**64 - 1) + b'abc', 'before its first whole message'),
        (MAGIC, 'can not be read as a bag|before its first whole message'),
        (MAGIC[:5], 'can not be read as a bag'),
    ):
        path.write_bytes(data)
        with pytest.raises(BagError, match=reason) as error:
            found(path)
        assert '\n' not in str(error.value)


def test_only_what_is_recovered_needs_room_for_a_copy(tmp_path, random, monkeypatch):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random), **FORMS['zstd'])
    monkeypatch.setattr(tempfile, 'tempdir', str(tmp_path / 'missing'))
    assert found(path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(BagError, match='was cut off, and what is whole of it can not be copied'):
        found(path)


def test_a_whole_file_is_not_copied(tmp_path, random):
    path = write_mcap(tmp_path / 'in.mcap', mixed(random))
    assert not is_cut_off(path)
    with open_bag(path) as recording:
        assert recording.path == path


def test_force_replaces_a_bag_when_the_new_one_is_complete(tmp_path, random):
    source = write_mcap(tmp_path / 'in.mcap', mixed(random))
    out = tmp_path / 'out'
    replay(source, out, parameters=Parameters())
    before = (out / 'out.mcap').read_bytes()
    with pytest.raises(BagError, match='choose another name or use --force'):
        replay(source, out, parameters=Parameters(method='kalman'))
    replay(source, out, parameters=Parameters(method='kalman'), force=True)
    after = (out / 'out.mcap').read_bytes()
    assert after != before
    empty = write_mcap(tmp_path / 'empty.mcap', [('/words', TEXT, START, text('x'))])
    with pytest.raises(BagError, match='no topic of type'):
        replay(empty, out, parameters=Parameters(), force=True)
    assert (out / 'out.mcap').read_bytes() == after
    assert sorted(p.name for p in tmp_path.iterdir()) == ['empty.mcap', 'in.mcap', 'out']


def test_an_interrupt_in_mid_exchange_leaves_the_old_bag(tmp_path, random, monkeypatch):
    source = write_mcap(tmp_path / 'in.mcap', mixed(random))
    out = tmp_path / 'out'
    replay(source, out, parameters=Parameters())
    before = (out / 'out.mcap').read_bytes()
    rename = Path.rename

    def interrupted(path, target):
        if Path(target) == out and path.name == 'out':
            raise KeyboardInterrupt
        return rename(path, target)

    monkeypatch.setattr(Path, 'rename', interrupted)
    with pytest.raises(KeyboardInterrupt):
        replay(source, out, parameters=Parameters(method='kalman'), force=True)
    assert (out / 'out.mcap').read_bytes() == before
    assert sorted(p.name for p in tmp_path.iterdir()) == ['in.mcap', 'out']


def test_a_link_to_the_output_stays_one(tmp_path, random, caplog):
    source = write_mcap(tmp_path / 'in.mcap', mixed(random))
    bag, link = tmp_path / 'disk' / 'bag', tmp_path / 'link'
    replay(source, bag, parameters=Parameters())
    before = (bag / 'bag.mcap').read_bytes()
    link.symlink_to(bag)
    replay(source, link, parameters=Parameters(method='kalman'), force=True)
    assert link.readlink() == bag
    assert f'{link} is a link: the bag {bag} is replaced' in caplog.text  # it is what is lost
    assert sorted(p.name for p in bag.iterdir()) == ['bag.mcap', 'metadata.yaml']
    assert (bag / 'bag.mcap').read_bytes() != before
    nowhere = tmp_path / 'nowhere'
    nowhere.symlink_to(tmp_path / 'disk' / 'new')
    replay(source, nowhere, parameters=Parameters())
    assert (tmp_path / 'disk' / 'new' / 'new.mcap').exists()


def test_force_replaces_nothing_but_bags(tmp_path, random):
    source = write_mcap(tmp_path / 'in.mcap', mixed(random))
    precious = tmp_path / 'thesis'
    precious.mkdir()
    (precious / 'chapter').write_text('x')
    with pytest.raises(BagError, match='is no rosbag2 folder, and is not replaced'):
        replay(source, precious, parameters=Parameters(), force=True)
    assert (precious / 'chapter').read_text() == 'x'
    bag = tmp_path / 'bag'
    replay(source, bag, parameters=Parameters())
    (bag / 'params.yaml').write_text('')
    with pytest.raises(BagError, match=r'holds more than a bag, and is not replaced: params.yaml'):
        replay(source, bag, parameters=Parameters(), force=True)
    (bag / 'params.yaml').unlink()
    for inner in (bag, bag / 'bag.mcap'):
        with pytest.raises(BagError, match='is the bag to be read'):
            replay(inner, bag, parameters=Parameters(), force=True, selection=Selection((TOPIC,)))
