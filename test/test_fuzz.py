"""Some fuzzing, other inputs each day, and all that it has found so far."""

import datetime

import pytest

from support.fuzz import CORPUS, TARGETS, check, fuzz

pytestmark = pytest.mark.slow

INPUTS = {'cdr': 30_000, 'mcap': 6000, 'recovery': 2000, 'parameters': 1500, 'memory': 12_000}
KEPT = sorted(path for path in CORPUS.glob('*/*') if path.is_file())


@pytest.mark.parametrize('path', KEPT, ids=lambda path: f'{path.parent.name}/{path.name}')
def test_what_was_found_before(path, tmp_path):
    check(path.parent.name, path.read_bytes(), tmp_path)


@pytest.mark.parametrize('name', TARGETS)
def test_inputs_that_nobody_meant(name):
    fuzz(name, INPUTS[name], datetime.date.today().toordinal())
