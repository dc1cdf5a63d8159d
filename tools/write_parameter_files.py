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

"""Write config/gyro_drift_filter.yaml and docs/parameters.md from the table of parameters.

Run it by `make parameters` after a change of gyro_drift_filter/core/parameters.py; a test fails
where the files are not what this writes.
"""

from pathlib import Path
from textwrap import wrap

from gyro_drift_filter.cli.parameter_text import as_yaml
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.core.parameters import DESCRIPTIONS, GROUPS, Description

REPOSITORY = Path(__file__).parent.parent

_WIDTH = 100
_YAML_HEAD = """\
# Parameters of gyro_drift_filter, all at their defaults. The node and `gyro_drift replay --params`
# read this file as it is; docs/tuning.md says when to change which. `make parameters` writes it
# from gyro_drift_filter/core/parameters.py: change that.
/**:
  ros__parameters:
"""
_MARKDOWN_HEAD = """\
# Parameters

<!-- `make parameters` writes this from gyro_drift_filter/core/parameters.py: change that. -->

All parameters, with their defaults. A parameter file holds them as `config/gyro_drift_filter.yaml`
does, and `ros2 param set` changes them while the node runs. When to change which:
[tuning.md](tuning.md).
"""


def parameter_files() -> dict[Path, str]:
    """Return the path of each file and its content."""
    return {
        REPOSITORY / 'config' / 'gyro_drift_filter.yaml': _yaml(),
        REPOSITORY / 'docs' / 'parameters.md': _markdown(),
    }


def _yaml() -> str:
    blocks = []
    for group, described in _groups():
        if group:
            lines = [*_comment(GROUPS[group], 4), f'{4 * " "}{group}:']
            blocks.append(lines + [line for d in described for line in _yaml_lines(d, 6)])
        else:
            blocks += [_yaml_lines(description, 4) for description in described]
    return _YAML_HEAD + '\n\n'.join('\n'.join(lines) for lines in blocks) + '\n'


def _yaml_lines(description: Description, indent: int) -> list[str]:
    unit = f'Unit: {description.unit}. ' if description.unit else ''
    limits = (
        f'{description.limits[0].upper()}{description.limits[1:]}.' if description.limits else ''
    )
    comment = _comment(description.text, indent) + _comment(unit + limits, indent)
    value = as_yaml(Parameters().names()[description.name])
    return [*comment, f'{indent * " "}{description.name.rpartition(".")[2]}: {value}']


def _comment(text: str, indent: int) -> list[str]:
    start = f'{indent * " "}# '
    return wrap(text, _WIDTH, initial_indent=start, subsequent_indent=start)


def _markdown() -> str:
    parts = [_MARKDOWN_HEAD]
    for group, described in _groups():
        rows = ''.join(_markdown_row(description) for description in described)
        head = '| name | default | unit | range | meaning |\n|---|---|---|---|---|\n'
        parts.append(f'## {group}\n\n{GROUPS[group]}\n\n{head}{rows}' if group else head + rows)
    return '\n'.join(parts)


def _markdown_row(description: Description) -> str:
    value = as_yaml(Parameters().names()[description.name])
    cells = [f'`{description.name}`', f'`{value}`', description.unit, description.limits]
    return f'| {" | ".join([*cells, description.text])} |\n'


def _groups() -> list[tuple[str, list[Description]]]:
    """Return the parameters by groups, each once: '' first, with no group, then as in the table."""
    groups: dict[str, list[Description]] = {'': []}
    for description in DESCRIPTIONS:
        # Those of a group need not follow each other, and of a key that is there twice YAML keeps
        # the last one only.
        groups.setdefault(description.name.rpartition('.')[0], []).append(description)
    for group in groups.keys() - {'', *GROUPS}:
        raise ValueError(
            f"the group '{group}' is new: GROUPS of core/parameters.py needs a sentence for it"
        )
    return list(groups.items())


if __name__ == '__main__':
    for path, content in parameter_files().items():
        path.write_text(content)
        print(f'wrote {path.relative_to(REPOSITORY)}')
