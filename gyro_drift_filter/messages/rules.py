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

"""What a rule of `/diagnostics` is, which rules apply, and what many of them ask.

The rules themselves stand in two tables, in `input_rules` and `filter_rules`; `health` applies
both. The first rule of a table that applies gives the level and the message of the status. So the
worst comes first, and what says more comes before what says less. A message stays the same as long
as its cause does, because each change of it is logged; numbers stand in the values.
"""

from collections.abc import Callable, Sequence, Set
from operator import gt
from typing import NamedTuple

from gyro_drift_filter.messages.diagnostics import Level
from gyro_drift_filter.messages.span import Span


class Rule(NamedTuple):
    """A level and a message, and when they apply.

    Attributes:
        name: No two rules have the same, in both tables.
        applies: Says whether the rule applies; None leaves that as it was at the last report.
        text: The message, or what makes it.
        level: The level of the status.
    """

    name: str
    applies: Callable[[Span], bool | None]
    text: str | Callable[[Span], str]
    level: Level = Level.WARN

    def message(self, span: Span) -> str:
        """Return what the rule says of a span."""
        return self.text if isinstance(self.text, str) else self.text(span)


def applying(rules: Sequence[Rule], span: Span, before: Set[str]) -> list[Rule]:
    """Return the rules of a table that apply to a span, the worst first.

    `before` are the names of those that applied to the last report.
    """
    found = []
    for rule in rules:
        applies = rule.applies(span)
        if rule.name in before if applies is None else applies:
            found.append(rule)
    return found


def beyond(
    value: Callable[[Span], float], raised_at: float, cleared_at: float
) -> Callable[[Span], bool | None]:
    """Return when an alarm stands: raised above one limit, taken back below another, lower one.

    Between them, and where the value is NaN, it stays as it is, so that it does not flicker.
    """

    def applies(span: Span) -> bool | None:
        now = value(span)
        return True if now > raised_at else False if now < cleared_at else None

    return applies


def increase(span: Span, name: str) -> int:
    """Return by how much a count has grown since the last report."""
    return int(getattr(span.now.telemetry, name) - getattr(span.before.telemetry, name))


def in_window(span: Span, name: str) -> int:
    """Return by how much a count has grown since the start of the window."""
    return int(getattr(span.now.telemetry, name) - getattr(span.first.telemetry, name))


def has_grown(span: Span, name: str) -> bool:
    """Return whether a count has grown since the last report, on any axis."""
    now, before = getattr(span.now.telemetry, name), getattr(span.before.telemetry, name)
    return now != before and any(map(gt, now, before))
