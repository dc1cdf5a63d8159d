"""Verdicts for programs, as JSON in SI units; `report/verdict.py` says what each figure is."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from gyro_drift_filter.cli.result_files import as_plain

if TYPE_CHECKING:
    from gyro_drift_filter.report.verdict import Verdict


def as_json(bag: Path, verdicts: Sequence['Verdict']) -> str:
    """Return the verdicts on the Imu topics of a bag; what is not known is null."""
    plain = {'bag': str(bag), 'verdicts': as_plain(verdicts)}
    return json.dumps(plain, indent=1, allow_nan=False) + '\n'
