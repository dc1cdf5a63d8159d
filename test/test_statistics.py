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

"""Mean and deviation of the table that `replay` prints."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from gyro_drift_filter.bags.statistics import RateStatistics
from gyro_drift_filter.messages.imu import IMU

RATES = st.one_of(
    st.floats(-1e3, 1e3), st.just(np.nan), st.just(np.inf), st.just(-np.inf), st.just(2e6)
)


@settings(deadline=None)  # the first one may compile
@given(st.lists(st.tuples(RATES, RATES, RATES), max_size=30), st.integers(0, 30))
def test_as_numpy_has_them_however_the_samples_are_cut(rows, cut):
    raw = np.array(rows, float).reshape(-1, 3)
    filtered = 0.5 * np.nan_to_num(raw, posinf=0.0, neginf=0.0) - 1.0
    imus = np.zeros(len(raw), IMU)
    imus['sample']['angular_velocity'] = raw
    imus['result']['angular_velocity'] = filtered
    at_once, in_two = RateStatistics(), RateStatistics()
    times = np.arange(len(imus))
    at_once.add(imus, times)
    in_two.add(imus[:cut], times[:cut])
    in_two.add(imus[cut:], times[cut:])
    usable = (np.abs(raw) <= 1e6).all(axis=1)
    for found, parted, rates in zip(
        at_once.rates(), in_two.rates(), (raw[usable], filtered[usable]), strict=True
    ):
        np.testing.assert_array_equal(parted.mean, found.mean)
        np.testing.assert_array_equal(parted.deviation, found.deviation)
        if len(rates) == 0:
            assert np.isnan(found.mean).all()
            assert np.isnan(found.deviation).all()
            continue
        np.testing.assert_allclose(found.mean, rates.mean(axis=0), rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(found.deviation, rates.std(axis=0), rtol=1e-6, atol=1e-6)
