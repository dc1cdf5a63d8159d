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
    """Filter one axis; return rates, flags, Q and R (n,) each."""
    a = np.array([[1.0, 1.0], [0.0, phi]])
    identity = np.eye(2)
    x = np.array([[z[0]], [0.0]])
    p = np.diag([r0, q0 / (1 - phi**2)])
    q, r = np.zeros((2, 1)), 0.0
    noise_q, noise_r = q0, r0
    rates, flags, qs, rs = [z[0]], [False], [q0], [r0]
    largest = max(abs(z[0]), np.sqrt(r0))
    k = 1  # the first sample has set the state
    for zk in z[1:]:
        k += 1
        qs.append(noise_q)
        rs.append(noise_r)
        x_predicted = a @ x + q  # (7)
        p_predicted = a @ p @ a.T + noise_q * (GAMMA @ GAMMA.T)  # (8)
        s = (H @ p_predicted @ H.T).item() + noise_r
        gain = p_predicted @ H.T / s  # (9)
        predicted = (H @ x_predicted).item()
        j = predicted**2 + s  # (18)
        flag = not (j - epsilon <= zk**2 <= j + epsilon)
        m, size = np.sqrt(j), abs(zk)
        f = 1.0 if not flag or m >= size else m / size  # (19)
        e = f * zk - predicted  # (10), corrected
        x_new = x_predicted + gain * (e - r)  # (11), (20)
        left = identity - gain @ H
        p_new = left @ p_predicted @ left.T + noise_r * (gain @ gain.T)  # (12), Joseph form
        if adaptive:
            d = (1 - b) / (1 - b**k)  # (13)
            r_new = (1 - d) * r + d * e  # (14)
            q = (1 - d) * q + d * (x_new - a @ x)  # (15)
            noise_r = max(
                (1 - d) * noise_r + d * ((e - r_new) ** 2 - (H @ p_predicted @ H.T).item()),  # (16)
                FLOOR * r0,
            )
            inner = gain @ gain.T * (e - r_new) ** 2 + p_new - a @ p @ a.T
            noise_q = max(
                (1 - d) * noise_q + d * (GAMMA.T @ inner @ GAMMA).item(), FLOOR * q0
            )  # (17)
            r = r_new
        x, p = x_new, p_new
        largest = max(largest, abs(zk))
        if abs(x[0, 0]) > DIVERGED * largest:
            k, q, r, noise_q, noise_r = 1, np.zeros((2, 1)), 0.0, q0, r0
            x, p = np.array([[zk], [0.0]]), np.diag([r0, q0 / (1 - phi**2)])
            largest = max(abs(zk), np.sqrt(r0))
        rates.append(x[0, 0] + r)
        flags.append(flag)
    return np.array(rates), np.array(flags), np.array(qs), np.array(rs)
