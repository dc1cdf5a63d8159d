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

"""Records and how they lie in memory, and denormal numbers that would make them slow."""

from collections.abc import Sequence
from typing import Annotated, TypedDict

import numpy as np
import pytest
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import PerAxis, record, zeroed
from gyro_drift_filter.accelerate.records import CACHE_LINE
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES
from gyro_drift_filter.core.records import COEFFICIENTS, FILTER, STATE


class Inner(TypedDict):
    number: int
    flag: bool


INNER = record(Inner)


class Outer(TypedDict):
    flag: bool
    line: Annotated[NDArray[np.float64], np.float64, (8,)]
    number: int
    axes: PerAxis
    two_lines: Annotated[NDArray[np.float64], np.float64, (4, 4)]
    inner: Inner
    several: Annotated[Sequence[Inner], INNER, (2,)]
    last: float


KINDS = {
    'flag': np.dtype(np.bool_),
    'line': np.dtype((np.float64, (8,))),
    'number': np.dtype(np.int64),
    'axes': np.dtype((np.float64, (3,))),
    'two_lines': np.dtype((np.float64, (4, 4))),
    'inner': INNER,
    'several': np.dtype((INNER, (2,))),
    'last': np.dtype(np.float64),
}


def field_of(made, name):
    """Return type and offset of a field."""
    kind, offset, *_ = made.fields[name]
    return kind, offset


@pytest.mark.parametrize('in_cache_lines', [True, False])
def test_a_record_has_the_fields_that_were_declared_and_none_overlap(in_cache_lines):
    made = record(Outer, in_cache_lines=in_cache_lines)
    assert {name: field_of(made, name)[0] for name in made.names} == KINDS
    taken = np.zeros(made.itemsize, int)
    for field, offset in (field_of(made, name) for name in made.names):
        assert offset % field.base.alignment == 0
        taken[offset : offset + field.itemsize] += 1
    assert taken.max() == 1
    if in_cache_lines:
        assert made.itemsize % CACHE_LINE == 0
        for name in ('line', 'two_lines'):
            assert field_of(made, name)[1] % CACHE_LINE == 0


@pytest.mark.parametrize('kind', [STATE, COEFFICIENTS, FILTER])
def test_a_record_starts_at_a_cache_line(kind):
    for _ in range(20):
        made = zeroed(kind)
        assert made.shape == (1,)
        assert made.dtype == kind
        assert made.ctypes.data % CACHE_LINE == 0
        assert not made.view(np.uint8).any()


def test_the_parts_of_a_filter_start_at_cache_lines():
    for name in ('coefficients', 'state', 'workspace'):
        assert field_of(FILTER, name)[1] % CACHE_LINE == 0


def floats(record):
    """Return all floating-point numbers of a record, those of records in it among them."""
    if record.dtype.names is None:
        return [record.ravel()] if record.dtype.kind == 'f' else []
    return [part for name in record.dtype.names for part in floats(record[name])]


@pytest.mark.parametrize('method', METHOD_NAMES)
def test_no_number_of_a_filter_becomes_denormal(method, random):
    """Processors take many times as long for them; every sum that fades away would."""
    n = 90_000
    rates = 0.002 * random.standard_normal((n, 3))
    rates[1000, :] += 1.0  # an outlier
    accelerations = np.tile([0.0, 0.0, 9.81], (n, 1)) + 0.02 * random.standard_normal((n, 3))
    accelerations[1000:1003] += 60.0  # and a knock: what was held back is given back
    filter_ = Filter(Parameters(method=method))
    filter_.run(10**18 + 10_000_000 * np.arange(n), rates, accelerations)
    numbers = np.abs(np.concatenate(floats(filter_.record[0])))
    assert len(numbers) > 1000
    tiny = numbers[(numbers > 0.0) & (numbers < np.finfo(float).tiny)]
    assert len(tiny) == 0
