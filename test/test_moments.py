"""Mean and deviation of the table that `replay` prints."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gyro_drift_filter.bags.moments import Moments

RATES = st.one_of(
    st.floats(-1e3, 1e3), st.just(np.nan), st.just(np.inf), st.just(-np.inf), st.just(2e6)
)


@given(st.lists(st.tuples(RATES, RATES, RATES), max_size=30), st.integers(0, 30))
def test_as_numpy_has_them_however_the_samples_are_cut(rows, cut):
    raw = np.array(rows, float).reshape(-1, 3)
    values = 0.5 * np.nan_to_num(raw, posinf=0.0, neginf=0.0) - 1.0
    at_once, in_two = Moments(), Moments()
    at_once.add(raw, values)
    in_two.add(raw[:cut], values[:cut])
    in_two.add(raw[cut:], values[cut:])
    found = at_once.statistics()
    np.testing.assert_array_equal(in_two.statistics().mean, found.mean)
    np.testing.assert_array_equal(in_two.statistics().deviation, found.deviation)
    usable = values[(np.abs(raw) <= 1e6).all(axis=1)]
    if len(usable) == 0:
        assert np.isnan(found.mean).all()
        assert np.isnan(found.deviation).all()
        return
    np.testing.assert_allclose(found.mean, usable.mean(axis=0), rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(found.deviation, usable.std(axis=0), rtol=1e-6, atol=1e-6)
