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

"""Parameters: ranges, names and the messages that users read."""

from itertools import pairwise

import pytest
import yaml

from gyro_drift_filter.cli.parameter_file import read_parameters
from gyro_drift_filter.cli.parameter_text import parameter_text
from gyro_drift_filter.core import ParameterError, Parameters
from gyro_drift_filter.core.parameters import DESCRIPTIONS, GROUPS
from gyro_drift_filter.messages.parameter_sections import is_section_of
from support.paths import PARAMETER_FILE
from tools import write_parameter_files
from tools.write_parameter_files import parameter_files


def write(tmp_path, text):
    path = tmp_path / 'parameters.yaml'
    path.write_text(text)
    return path


def section(**parameters):
    return yaml.safe_dump({'gyro_drift_filter': {'ros__parameters': parameters}})


def test_files_are_those_of_the_table():
    for path, content in parameter_files().items():
        assert path.read_text() == content, 'run `make parameters`'
    assert read_parameters(PARAMETER_FILE) == Parameters()


def test_a_group_is_written_once_wherever_its_parameters_stand(monkeypatch, tmp_path):
    scattered = sorted(DESCRIPTIONS, key=lambda description: description.name.rpartition('.')[2])
    monkeypatch.setattr(write_parameter_files, 'DESCRIPTIONS', tuple(scattered))
    files = {path.suffix: content for path, content in parameter_files().items()}
    values = yaml.safe_load(files['.yaml'])['/**']['ros__parameters']
    assert read_parameters(write(tmp_path, files['.yaml'])) == Parameters()
    written = {name for name, value in values.items() if not isinstance(value, dict)}
    for group in GROUPS:
        written |= {f'{group}.{name}' for name in values[group]}
        assert files['.md'].count(f'## {group}\n') == 1
    assert written == set(Parameters().names())


def test_a_group_without_a_sentence_is_named(monkeypatch):
    others = {group: text for group, text in GROUPS.items() if group != 'bias'}
    monkeypatch.setattr(write_parameter_files, 'GROUPS', others)
    with pytest.raises(ValueError, match="the group 'bias' is new: GROUPS of"):
        parameter_files()


def test_every_parameter_is_described():
    for description in DESCRIPTIONS:
        assert len(description.text) > 30
        assert description.limits or description.kind == 'bool'
        assert description.name.rpartition('.')[0] in ('', *GROUPS)


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('forgetting_factor', 0.8, "'forgetting_factor' must be at least 0.9 and at most 0.9999"),
        ('forgetting_factor', 1.0, 'at most 0.9999'),
        ('epsilon', 0.0, "'epsilon' must be greater than 0"),
        ('epsilon', float('nan'), 'greater than 0'),
        ('epsilon', float('inf'), 'greater than 0'),
        ('method', 'kalmann', "'method' must be one of kalman, sage_husa, adaptive"),
        ('method', 3, "'method' must be one of"),
        ('outlier.enabled', 1, "'outlier.enabled' must be true or false"),
        ('sample_rate', 'fast', "'sample_rate' must be a number, not 'fast'"),
        ('sample_rate', True, "'sample_rate' must be a number"),
        ('model.phi', 0.2, "'model.phi' must be a list of three numbers"),
        ('model.phi', [0.1, 0.2], "'model.phi' must be a list of three numbers"),
        ('model.phi', [0.1, 0.2, 1.0], r"'model.phi' \(axis z\) must be greater than -1 and less"),
        ('model.process_noise', [1, 'x', 1], r"'model.process_noise' \(axis y\) must be a number"),
        ('forgeting_factor', 0.98, "did you mean 'forgetting_factor'"),
        ('sample_rate', 10**400, 'at most 10000'),
        ('outlier.run', 2.5, "'outlier.run' must be a whole number"),
        ('outlier.run', 0, 'at least 1'),
        ('zzz', 0.98, "unknown parameter 'zzz': there are method, "),
        ('bias.initial', [0.1, 0.0, -0.2], r"'bias.initial' \(axis z\) is -0.2 rad/s, beyond bias"),
    ],
)
def test_wrong_values_are_refused_with_the_limit(name, value, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        Parameters.from_names({name: value})
    path = write(tmp_path, section(**{name: value}))
    with pytest.raises(ParameterError, match=message):
        read_parameters(path)


def test_an_integer_is_taken_where_a_double_belongs():
    parameters = Parameters.from_names({'sample_rate': 100, 'model.phi': [0, 0, 0]})
    assert parameters.sample_rate == 100.0
    assert isinstance(parameters.sample_rate, float)
    assert parameters.model_phi == (0.0, 0.0, 0.0)


def test_names_round_trip():
    parameters = Parameters(epsilon=3.0, model_phi=(0.1, 0.2, 0.3))
    assert Parameters.from_names(parameters.names()) == parameters
    assert parameters.with_names({'method': 'kalman'}).epsilon == 3.0


@pytest.mark.parametrize(
    'name',
    ['gyro_drift_filter', '/gyro_drift_filter', '/robot1/gyro_drift_filter', '/**', '**', '*'],
)
def test_the_section_is_found_under_every_name_that_ros_matches(name, tmp_path):
    text = yaml.safe_dump({name: {'ros__parameters': {'epsilon': 7}}})
    assert read_parameters(write(tmp_path, text)).epsilon == 7.0


def test_nested_and_dotted_names_are_the_same(tmp_path):
    for content in ({'model': {'phi': [0.1, 0.2, 0.3]}}, {'model.phi': [0.1, 0.2, 0.3]}):
        path = write(tmp_path, section(**content))
        assert read_parameters(path).model_phi == (0.1, 0.2, 0.3)


def test_what_belongs_to_every_node_is_passed_over(tmp_path):
    content = {'use_sim_time': True, 'qos_overrides': {'/imu/data_raw': {'depth': 1}}}
    assert read_parameters(write(tmp_path, section(**content))) == Parameters()


@pytest.mark.slow
@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('other:\n  ros__parameters: {epsilon: 1.0}', "no section 'gyro_drift_filter'"),
        ('epsilon: 1.0', "no section 'gyro_drift_filter'"),
        ('- 1', 'holds no node names'),
        ('', 'holds no node names'),
        ('a: [1, 2', 'is no YAML: line 1, column 9: expected'),
        ('a:\n  b: 1\n c: 2', 'is no YAML: line 3, column 2: expected <block end>'),
        ('\x00', 'is no YAML'),
        ('[' * 1000, 'is no YAML'),
    ],
)
def test_a_file_that_is_no_parameter_file(text, message, tmp_path):
    with pytest.raises(ParameterError, match=message) as error:
        read_parameters(write(tmp_path, text))
    assert '\n' not in str(error.value)


def test_a_missing_file(tmp_path):
    with pytest.raises(ParameterError, match='No such file'):
        read_parameters(tmp_path / 'none.yaml')


def test_exponents_are_numbers_as_rcl_reads_them(tmp_path):
    path = write(tmp_path, '/**: {ros__parameters: {epsilon: 2e-2, model.phi: [1e-1, .2, 3E-1]}}')
    parameters = read_parameters(path)
    assert parameters.epsilon == 0.02
    assert parameters.model_phi == (0.1, 0.2, 0.3)


def test_a_stranger_in_a_section_for_all_nodes_draws_a_warning(tmp_path, caplog):
    path = write(tmp_path, '/**: {ros__parameters: {publish_rate: 3.0, epsilon: 7.0}}')
    assert read_parameters(path).epsilon == 7.0
    assert "unknown parameter 'publish_rate'" in caplog.text


def test_a_value_for_a_group_is_an_error(tmp_path, caplog):
    """Another node may have a parameter of that name."""
    message = "'bias' is a group of parameters, such as 'bias.enabled', and has no value of its own"
    content = 'ros__parameters: {bias: 3}'
    with pytest.raises(ParameterError, match=message):
        read_parameters(write(tmp_path, f'gyro_drift_filter: {{{content}}}'))
    read_parameters(write(tmp_path, f'/**: {{{content}}}'))
    assert f'{message}: taken to be for another node' in caplog.text


def test_a_slip_in_a_section_for_all_nodes_is_an_error(tmp_path):
    with pytest.raises(ParameterError, match="'epsilonn': did you mean 'epsilon'"):
        read_parameters(write(tmp_path, '/**: {ros__parameters: {epsilonn: 7.0}}'))


# As rclpy 7.1 answers.
@pytest.mark.parametrize(
    ('section', 'of_robot', 'of_root'),
    [
        ('/gyro', False, True),
        ('/robot1/gyro', True, False),
        ('/**', True, True),
        ('/*', False, True),
        ('/*/gyro', True, False),
        ('/**/gyro', True, True),
        ('/robot1/*', True, False),
        ('/robot1/**', True, False),
        ('/**/robot1/gyro', True, False),
        ('/*/*', True, False),
        ('/**/**', True, True),
        ('/gyr.', False, False),
    ],
)
def test_which_node_a_section_is_for(section, of_robot, of_root):
    assert is_section_of(section, '/robot1/gyro') == of_robot
    assert is_section_of(section, '/gyro') == of_root


def test_of_several_sections_for_the_node_the_last_one_wins(tmp_path):
    """As for the node: test_node.py has the same."""
    own = 'gyro_drift_filter: {ros__parameters: {epsilon: 7.0}}\n'
    of_all = '/**: {ros__parameters: {epsilon: 3.0, method: kalman}}\n'
    for text, epsilon in ((of_all + own, 7.0), (own + of_all, 3.0)):
        parameters = read_parameters(write(tmp_path, text))
        assert (parameters.epsilon, parameters.method) == (epsilon, 'kalman')


def test_what_is_given_twice_is_joined(tmp_path):
    """As for the node: test_node.py compares more of such files with it."""
    group = '/**:\n  ros__parameters:\n    bias: {max: 0.1, memory: false}\n    bias: {max: 0.2}\n'
    section = '/**: {ros__parameters: {epsilon: 7.0}}\n'
    parameters = read_parameters(write(tmp_path, section + group))
    assert (parameters.bias_max, parameters.bias_memory) == (0.2, False)
    assert parameters.epsilon == 7.0


@pytest.mark.parametrize(
    ('content', 'message'),
    [
        ('{epsilon: 1, epsilon: 2.0}', "'epsilon' is given twice, with values of different types"),
        ('{model.phi: [0, 0, 0], model: {phi: [0.1, 0.1, 0.1]}}', "'model.phi' is given twice"),
        ('{bias.initial: [0, 0.0, 1]}', "'bias.initial' is a list of whole and other numbers: wri"),
        ('{bias: {}}', "'bias' has no value"),
        ('{bias: }', "'bias' has no value"),
        ('{}, ros__parameters: {}', r"section '/\*\*' has 'ros__parameters' twice: join them"),
    ],
)
def test_what_rcl_refuses_or_mistakes_is_refused(content, message, tmp_path):
    with pytest.raises(ParameterError, match=message):
        read_parameters(write(tmp_path, f'/**: {{ros__parameters: {content}}}'))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (
            '/**: {ros__parameters: {}, ros__params: {epsilon: 7.0}}',
            "'epsilon' is in no section 'gyro_drift_filter' or other",
        ),
        ('/**: {epsilon: 7.0}', "'epsilon' is in no section 'gyro_drift_filter'"),
        ('other: \n/**: {ros__parameters: {}}', "'other' is in no section 'gyro_drift_filter'"),
        ('/**:\n  ros__parameters:\n', r"section '/\*\*' has no parameters below its 'ros__param"),
    ],
)
def test_values_outside_of_what_holds_parameters_are_refused(text, message, tmp_path):
    """As rcl does: test_node.py compares."""
    with pytest.raises(ParameterError, match=message):
        read_parameters(write(tmp_path, text))


def test_what_is_mistaken_only_in_the_section_of_another_node(tmp_path):
    """That is nothing to this one, unless rcl refuses the whole file for it."""
    ours = 'gyro_drift_filter: {ros__parameters: {epsilon: 7.0}}\n'
    for content in ('{speed: 1, speed: 2.0}', '{wheels: {}}'):
        other = f'other: {{ros__parameters: {content}}}\n'
        assert read_parameters(write(tmp_path, ours + other)).epsilon == 7.0
    for content, why in (('{wheels: }', 'has no value'), ('{sizes: [1, 2.0]}', 'is a list of')):
        with pytest.raises(ParameterError, match=why):
            read_parameters(write(tmp_path, f'{ours}other: {{ros__parameters: {content}}}\n'))


def test_sections_of_several_robots_are_not_mixed(tmp_path):
    text = (
        '/robot1/gyro_drift_filter: {ros__parameters: {method: kalman}}\n'
        '/robot2/gyro_drift_filter: {ros__parameters: {epsilon: 5.0}}\n'
    )
    with pytest.raises(ParameterError, match='several nodes: /robot1/gyro_drift_filter, /robot2'):
        read_parameters(write(tmp_path, text))


def test_a_parameter_file_that_unfolds_without_end(tmp_path):
    """A few lines of aliases stand for a billion values; rcl takes none either."""
    lines = ['a: &a [x, x, x, x, x, x, x, x, x]\n']
    lines += [f'{c}: &{c} [{", ".join(9 * ["*" + b])}]\n' for b, c in pairwise('abcdefghij')]
    for text in (''.join(lines), 'a: &a {b: *a}\n', '/**: {ros__parameters: &p {x: *p}}\n'):
        with pytest.raises(ParameterError, match='aliases') as error:
            read_parameters(write(tmp_path, text))
        assert '\n' not in str(error.value)
    with pytest.raises(ParameterError, match='longer than 1000000 bytes'):
        read_parameters(write(tmp_path, '#' * 1_000_001))


def test_a_name_of_a_parameter_is_text_whatever_it_looks_like(tmp_path):
    """That of another node, such as y, made the node refuse the file."""
    content = '/**: {ros__parameters: {offset: {x: 1.0, y: 2.0}, epsilon: 7.0}}'
    assert read_parameters(write(tmp_path, content)).epsilon == 7.0


def test_what_is_written_is_read_to_the_last_bit(tmp_path):
    """A double without a point is a text to PyYAML, and an integer to rcl."""
    path, noise = tmp_path / 'p.yaml', (2e-5, 0.01 / 3.0, 1e-100)
    values = {
        'sample_rate': 100.0,
        'model.phi': (0.1 + 0.2, 1e-5, 0.0),
        'bias.memory': False,
        'model.noise_deviation': noise,
    }
    path.write_text(parameter_text(['a head'], values, {'model.phi': ['a remark']}))
    assert read_parameters(path) == Parameters.from_names(values)
    written = yaml.safe_load(path.read_text())['/**']['ros__parameters']
    assert written['model']['noise_deviation'] == list(noise)
    assert '# a head\n/**:' in path.read_text()
    assert '    model:\n      # a remark\n      phi: ' in path.read_text()
