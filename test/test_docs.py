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

"""The documentation: commands that work, tables that are those of the code, a site that builds."""

import os
import re
import sys
from pathlib import Path
from typing import NamedTuple

import pytest

from gyro_drift_filter.cli.main import main
from support.bags import simulated_folder
from support.paths import PACKAGE, RECORDINGS, REPOSITORY, recorded
from support.processes import run_command

PAGES = [REPOSITORY / 'README.md', *sorted((REPOSITORY / 'docs').glob('*.md'))]
SHELL = ('bash', 'sh', 'shell', 'console')
RUN = (*SHELL, 'python')
# A block that no test can run has this in the line before, with the reason.
NOT_RUN = re.compile(r'<!-- not run: \S.* -->')


class Block(NamedTuple):
    """A fenced block of a page: where it begins, its language, its text, the line before."""

    line: int
    language: str
    text: str
    before: str


def blocks(page):
    found, lines = [], page.read_text().split('\n')
    begin = None
    for number, line in enumerate(lines):
        if not line.startswith('```'):
            continue
        if begin is None:
            begin = number
            continue
        text = '\n'.join(lines[begin + 1 : number]) + '\n'
        before = lines[begin - 1] if begin else ''
        found.append(Block(begin + 1, lines[begin][3:], text, before))
        begin = None
    assert begin is None, f'{page.name}: the block of line {begin + 1} has no end'
    return found


def to_run(page):
    return [b for b in blocks(page) if b.language in RUN and not NOT_RUN.fullmatch(b.before)]


def run(block, folder):
    """Run a block as its reader would: line by line, from a shell that stops at the first error."""
    command = [sys.executable, '-'] if block.language == 'python' else ['bash', '-eu', '-s']
    environment = {
        'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}',
        'PYTHONPATH': str(REPOSITORY),
        'HOME': str(folder),
        'XDG_CACHE_HOME': os.environ.get('XDG_CACHE_HOME', str(Path.home() / '.cache')),
    }
    return run_command(*command, environment=environment, input=block.text, cwd=folder)


@pytest.fixture(scope='session')
def recordings(tmp_path_factory):
    """Make a folder with what the pages name: the bags drive, motionless and turns."""
    return simulated_folder(tmp_path_factory.mktemp('docs'))


@pytest.mark.slow
@pytest.mark.parametrize('page', [p for p in PAGES if to_run(p)], ids=lambda page: page.name)
def test_commands_of_a_page_work(page, recordings, tmp_path):
    """One after the other, in a folder of the page."""
    for entry in recordings.iterdir():
        (tmp_path / entry.name).symlink_to(entry)
    for block in to_run(page):
        done = run(block, tmp_path)
        assert done.returncode == 0, (
            f'{page.name}, line {block.line}:\n{block.text}\n{done.stdout}\n{done.stderr}'
        )


@pytest.mark.slow
def test_the_verdict_that_the_page_shows_is_that_of_the_program(tmp_path, capsys):
    source = recorded(RECORDINGS / 'multiposition_xsens')
    assert main(['replay', str(source), '-o', str(tmp_path / 'out')]) == 0
    shown = [b.text for b in blocks(REPOSITORY / 'docs' / 'report.md') if b.language == 'text']
    assert f'\n\n{shown[0]}\n' in capsys.readouterr().out


@pytest.mark.slow
def test_the_findings_that_the_page_shows_are_those_of_the_program(capsys):
    assert main(['doctor', str(recorded(RECORDINGS / 'broad_24_tapping'))]) == 3
    (shown,) = (b.text for b in blocks(REPOSITORY / 'docs' / 'doctor.md') if b.language == 'text')
    assert capsys.readouterr().out == shown


def test_no_two_pages_make_what_has_the_same_name():
    """A reader follows them in one folder, where the second one would meet what the first made."""
    made = {}
    for page in PAGES:
        lines = [line for b in blocks(page) if b.language in SHELL for line in b.text.split('\n')]
        for line in lines:
            if line.startswith('gyro_drift ') and not line.startswith('gyro_drift simulate'):
                for name in re.findall(r' (?:-o|--json|--kalibr|--plot|--png) ([\w./]+)', line):
                    assert made.setdefault(name, page) == page, f'{name}: {page.name}'


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_each_block_has_a_language(page):
    """So that none escapes, as an indented one would, or one that is called otherwise."""
    known = (*RUN, 'text', 'yaml', 'diff')
    assert [b for b in blocks(page) if b.language not in known] == []
    outside = re.sub(r'^```.*?^```', '', page.read_text(), flags=re.MULTILINE | re.DOTALL)
    assert re.findall(r'\n\n {4}.*', outside) == []


def test_a_marked_block_has_a_reason_and_is_one_to_run():
    for page in PAGES:
        lines = page.read_text().split('\n')
        for number, line in enumerate(lines):
            if 'not run' in line and line.startswith('<!--'):
                assert NOT_RUN.fullmatch(line), f'{page.name}, line {number + 1}'
                assert lines[number + 1][:3] == '```', f'{page.name}, line {number + 1}'
                assert lines[number + 1][3:] in RUN, f'{page.name}, line {number + 1}'


def test_a_command_that_fails_is_found(tmp_path):
    """Or else the test of the pages would show nothing."""
    page = tmp_path / 'page.md'
    page.write_text('```bash\ntrue\n```\n\n<!-- not run: a reason -->\n```bash\nfalse\n```\n')
    (block,) = to_run(page)
    assert run(block, tmp_path).returncode == 0
    page.write_text(page.read_text().replace('<!-- not run: a reason -->', ''))
    assert [run(block, tmp_path).returncode for block in to_run(page)] == [0, 1]


def test_commands_are_those_of_the_parser():
    pytest.importorskip('rclpy', reason='the usage of the node stands beside rclpy')
    from tools.write_command_page import PAGE, command_page

    assert PAGE.read_text() == command_page(), 'run `make commands`'


def rows_of(page, title):
    """Return the rows of the table below a title, as lists of cells without backquotes."""
    (body,) = re.findall(rf'^## {title}\n(.*?)(?=^## |\Z)', page, re.MULTILINE | re.DOTALL)
    table = [line for line in body.split('\n') if line.startswith('| `')]
    return [[cell.strip().strip('`') for cell in line.split('|')[1:-1]] for line in table]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_code_that_a_page_names_exists(page):
    """A list item that begins with `Code:` names files, and what stands in one of them."""
    items = r'^- Code: (.*?)(?=^- |\n\n|\Z)'
    for item in re.findall(items, page.read_text(), re.MULTILINE | re.DOTALL):
        named = re.findall(r'`([\w./]+)`', item)
        paths = [name for name in named if name.endswith(('.py', '/'))]
        code = ''
        for path in (PACKAGE / name for name in paths):
            files = path.glob('*.py') if path.is_dir() else [path]
            code += '\n'.join(file.read_text() for file in files)
        for name in set(named) - set(paths):
            assert re.search(rf'^ *(def |class )?{name}\b', code, re.MULTILINE), (name, item)


@pytest.mark.node
def test_topics_are_those_of_the_node():
    rclpy = pytest.importorskip('rclpy', reason='ROS 2 is not installed')
    from rclpy.qos import DurabilityPolicy, ReliabilityPolicy

    from gyro_drift_filter.ros.node import GyroDriftFilterNode
    from harness.live_node import own_domain

    def kind(type_):
        package, what, *_ = type_.__module__.split('.')
        return f'{package}/{what}/{type_.__name__}'

    def quality(qos):
        reliable = qos.reliability == ReliabilityPolicy.RELIABLE
        latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
        return f'{"reliable" if reliable else "best effort"}, depth {qos.depth}' + (
            ', latched' if latched else ''
        )

    page = (REPOSITORY / 'docs' / 'topics.md').read_text()
    context = rclpy.Context()
    rclpy.init(context=context, domain_id=own_domain())
    given = {'motion_hint': 'odometry', 'bias.memory': False}
    overrides = [rclpy.Parameter(name, value=value) for name, value in given.items()]
    try:
        node = GyroDriftFilterNode(context=context, parameter_overrides=overrides)
        for title, handles in (
            ('What it subscribes to', node.subscriptions),
            ('What it publishes', node.publishers),
        ):
            found = {(h.topic_name, kind(h.msg_type), quality(h.qos_profile)) for h in handles}
            stated = {
                (node.resolve_topic_name(name), *rest[:2]) for name, *rest in rows_of(page, title)
            }
            assert {row for row in found if row[0] != '/parameter_events'} == stated
        # The others are those that each node has for its parameters.
        own = [service for service in node.services if service.srv_name.startswith('~')]
        assert {(service.srv_name, kind(service.srv_type)) for service in own} == {
            (name, type_) for name, type_, _ in rows_of(page, 'What it serves')
        }
        node.destroy_node()
    finally:
        rclpy.shutdown(context=context)


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    pytest.importorskip('mkdocs', reason='mkdocs is not installed: make installs it')
    build = '-m', 'mkdocs', 'build', '--strict', '--site-dir', tmp_path / 'site'
    done = run_command(sys.executable, *build, cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr
    # What a browser would load when a page is opened; links that a reader follows may lead away.
    for page in sorted((tmp_path / 'site').rglob('*.html')):
        loaded = re.findall(
            r'<(?:script|img|iframe)[^>]* src="?([^" >]+)|<link[^>]* href="?([^" >]+)',
            page.read_text(),
        )
        assert [a or b for a, b in loaded if (a or b).startswith(('http', '//'))] == [], page.name
