"""A minute of fuzzing, other inputs each day, and all that it has found so far."""

import datetime

import pytest

from support.fuzz import CORPUS, TARGETS, check, fuzz

pytestmark = pytest.mark.slow

INPUTS = {'cdr': 6000, 'mcap': 2000, 'recovery': 1500, 'parameters': 1000, 'memory': 6000}
KEPT = sorted(path for path in CORPUS.glob('*/*') if path.is_file())


@pytest.mark.parametrize('path', KEPT, ids=lambda path: f'{path.parent.name}/{path.name}')
def test_what_was_found_before(path, tmp_path):
    check(path.parent.name, path.read_bytes(), tmp_path)


@pytest.mark.parametrize('name', TARGETS)
def test_inputs_that_nobody_meant(name):
    fuzz(name, INPUTS[name], 1000 * datetime.date.today().toordinal())
