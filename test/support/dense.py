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

"""The paper's equations in plain numpy matrices, transcribed apart from the package.

Nothing is shared with it but the safeguards that its documentation names.
"""

import numpy as np

H = np.array([[1.0, 0.0]])
GAMMA = np.array([[0.0], [1.0]])
FLOOR = 1e-3
DIVERGED = 10.0


def dense_filter(z, phi, q0, r0, *, adaptive, b, epsilon):
    """Filter rates (n, axes) with phi, q0 and r0 (axes,); return rates, flags, Q and R (n, axes).

    Many axes take hardly longer than one, as the matrices are so small.
    """
    phi, q0, r0 = (np.array(values, float) for values in (phi, q0, r0))
    a = np.ones((len(phi), 2, 2))
    a[:, 1, 0], a[:, 1, 1] = 0.0, phi
    identity, a_transposed = np.eye(2), transposed(a)

    def start(zk):
        x, p = np.zeros((len(phi), 2, 1)), np.zeros((len(phi), 2, 2))
        x[:, 0, 0], p[:, 0, 0], p[:, 1, 1] = zk, r0, q0 / (1 - phi**2)
        largest = np.maximum(abs(zk), np.sqrt(r0))
        return x, p, np.zeros_like(x), np.zeros_like(phi), q0, r0, np.ones_like(phi), largest

    x, p, q, r, noise_q, noise_r, k, largest = start(z[0])
    rates, flags, qs, rs = [z[0]], [np.zeros(len(phi), bool)], [q0], [r0]
    for zk in z[1:]:
        k = k + 1  # the first sample has set the state
        qs.append(noise_q)
        rs.append(noise_r)
        x_predicted = a @ x + q  # (7)
        p_predicted = a @ p @ a_transposed + matrices(noise_q) * (GAMMA @ GAMMA.T)  # (8)
        s = scalars(H @ p_predicted @ H.T) + noise_r
        gain = p_predicted @ H.T / matrices(s)  # (9)
        gain_square = gain @ transposed(gain)
        predicted = scalars(H @ x_predicted)
        j = predicted**2 + s  # (18)
        flag = ~((j - epsilon <= zk**2) & (zk**2 <= j + epsilon))
        m, size = np.sqrt(j), abs(zk)
        f = np.divide(m, size, out=np.ones_like(m), where=flag & (m < size))  # (19)
        e = f * zk - predicted  # (10), corrected
        x_new = x_predicted + gain * matrices(e - r)  # (11), (20)
        left = identity - gain @ H
        # (12), Joseph form
        p_new = left @ p_predicted @ transposed(left) + matrices(noise_r) * gain_square
        if adaptive:
            d = (1 - b) / (1 - b**k)  # (13)
            r_new = (1 - d) * r + d * e  # (14)
            q = matrices(1 - d) * q + matrices(d) * (x_new - a @ x)  # (15)
            square = (e - r_new) ** 2
            noise_r = np.maximum(
                (1 - d) * noise_r + d * (square - scalars(H @ p_predicted @ H.T)),  # (16)
                FLOOR * r0,
            )
            inner = gain_square * matrices(square) + p_new - a @ p @ a_transposed
            noise_q = np.maximum(
                (1 - d) * noise_q + d * scalars(GAMMA.T @ inner @ GAMMA), FLOOR * q0
            )  # (17)
            r = r_new
        x, p = x_new, p_new
        largest = np.maximum(largest, size)
        off = abs(x[:, 0, 0]) > DIVERGED * largest
        if off.any():
            now = x, p, q, r, noise_q, noise_r, k, largest
            x, p, q, r, noise_q, noise_r, k, largest = (
                np.where(off if old.ndim == 1 else matrices(off), new, old)
                for new, old in zip(start(zk), now, strict=True)
            )
        rates.append(x[:, 0, 0] + r)
        flags.append(flag)
    return np.array(rates), np.array(flags), np.array(qs), np.array(rs)


def matrices(values):
    """Return values (axes,) as matrices (axes, 1, 1)."""
    return values[:, None, None]


def scalars(of_one):
    """Return the only element of each matrix (axes, 1, 1)."""
    return of_one[:, 0, 0]


def transposed(many):
    """Return each matrix (axes, m, n) as one of (n, m)."""
    return many.swapaxes(1, 2)
