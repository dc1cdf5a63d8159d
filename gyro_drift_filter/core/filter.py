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

"""The filter of one gyroscope, as a class."""

import hashlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import zeroed
from gyro_drift_filter.core import commands
from gyro_drift_filter.core.bias.at_rest import HINT_SECONDS
from gyro_drift_filter.core.bias.records import BIAS_RECORD, Hint
from gyro_drift_filter.core.bias.shift import NO_SHIFT, BiasShift
from gyro_drift_filter.core.methods import METHOD_NAMES, METHODS, Method
from gyro_drift_filter.core.parameters import Parameters
from gyro_drift_filter.core.records import FILTER, HISTORY, STATE, WORKSPACE, State
from gyro_drift_filter.core.sample import RESULT, SAMPLE, Result
from gyro_drift_filter.core.settings import settings_of
from gyro_drift_filter.core.step import step_samples
from gyro_drift_filter.errors import GyroDriftFilterError


def layout_of(methods: Sequence[Method]) -> bytes:
    """Return what stands for the fields of a state, and for the numbers in them.

    Other fields, or in another order, may be of the same size; and a new reason of a method moves
    the numbers of others.
    """
    reasons = [sorted(method.reasons.items()) for method in methods]
    return hashlib.sha256(repr((STATE, HISTORY, reasons)).encode()).digest()


_LAYOUT = layout_of(METHODS)  # at the front of a snapshot
_SIZE = STATE.itemsize + HISTORY.itemsize  # of what follows


class Filter:
    """The filter of one gyroscope: three axes, one state.

    Attributes:
        parameters: What the filter was configured with.
        record: (1,) FILTER, for kernels that call `step`.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self.parameters = parameters or Parameters()
        self.record = zeroed(FILTER)
        self.record['settings'] = settings_of(self.parameters)
        self._sample = zeroed(SAMPLE)
        self.set_bias(self.parameters.bias_initial)
        self.reset()

    @property
    def state(self) -> State:
        """The state, live: a view, not a copy."""
        state: State = self.record[0]['state']
        return state

    @property
    def bias_deviation(self) -> NDArray[np.float64]:
        """The standard deviation of the bias at rest by now, (3,) in rad/s.

        By its Kalman filter: `Telemetry` adds its wander, and what rounding leaves in a mean.
        """
        bias = self.state['bias']
        deviation: NDArray[np.float64] = np.sqrt(bias['variance'] + bias['process_noise'])
        return deviation

    @property
    def bias_shift(self) -> BiasShift:
        """The bias in motion less that at rest.

        What gravity has shown in motion of the bias at rest itself is not in it: that is subtracted
        in motion, too, but learned anew after each rest.
        """
        shift, variance = np.empty((2, 3))
        commands.read_shift(self.record, shift, variance)
        return BiasShift(shift.tolist(), np.sqrt(variance).tolist())

    def configure(self, parameters: Parameters) -> None:
        """Take new parameters between two samples; what was learned is kept.

        A part of the model that changes replaces what was learned of it.
        """
        before, self.parameters = self.parameters, parameters
        commands.forget_history(self.record)
        settings = settings_of(parameters)
        commands.prepare_for_settings(self.record, settings)
        self.record['settings'] = settings
        self.record['coefficients']['period'] = 0.0  # the next step derives them anew
        bias = self.state['bias']
        learned = bias['provisional_variance'][0] > 0.0 or bias['corrected'] > 0
        is_initial = bool(np.all(bias['bias'] == before.bias_initial))
        guessed = is_initial and not bias['known'] and not learned
        widened = parameters.bias_turn_on_deviation != before.bias_turn_on_deviation
        if parameters.bias_initial != before.bias_initial or (guessed and widened):
            self.set_bias(parameters.bias_initial)
        old, new = (
            METHODS[METHOD_NAMES.index(method)] for method in (before.method, parameters.method)
        )
        if old.state != new.state:
            commands.take_over(self.record)

    def reset(self) -> None:
        """Forget all samples, counts and what was learned from them, except the bias at rest.

        What `core/rest/` knows of the noise is kept with it; a rest under way begins anew.
        """
        bias = self.record['state']['bias'].view(np.uint8)
        kept = bias.copy()
        for name in ('state', 'history'):
            self.record[name].view(np.uint8)[:] = 0  # numpy assigns records field by field, in 2 ms
        bias[:] = kept
        commands.start_state(self.record)

    def set_bias(
        self,
        bias: Sequence[float],
        deviation: Sequence[float] | None = None,
        shift: BiasShift = NO_SHIFT,
        known: bool = True,
    ) -> None:
        """Start with a bias from elsewhere, and forget what was learned of rest.

        With a deviation, motion replaces it before the first rest only if it contradicts gravity.

        Args:
            bias: (3,) in rad/s.
            deviation: (3,) its standard deviation in rad/s; None where it is a mere guess that the
                first rest replaces, as uncertain as `bias.turn_on_deviation` says.
            shift: Of the bias in motion from that at rest.
            known: False where a rest is asked for all the same, and replaces it.
        """
        commands.forget_history(self.record)
        variance = np.full(3, np.inf) if deviation is None else np.square(deviation)
        fresh, before = np.zeros(1, BIAS_RECORD), self.record['state']['bias']
        for name in ('hint', 'hint_seconds'):
            fresh[name] = before[name]
        self.record['state']['bias'] = fresh
        values = bias, variance, shift.shift, np.square(shift.deviation)
        arrays = (np.array(value, np.float64) for value in values)
        commands.set_bias(self.record, known, *arrays)

    def hint(self, moves: bool) -> None:
        """Take a hint of the robot on whether it moves; it holds for a second."""
        for state in self.state, self.record[0]['history']['state']:
            state['bias']['hint'] = Hint.MOVES if moves else Hint.STANDS
            state['bias']['hint_seconds'] = HINT_SECONDS

    def note_temperature(self, temperature: float) -> None:
        """Take the sensor's temperature in deg C; a change makes the bias uncertain."""
        commands.note_temperature(self.record, float(temperature))

    def calibrate(self) -> None:
        """Take the mean rate of the rest under way for the bias, whatever it was before.

        Raises:
            GyroDriftFilterError: There is no rate yet, the sensor moves, has stood still for less
                than `bias.calibration_time`, or its rate is beyond `bias.max`; the text says so.
        """
        bias, needed = self.state['bias'], self.parameters.bias_calibration_time
        seconds = float(bias['still_seconds'])
        if not self.state['methods']['tracking'].any():
            raise GyroDriftFilterError(
                'no rate has come yet that can be used: is the driver running?'
            )
        if seconds < needed:
            what = (
                f'has stood still for {seconds:.1f} s only'
                if seconds
                else 'moves or has only just stopped'
            )
            raise GyroDriftFilterError(
                f'the sensor {what}: leave it alone for {needed:g} s and try again'
            )
        rates = bias['still_sum'] / bias['still_blocks']
        if (np.abs(rates) > self.parameters.bias_max).any():
            listed = ', '.join(f'{math.degrees(rate):.2f}' for rate in rates)
            limit = math.degrees(self.parameters.bias_max)
            raise GyroDriftFilterError(
                f'the rates at rest, {listed} deg/s, are beyond bias.max, {limit:g} deg/s: does it '
                'turn? Else raise bias.max'
            )
        commands.forget_history(self.record)
        commands.calibrate(self.record)

    def snapshot(self) -> bytes:
        """Return the state; `restore` on a filter of the same parameters continues bit for bit."""
        parts = (self.record[name].tobytes() for name in ('state', 'history'))
        return b''.join((self._head(), *parts))

    def _head(self) -> bytes:
        """Return what a snapshot begins with: the state of another method is not set up."""
        return _LAYOUT + bytes([METHOD_NAMES.index(self.parameters.method)])

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot.

        Raises:
            GyroDriftFilterError: The snapshot is of another version, or of another method.
        """
        head = self._head()
        if not snapshot.startswith(_LAYOUT) or len(snapshot) != len(head) + _SIZE:
            raise GyroDriftFilterError('the snapshot was taken by another version')
        if not snapshot.startswith(head):
            raise GyroDriftFilterError(
                f'the snapshot is of another method than {self.parameters.method}: restore it on a '
                'filter of the same parameters, and then set others with configure'
            )
        start = len(head)
        self.record['state'] = np.frombuffer(snapshot, STATE, 1, start)
        self.record['history'] = np.frombuffer(snapshot, HISTORY, 1, start + STATE.itemsize)
        self.record['workspace'] = np.zeros(1, WORKSPACE)

    def step(self, stamp: int, rate: Sequence[float], acceleration: Sequence[float]) -> Result:
        """Filter one sample.

        Args:
            stamp: Time of the sample in ns; 0 where the driver does not stamp.
            rate: Angular velocity (3,) in rad/s. A NaN or infinity is bridged by the prediction.
            acceleration: Linear acceleration (3,) in m/s^2; NaN where unknown.

        Returns:
            A record of RESULT.

        Raises:
            GyroDriftFilterError: The shapes do not agree.
        """
        if np.shape(rate) != (3,) or np.shape(acceleration) != (3,):
            raise GyroDriftFilterError(
                'rate and acceleration must be of three numbers each, not of shapes '
                f'{np.shape(rate)} and {np.shape(acceleration)}'
            )
        result: Result = self.run(np.array([stamp]), np.array([rate]), np.array([acceleration]))[0]
        return result

    def run(
        self,
        stamps: NDArray[np.int64],
        rates: NDArray[np.float64],
        accelerations: NDArray[np.float64],
    ) -> NDArray[Any]:
        """Filter many samples by a loop over `step`.

        Args:
            stamps: (n,) in ns.
            rates: (n, 3) in rad/s.
            accelerations: (n, 3) in m/s^2.

        Returns:
            An array (n,) of RESULT.

        Raises:
            GyroDriftFilterError: The shapes do not agree.
        """
        stamps = np.ascontiguousarray(stamps, np.int64)
        rates = np.ascontiguousarray(rates, np.float64)
        accelerations = np.ascontiguousarray(accelerations, np.float64)
        n = len(stamps)
        if stamps.shape != (n,) or rates.shape != (n, 3) or accelerations.shape != (n, 3):
            raise GyroDriftFilterError(
                'stamps, rates and accelerations must have shapes (n,), (n, 3), (n, 3), not '
                f'{stamps.shape}, {rates.shape}, {accelerations.shape}'
            )
        results = np.empty(n, RESULT)
        step_samples(stamps, rates, accelerations, self._sample, self.record, results)
        return results
