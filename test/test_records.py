"""Records by cache lines, and numbers next to zero that would make them slow all the same."""

import numpy as np
import pytest

from gyro_drift_filter.accelerate.records import CACHE_LINE, in_lines, zeroed
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.filter import COEFFICIENTS, STATE

FIELDS = [
    ('flag', np.bool_),
    ('line', np.float64, (8,)),
    ('number', np.int64),
    ('three', np.float64, (3,)),
    ('two_lines', np.float64, (4, 4)),
    ('last', np.bool_),
]


def test_fields_of_whole_lines_begin_with_one_and_none_overlap():
    record = in_lines(FIELDS)
    assert set(record.names) == {name for name, *_ in FIELDS}
    assert record.itemsize % CACHE_LINE == 0
    taken = np.zeros(record.itemsize, int)
    for name, kind, *shape in FIELDS:
        field, offset = record.fields[name]
        assert field == np.dtype((kind, *shape)) if shape else field == np.dtype(kind)
        assert (
            offset % (CACHE_LINE if field.itemsize % CACHE_LINE == 0 else field.base.itemsize) == 0
        )
        taken[offset : offset + field.itemsize] += 1
    assert taken.max() == 1


@pytest.mark.parametrize('kind', [STATE, COEFFICIENTS, in_lines(FIELDS)])
def test_a_record_begins_with_a_line(kind):
    for _ in range(20):
        record = zeroed(kind)
        assert record.shape == (1,)
        assert record.dtype == kind
        assert record.ctypes.data % CACHE_LINE == 0
        assert not record.view(np.uint8).any()


def floats(record):
    """Return all floating-point numbers of a record, those of records in it among them."""
    if record.dtype.names is None:
        return [record.ravel()] if record.dtype.kind == 'f' else []
    return [part for name in record.dtype.names for part in floats(record[name])]


@pytest.mark.parametrize('method', ['kalman', 'sage_husa', 'adaptive'])
def test_no_number_of_the_state_comes_next_to_zero(method, random):
    """Processors take many times as long for them; every sum that fades away would."""
    n = 90_000
    rates = 0.002 * random.standard_normal((n, 3))
    rates[1000, :] += 1.0  # an outlier
    accelerations = np.tile([0.0, 0.0, 9.81], (n, 1)) + 0.02 * random.standard_normal((n, 3))
    accelerations[1000:1003] += 60.0  # and a knock: what was held back is made up for
    filter_ = Filter(Parameters(method=method))
    filter_.run(10**18 + 10_000_000 * np.arange(n), rates, accelerations)
    numbers = np.abs(np.concatenate(floats(filter_.state)))
    assert len(numbers) > 1000
    tiny = numbers[(numbers > 0.0) & (numbers < np.finfo(float).tiny)]
    assert len(tiny) == 0
