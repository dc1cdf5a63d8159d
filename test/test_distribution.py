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

"""What is handed on: wheel, source distribution, their metadata, and the files beside the code."""

import ast
import re
import shutil
import sys
import tarfile
import zipfile
from importlib.metadata import requires, version
from pathlib import Path

import pytest
import yaml
from packaging.metadata import Metadata
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

from support.paths import NOT_COPIED, PACKAGE, REPOSITORY
from support.processes import run_command

DISTRIBUTION_OF = {
    'backports': 'backports.zstd',
    'distributed': 'dask',
    'mpl_toolkits': 'matplotlib',
    'yaml': 'pyyaml',
}
WORKFLOW = REPOSITORY / '.github' / 'workflows' / 'ci.yml'


def imported(path):
    """Yield the names of the packages that a file imports."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name.split('.')[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield str(node.module).split('.')[0]


@pytest.mark.slow
def test_what_the_commands_import_is_installed_with_them():
    """But for the node, whose libraries come with ROS 2; a fleet has an extra of its own."""
    requirements = [Requirement(text) for text in requires('gyro_drift_filter') or ()]

    def required(extra):
        return {r.name.lower() for r in requirements if extra in str(r.marker)}

    def needed(paths):
        names = {name for path in paths for name in imported(path)}
        names -= set(sys.stdlib_module_names) | {'compression', 'gyro_drift_filter'}  # that of 3.14
        return {DISTRIBUTION_OF.get(name, name).lower() for name in names}

    paths = {path for path in PACKAGE.rglob('*.py') if path.parent.name != 'ros'}
    of_fleets = {path for path in paths if path.parent.name == 'fleet'}
    always = required('') - required('extra')
    assert {'numpy', 'rosbags', 'scipy', 'plotly', 'matplotlib'} <= needed(paths - of_fleets)
    assert needed(paths - of_fleets) <= always
    assert needed(of_fleets) <= always | required('extra == "fleet"')


def test_texts_ask_for_the_versions_that_are_required():
    texts = [path.read_text() for path in REPOSITORY.glob('docs/*.md')]
    texts += [path.read_text() for path in PACKAGE.rglob('*.py')]
    asked = {
        asked
        for text in texts
        for asked in re.findall(r'["\']((?:numba|rosbags)[<>][^"\']*)', text)
    }
    required = (REPOSITORY / 'setup.py').read_text()
    assert len(asked) == 2
    assert all(re.search(f"'{text}[;']", required) for text in asked)


def test_what_is_required_has_a_lower_bound():
    """The job `floors` of the continuous integration tries them."""
    requirements = [Requirement(text) for text in requires('gyro_drift_filter') or ()]
    assert [r.name for r in requirements if not re.search('>=|==', str(r.specifier))] == []


@pytest.fixture(scope='module')
def source(tmp_path_factory):
    """Make the source distribution of a copy of this repository."""
    copy = tmp_path_factory.mktemp('source') / 'copy'
    shutil.copytree(REPOSITORY, copy, ignore=NOT_COPIED)
    done = run_command(sys.executable, 'setup.py', '--quiet', 'sdist', cwd=copy)
    assert done.returncode == 0, done.stderr
    assert 'warning' not in done.stdout + done.stderr
    (path,) = (copy / 'dist').glob('*.tar.gz')
    return path


def held_by(source):
    """Return the paths within a source distribution."""
    with tarfile.open(source) as archive:
        return {name.partition('/')[2] for name in archive.getnames()}


@pytest.mark.slow
def test_the_source_distribution_holds_what_the_tests_need(source):
    held = held_by(source)
    for folder in ('benchmark', 'config', 'demo', 'docs', 'harness', 'launch', 'test', 'tools'):
        for path in (REPOSITORY / folder).rglob('*'):
            if path.is_file() and '__pycache__' not in path.parts:
                assert str(path.relative_to(REPOSITORY)) in held
    assert {'package.xml', 'LICENSE', 'Makefile', 'pytest.ini', 'ruff.toml', 'mypy.ini'} <= held


@pytest.mark.slow
def test_the_source_distribution_holds_what_is_tracked(source):
    """But for what the continuous integration and git alone read."""
    if shutil.which('git') is None or not (REPOSITORY / '.git').exists():
        pytest.skip('this is no clone with git')
    listed = run_command('git', 'ls-files', cwd=REPOSITORY)
    assert listed.returncode == 0, listed.stderr
    assert set(listed.stdout.splitlines()) - held_by(source) == {'.ci/run', '.gitignore'}


@pytest.mark.slow
def test_the_wheel_is_pure_and_whole(source, tmp_path):
    """It is built of the source distribution, by pip with what it needs for that."""
    pip = sys.executable, '-m', 'pip'
    done = run_command(*pip, 'wheel', '--quiet', '--no-deps', '-w', tmp_path, source, timeout=300)
    assert done.returncode == 0, done.stderr
    (path,) = tmp_path.glob('*.whl')
    assert path.name == f'gyro_drift_filter-{version("gyro_drift_filter")}-py3-none-any.whl'
    with zipfile.ZipFile(path) as wheel:
        names = set(wheel.namelist())
        information = path.name.removesuffix('-py3-none-any.whl') + '.dist-info'
        assert 'Root-Is-Purelib: true' in wheel.read(f'{information}/WHEEL').decode()
        scripts = wheel.read(f'{information}/entry_points.txt').decode()
        metadata = Metadata.from_email(wheel.read(f'{information}/METADATA'), validate=True)
    for file in PACKAGE.rglob('*'):
        if file.is_file() and '__pycache__' not in file.parts:
            assert str(file.relative_to(REPOSITORY)) in names
    share = f'{path.name.removesuffix("-py3-none-any.whl")}.data/data/share'
    assert f'{share}/gyro_drift_filter/launch/gyro_drift_filter.launch.py' in names
    assert f'{share}/ament_index/resource_index/packages/gyro_drift_filter' in names
    assert 'gyro_drift = gyro_drift_filter.cli.main:main' in scripts
    assert metadata.description == (REPOSITORY / 'README.md').read_text()
    assert metadata.description_content_type == 'text/markdown'
    assert metadata.requires_python == SpecifierSet('>=3.11,<3.13')


@pytest.mark.filterwarnings('ignore:nodes.Node.traverse')  # catkin_pkg's, of docutils
def test_package_xml_and_the_changelog_are_read_by_catkin_tools_without_a_warning():
    changelog = pytest.importorskip('catkin_pkg.changelog')
    parse_package = pytest.importorskip('catkin_pkg.package').parse_package

    warnings = []
    package = parse_package(str(REPOSITORY / 'package.xml'), warnings=warnings)
    assert warnings == []
    released = changelog.get_changelog_from_path(str(REPOSITORY), package.name)
    newest = max(v for v, _, _ in released.foreach_version() if re.match(r'\d', str(v)))
    assert str(newest) == package.version


def test_the_citation_names_the_version_and_the_paper():
    citation = yaml.safe_load((REPOSITORY / 'CITATION.cff').read_text())
    assert citation['cff-version'] == '1.2.0'
    assert {'message', 'title', 'authors'} <= set(citation)
    assert citation['version'] == version('gyro_drift_filter')
    assert citation['references'][0]['doi'] == '10.1088/1757-899X/187/1/012005'


def test_the_workflow_runs_what_there_is():
    """Each target of make that it calls, and each version of Python that setup.py allows."""
    text = WORKFLOW.read_text()
    makefile = (REPOSITORY / 'Makefile').read_text()
    targets = re.findall(r'run: make (\w+)', text)
    assert 'test' in targets
    for target in targets:
        assert re.search(rf'^{target}:', makefile, re.M), f'make {target}'
    jobs = yaml.safe_load(text)['jobs']
    pythons = jobs['test']['strategy']['matrix']['python']
    assert all(python in SpecifierSet('>=3.11,<3.13') for python in pythons)
    assert all('timeout-minutes' in job for job in jobs.values())


def test_the_workflow_is_valid():
    if shutil.which('actionlint') is None:
        pytest.skip('actionlint is not installed: go install github.com/rhysd/actionlint/cmd/...')
    done = run_command('actionlint', WORKFLOW, timeout=60)
    assert done.returncode == 0, done.stdout


def test_pre_commit_checks_what_make_lint_does():
    hooks = yaml.safe_load((REPOSITORY / '.pre-commit-config.yaml').read_text())
    commands = [hook['entry'] for repository in hooks['repos'] for hook in repository['hooks']]
    makefile = (REPOSITORY / 'Makefile').read_text()
    ((recipe, _),) = re.findall(r'^lint:.*\n((\t.*\n)+)', makefile, re.M)
    linted = [line.strip().replace('$(BIN)', '.venv/bin') for line in recipe.splitlines()]
    assert commands == [line.removesuffix(' .') for line in linted]


def test_issue_forms_ask_for_what_helps():
    folder = REPOSITORY / '.github' / 'ISSUE_TEMPLATE'
    form = yaml.safe_load((folder / 'bug.yml').read_text())
    asked = {field['id'] for field in form['body']}
    assert {'what', 'doctor', 'diagnostics', 'versions'} <= asked
    for name in ('SECURITY.md', 'CODE_OF_CONDUCT.md', 'CONTRIBUTING.md', 'LICENSE'):
        assert Path(REPOSITORY, name).read_text()


def test_the_node_without_ros_says_what_it_needs():
    code = """
import sys
sys.modules['rclpy'] = None
from gyro_drift_filter.ros.command import main
sys.exit(main())
"""
    done = run_command(sys.executable, '-c', code, timeout=60)
    assert done.returncode == 1
    assert re.fullmatch(r'gyro_drift_filter_node: the node needs ROS 2 .*rclpy.*\n', done.stderr)
