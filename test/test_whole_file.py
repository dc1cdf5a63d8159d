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

"""Files that are written whole: they are on the disk before they have their name."""

import errno
import fcntl
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.whole_file import draw_whole, remove_abandoned, whole_file, write_whole


@pytest.fixture
def path(tmp_path):
    """Return where a file is that has been written before."""
    path = tmp_path / 'file'
    path.write_text('old')
    return path


def test_the_content_is_on_the_disk_before_the_name(path, monkeypatch):
    synced = []

    def fsync(descriptor):
        name = Path(f'/proc/self/fd/{descriptor}').readlink()
        synced.append((name, name.is_file() and name.read_text(), path.read_text()))

    monkeypatch.setattr(os, 'fsync', fsync)
    write_whole(path, 'new')
    (file, content, named), (folder, _, named_then) = synced
    assert (file.parent, content, named) == (path.parent, 'new', 'old')
    assert file != path
    assert (folder, named_then) == (path.parent, 'new')
    assert list(path.parent.iterdir()) == [path]


def test_what_a_link_leads_to_is_written(path, tmp_path):
    """As where the bias of a robot is kept on another disk."""
    link, dangling = (tmp_path / 'links' / name for name in ('a', 'b'))
    link.parent.mkdir()
    link.symlink_to(path)
    dangling.symlink_to(tmp_path / 'none' / 'yet')
    path.with_name('.file.12.incomplete').touch()
    remove_abandoned(link)
    for each in (link, dangling):
        write_whole(each, 'new')
        assert each.is_symlink()
        assert each.resolve().read_text() == 'new'
    assert sorted(link.parent.iterdir()) == [link, dangling]
    assert [file for file in tmp_path.rglob('*') if 'incomplete' in file.name] == []


def test_a_file_system_that_does_not_sync_folders_will_do(path, monkeypatch):
    fsync = os.fsync

    def of_files_alone(descriptor):
        if Path(f'/proc/self/fd/{descriptor}').is_dir():
            raise OSError(errno.EINVAL, 'Invalid argument')
        fsync(descriptor)

    monkeypatch.setattr(os, 'fsync', of_files_alone)
    write_whole(path, 'new')
    assert path.read_text() == 'new'


def test_a_disk_that_does_not_take_the_content_leaves_the_old_file(path, monkeypatch):
    def fsync(descriptor):
        raise OSError(errno.EIO, 'Input/output error')

    monkeypatch.setattr(os, 'fsync', fsync)
    with pytest.raises(GyroDriftFilterError, match='file can not be written: Input/output error'):
        write_whole(path, 'new')
    assert path.read_text() == 'old'
    assert list(path.parent.iterdir()) == [path]


def test_an_interrupt_leaves_the_old_file(path):
    def write_a_part():
        with whole_file(path) as unfinished:
            unfinished.write_text('ne')
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_a_part()
    assert path.read_text() == 'old'
    assert list(path.parent.iterdir()) == [path]


# Begins a file, says so, and works on without end.
WORK = """
import sys, time
from pathlib import Path
from gyro_drift_filter.whole_file import whole_file

with whole_file(Path(sys.argv[1])) as unfinished:
    unfinished.write_text('ne')
    print('begun', flush=True)
    time.sleep(600)
"""


@pytest.mark.slow
def test_what_a_killed_process_has_left_is_removed_and_nothing_of_one_that_runs(path):
    with subprocess.Popen(
        [sys.executable, '-c', WORK, path], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout.readline() == 'begun\n'
        remove_abandoned(path)
        write_whole(path, 'new')
        (left,) = set(path.parent.iterdir()) - {path}
        process.kill()
    assert left.read_text() == 'ne'
    remove_abandoned(path)
    assert list(path.parent.iterdir()) == [path]
    assert path.read_text() == 'new'


def test_who_looks_before_the_lock_is_there_does_not_remove_what_is_written_then(path, monkeypatch):
    """Of three nodes that kept a bias in one file at the same time some could not."""
    flock, looked = fcntl.flock, []

    def late(file, operation):
        if not looked:
            looked.append(True)
            remove_abandoned(path)
        flock(file, operation)

    monkeypatch.setattr(fcntl, 'flock', late)
    with whole_file(path) as unfinished:
        unfinished.write_text('new')
        remove_abandoned(path)
    assert path.read_text() == 'new'


def test_only_what_was_to_become_this_file_is_removed(path):
    names = '.file.more.incomplete', '.other.12.incomplete', '.file.12', 'file.12.incomplete'
    others = [path.with_name(name) for name in names]
    for other in others:
        other.touch()
    path.with_name('.file.12.incomplete').touch()
    # Who is killed before it has the lock leaves this; who has come that far just now gets it.
    old, new = (path.with_name(f'.file.{number}.incomplete.new') for number in (12, 13))
    for file in (old, new):
        file.touch()
    os.utime(old, (0, time.time() - 2 * 3600))
    remove_abandoned(path)
    assert sorted(path.parent.iterdir()) == sorted([path, *others, new])


class Figure:
    """A figure, or what a test needs of one, that a full disk takes a part of."""

    def savefig(self, path, **_):
        path.write_bytes(b'a part')
        raise OSError(errno.ENOSPC, 'No space left on device')


def test_a_figure_that_the_disk_does_not_take_is_named_and_leaves_nothing(tmp_path):
    with pytest.raises(GyroDriftFilterError, match=r'a.png can not be written: No space left on'):
        draw_whole(tmp_path / 'figures' / 'a.png', Figure())
    assert list((tmp_path / 'figures').iterdir()) == []
