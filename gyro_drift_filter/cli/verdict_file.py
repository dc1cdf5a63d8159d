"""Verdicts for programs, as JSON in SI units; `report/verdict.py` says what each figure is."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.result_files import as_plain

if TYPE_CHECKING:
    from gyro_drift_filter.report.verdict import Verdict


def as_json(bags: Iterable[tuple[Path, Iterable['Verdict']]]) -> str:
    """Return the verdicts on the Imu topics of bags; what is not known is null."""
    plain = [
        {'bag': str(bag), **as_plain(verdict)} for bag, verdicts in bags for verdict in verdicts
    ]
    return json.dumps({'verdicts': plain}, indent=1, allow_nan=False) + '\n'
