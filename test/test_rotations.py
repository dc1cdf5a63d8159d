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

"""Many rotations at once: the same as scipy's, one by one."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gyro_drift_filter.rotations import (
    from_vectors,
    inverse,
    multiply,
    rotate,
    running_products,
    to_vectors,
)


def test_they_are_those_of_scipy(random):
    vectors, points = random.uniform(-1.7, 1.7, (2, 50, 3))
    vectors[0] = 0.0
    theirs, ours = Rotation.from_rotvec(vectors), from_vectors(vectors)
    np.testing.assert_allclose(ours, theirs.as_quat(), atol=1e-14)
    np.testing.assert_allclose(to_vectors(-ours), vectors, atol=1e-13)
    np.testing.assert_allclose(rotate(ours, points), theirs.apply(points), atol=1e-13)
    both = multiply(inverse(ours[:-1]), ours[1:])
    expected = theirs[:-1].inv() * theirs[1:]
    np.testing.assert_allclose(to_vectors(both), expected.as_rotvec(), atol=1e-13)


@pytest.mark.parametrize('n', [0, 1, 2, 7, 8])
def test_running_products(random, n):
    turns = from_vectors(random.standard_normal((2, n, 3)))
    found, before = running_products(turns), np.array([0.0, 0.0, 0.0, 1.0])
    assert found.shape == turns.shape
    for k in range(n):
        before = multiply(before, turns[:, k])
        np.testing.assert_allclose(found[:, k], before, atol=1e-14)
