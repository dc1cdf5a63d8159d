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

"""What an examination says: one line each, with a verdict."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class FindingVerdict(StrEnum):
    """How a line ends the question that it answers."""

    SOUND = 'sound'
    FAULT = 'fault'
    UNKNOWN = 'unknown'  # the recording does not hold what would tell


@dataclass(frozen=True)
class Finding:
    """One line of the page.

    Attributes:
        name: What was looked at; no two lines of one verdict have the same.
        verdict: What came of it.
        text: What was found, with figures.
        advice: What to do about it; empty where there is nothing to be done.
        values: The figures by their names, for programs.
    """

    name: str
    verdict: FindingVerdict
    text: str
    advice: str = ''
    values: dict[str, Any] = field(default_factory=dict)

    @property
    def is_fault(self) -> bool:
        """Whether it is a fault."""
        return self.verdict == FindingVerdict.FAULT


def fault(name: str, text: str, advice: str, values: dict[str, Any] | None = None) -> Finding:
    """Return the line of a fault."""
    return Finding(name, FindingVerdict.FAULT, text, advice, values or {})


def sound(name: str, text: str, values: dict[str, Any] | None = None) -> Finding:
    """Return the line of a question that ends well."""
    return Finding(name, FindingVerdict.SOUND, text, values=values or {})


def unknown(
    name: str, text: str, advice: str = '', values: dict[str, Any] | None = None
) -> Finding:
    """Return the line of a question that the recording leaves open."""
    return Finding(name, FindingVerdict.UNKNOWN, text, advice, values or {})
