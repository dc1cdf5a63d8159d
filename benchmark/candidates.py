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

"""What is compared: the package's methods, and what a user would otherwise pick. All causal."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from filterpy.kalman import KalmanFilter
from OneEuroFilter import OneEuroFilter
from scipy import signal

from gyro_drift_filter.arrays import Bools, Floats, Integers
from gyro_drift_filter.core import Filter, Parameters
from gyro_drift_filter.core.methods import METHOD_NAMES


@dataclass(frozen=True)
class Recording:
    """What a filter is given, n samples, and the noise level that a user would have measured.

    Attributes:
        stamps: (n,) in ns.
        rates: (n, 3) in rad/s.
        acceleration: (n, 3) in m/s^2.
        sample_rate: In Hz.
        deviation: Standard deviation of the noise at rest, in rad/s.
    """

    stamps: Integers
    rates: Floats
    acceleration: Floats
    sample_rate: float
    deviation: float


@dataclass(frozen=True)
class Filtered:
    """What a filter returns; `flags` and `normalised` are None where it has no such thing.

    Attributes:
        rates: (n, 3) in rad/s.
        flags: (n, 3), True where a sample was not believed.
        normalised: (n, 3), innovation squared by its predicted variance.
    """

    rates: Floats
    flags: Bools | None = None
    normalised: Floats | None = None


Candidate = Callable[[Recording], Filtered]


def package_method(method: str) -> Candidate:
    """Return one of the package's methods, in its default configuration.

    The paper's filters are given the noise level, as the paper sets Q and R.
    """

    def run(recording: Recording) -> Filtered:
        parameters: dict[str, object] = {'method': method}
        if method in ('kalman', 'sage_husa'):
            variance = recording.deviation**2
            phi = 0.218
            parameters |= {
                'epsilon': 9.0 * variance,
                'model.measurement_noise': 3 * [variance],
                'model.process_noise': 3 * [variance * (1 - phi**2)],
            }
        results = Filter(Parameters.from_names(parameters)).run(
            recording.stamps, recording.rates, recording.acceleration
        )
        return Filtered(
            results['angular_velocity'],
            results['outlier'] > 0,
            results['innovation'] ** 2 / results['innovation_variance'],
        )

    return run


def nothing(recording: Recording) -> Filtered:
    """Pass the raw rates on."""
    return Filtered(recording.rates)


def butterworth(recording: Recording) -> Filtered:
    """Second order, 10 Hz."""
    sections = signal.butter(2, 10.0, fs=recording.sample_rate, output='sos')
    start = signal.sosfilt_zi(sections)[:, :, None] * recording.rates[0]
    return Filtered(signal.sosfilt(sections, recording.rates, axis=0, zi=start)[0])


def _windows(rates: Floats, length: int) -> Floats:
    """Return (n, 3, length): each sample with those before it."""
    padded = np.concatenate([np.repeat(rates[:1], length - 1, axis=0), rates])
    return np.lib.stride_tricks.sliding_window_view(padded, length, axis=0)


def median(recording: Recording) -> Filtered:
    """Of the last five samples."""
    return Filtered(np.median(_windows(recording.rates, 5), axis=2))


def hampel(recording: Recording) -> Filtered:
    """Of the last seven samples: replaced by their median beyond three robust deviations."""
    windows = _windows(recording.rates, 7)
    middle = np.median(windows, axis=2)
    spread = 1.4826 * np.median(np.abs(windows - middle[:, :, None]), axis=2)
    flags = np.abs(recording.rates - middle) > 3 * spread
    return Filtered(np.where(flags, middle, recording.rates), flags)


def one_euro(recording: Recording) -> Filtered:
    """With 1 Hz at rest; the slope is the best compromise between rest and motion found here."""
    out = np.empty_like(recording.rates)
    time = (recording.stamps - recording.stamps[0]) * 1e-9
    for axis in range(3):
        one = OneEuroFilter(recording.sample_rate, mincutoff=1.0, beta=5.0)
        out[:, axis] = [
            one(value, t) for value, t in zip(recording.rates[:, axis], time, strict=True)
        ]
    return Filtered(out)


def filterpy_kalman(recording: Recording) -> Filtered:
    """Filter by a constant-rate Kalman filter: R is the noise level, Q a tenth of it."""
    out = np.empty_like(recording.rates)
    variance = recording.deviation**2
    for axis in range(3):
        kalman = KalmanFilter(dim_x=1, dim_z=1)
        kalman.x[0] = recording.rates[0, axis]
        kalman.F[:] = kalman.H[:] = 1.0
        kalman.P[:], kalman.R[:], kalman.Q[:] = variance, variance, 0.1 * variance
        for k, value in enumerate(recording.rates[:, axis]):
            kalman.predict()
            kalman.update(value)
            out[k, axis] = kalman.x.item()
    return Filtered(out)


CANDIDATES: dict[str, Candidate] = {
    'nothing': nothing,
    'Butterworth 10 Hz': butterworth,
    'median of 5': median,
    'Hampel of 7': hampel,
    'One-Euro': one_euro,
    'filterpy': filterpy_kalman,
} | {method: package_method(method) for method in METHOD_NAMES}
