"""What an examination says: one line each, with a verdict."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any


class Verdict(StrEnum):
    """How a line ends the question that it answers."""

    SOUND = 'sound'
    FAULT = 'fault'
    UNKNOWN = 'unknown'  # the recording does not hold what would tell


@dataclass(frozen=True)
class Finding:
    """One line of the page.

    Attributes:
        name: What was looked at, its own among all lines of one verdict.
        verdict: What came of it.
        text: What was found, with figures.
        advice: What to do about it; empty where there is nothing to be done.
        values: The figures by their names, for programs.
    """

    name: str
    verdict: Verdict
    text: str
    advice: str = ''
    values: dict[str, Any] = field(default_factory=dict)


def is_sound(findings: Sequence[Finding]) -> bool:
    """Tell whether there is no fault among the findings."""
    return all(finding.verdict != Verdict.FAULT for finding in findings)
