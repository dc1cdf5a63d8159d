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

"""Write docs/commands.md from the parser of `gyro_drift` and the usage of the node.

Run it by `make commands` after a change of an option; a test fails where the page is not what this
writes.
"""

import argparse
from pathlib import Path

from gyro_drift_filter.cli.command import parser
from gyro_drift_filter.ros.arguments import USAGE

PAGE = Path(__file__).parent.parent / 'docs' / 'commands.md'

_HEAD = """\
# Commands

<!-- `make commands` writes this from gyro_drift_filter/cli/ and ros/arguments.py: change those. -->

Two executables come with the package: `gyro_drift` works on bags, `gyro_drift_filter_node` on a
running robot. This page is made from their own help.

`gyro_drift` ends with one of these statuses:

| status | meaning |
|---|---|
| 0 | done |
| 1 | an error, explained in one line on the standard error; some values out of range, too; \
without a line, the reader of the output has left before its end, as `head` may |
| 2 | an option that does not exist, is missing, comes too often, or can not have that value |
| 3 | `doctor` has found a fault in the recording; `calibrate` does not know all entries well |
| 130 | interrupted by Ctrl-C |
| 128 and the number of a signal | ended by that signal |
"""
_NODE = """\
## gyro_drift_filter_node

The node that filters while the robot runs. Its topics and services: [topics.md](topics.md). Its
parameters: [parameters.md](parameters.md).

```text
{}```
"""


def command_page() -> str:
    """Return the content of docs/commands.md."""
    sections = [_section(name, command) for name, command in _subcommands(parser()).items()]
    return '\n'.join([_HEAD, *sections, _NODE.format(USAGE)])


def _subcommands(command: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    for action in command._actions:
        if isinstance(action, argparse._SubParsersAction):
            return dict(action.choices)
    return {}


def _section(name: str, command: argparse.ArgumentParser) -> str:
    rows = ''.join(
        f'| {_named(action)} | {_text(action)} |\n'
        for action in command._actions
        if not isinstance(action, argparse._HelpAction)
    )
    table = f'\n\n| argument | meaning |\n|---|---|\n{rows}' if rows else '\n'
    return f'## gyro_drift {name}\n\n{command.description}{table}'


def _named(action: argparse.Action) -> str:
    """Return an argument as one types it."""
    value = action.metavar if isinstance(action.metavar, str) else action.dest.upper()
    if action.nargs in ('+', '*'):
        value = f'{value} ...'
    if action.nargs == '?':
        value = f'[{value}]'
    if not action.option_strings:
        return f'`{value}`'
    names = ', '.join(action.option_strings)
    return f'`{names}`' if action.nargs == 0 else f'`{names} {value}`'


def _text(action: argparse.Action) -> str:
    """Return the help of an argument, its default filled in, as a cell of a table."""
    text = (action.help or '') % (vars(action) | {'prog': 'gyro_drift'})
    if action.choices and not all(str(choice) in text for choice in action.choices):
        text = f'{text}: {", ".join(map(str, action.choices))}'
    needed = ' (needed)' if action.required and action.option_strings else ''
    return f'{text}{needed}'.replace('|', '\\|')


if __name__ == '__main__':
    PAGE.write_text(command_page())
    print(f'wrote {PAGE.relative_to(PAGE.parent.parent)}')
