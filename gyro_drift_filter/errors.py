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

"""The errors that this package raises on purpose, and text from elsewhere made fit to show."""


def printable(text: str) -> str:
    """Return text in one line, without characters that a terminal acts on."""
    return ''.join(c if c.isprintable() else '\ufffd' for c in ' '.join(text.split()))


def reason(error: BaseException) -> str:
    """Return the text of an error in one line, or its name where it has no text."""
    if isinstance(error, OSError) and error.strerror and error.filename is None:
        return printable(error.strerror)  # without the number of the error
    return printable(str(error)) or type(error).__name__


def yaml_reason(error: Exception) -> str:
    """Return where a text is no YAML and why, in one line, as far as the parser's error says it."""
    mark, problem = getattr(error, 'problem_mark', None), getattr(error, 'problem', None)
    if mark is None or not problem:
        return reason(error)
    return printable(f'line {mark.line + 1}, column {mark.column + 1}: {problem}')


class GyroDriftFilterError(Exception):
    """A known error: its text is one line that says what is wrong and what to do."""

    def __str__(self) -> str:
        """Return the text; names from files and messages may be in it."""
        return printable(super().__str__())


class ParameterError(GyroDriftFilterError):
    """A parameter has a wrong name, type or value."""
