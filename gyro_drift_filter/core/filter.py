"""One step of the filter for all three axes, and the class that holds its state."""

import hashlib
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.accelerate import entry_kernel, kernel, read_only
from gyro_drift_filter.accelerate.records import in_lines, zeroed
from gyro_drift_filter.core.bias import (
    BIAS,
    HINT_SECONDS,
    MOVES,
    STANDS,
    bias_deviation,
    bias_variance,
    calibrate_bias,
    leave_rest,
    start_bias,
    track_bias,
    warm_bias,
)
from gyro_drift_filter.core.clock import CLOCK, RESTART, advance_clock, period_of, start_clock
from gyro_drift_filter.core.methods.adaptive import (
    ADAPTIVE_COEFFICIENTS,
    ADAPTIVE_STATE,
    believe_all_levels,
    derive_adaptive,
    estimate_adaptive,
    jolts,
    make_up,
    miss_adaptive,
    predict_adaptive,
    rescale_adaptive,
    start_adaptive,
    surprises,
    update_adaptive,
)
from gyro_drift_filter.core.methods.noise import start_noise
from gyro_drift_filter.core.methods.paper import (
    PAPER_COEFFICIENTS,
    PAPER_STATE,
    bridge_paper,
    derive_paper,
    paper_noise,
    paper_rate,
    predict_paper,
    start_paper,
    update_paper,
)
from gyro_drift_filter.core.parameters import METHODS, Parameters
from gyro_drift_filter.core.rest import LENGTHS, derive_lengths
from gyro_drift_filter.errors import GyroDriftFilterError

SAGE_HUSA = METHODS.index('sage_husa')
ADAPTIVE = METHODS.index('adaptive')

# A rate beyond this is no rate: 50,000 times what the fastest gyroscopes measure, in rad/s.
LARGEST_RATE = 1.0e6

# 2,000 deg/s, the range of the fastest common gyroscopes, in rad/s.
RANGE = 35.0

# A sensor whose values all stay the same for so long is stuck, in s: drivers repeat the last ones
# when the bus hangs. From so many equal samples on it tells nothing of the bias.
STUCK_SECONDS = 1.0
STUCK_SAMPLES = 20
# A rate that is the same so many times is the end of the range, where the one before was so many
# steps of the resolution off, as at the top of a turn it is not, and none that was stopped at like
# this was faster. The smallest range is above this, in rad/s.
CLIPPED_RATE = 2.0
CLIPPED_STEPS = 10.0
CLIPPED_SAMPLES = 3

# A method takes over from another's output where that is so many deviations from the last sample.
NEAR = 4.0

# Of a sample in the sum: a start of motion may be any number.
LARGEST_NIS = 100.0

# The bias walks no further than in this time, whatever the stamps say, in s.
LONGEST_ABSENCE = 86_400.0

# What became of a sample.
FILTERED = 0
REPEATED = 1  # same stamp and same rates as the sample before: its result once more
REFUSED = 2  # no usable rate yet on some axis, so there is no result

_AXES = (3,)

MODEL = np.dtype(
    [
        ('phi', np.float64),
        ('process_noise', np.float64),  # (rad/s)^2
        ('measurement_noise', np.float64),  # (rad/s)^2
        ('noise_deviation', np.float64),  # rad/s, 0 where it is to be learned
    ]
)

SETTINGS = np.dtype(
    [
        ('method', np.int64),
        ('forgetting_factor', np.float64),
        ('outlier_enabled', np.bool_),
        ('epsilon', np.float64),  # (rad/s)^2
        ('outlier_threshold', np.float64),  # predicted standard deviations
        ('outlier_acceleration', np.float64),  # rad/s^2
        ('outlier_run', np.int64),  # samples
        ('sample_rate', np.float64),  # Hz
        ('gap_limit', np.float64),  # s
        ('bias_enabled', np.bool_),
        ('bias_max', np.float64),  # rad/s
        ('bias_random_walk', np.float64),  # rad/s/sqrt(s)
        ('bias_calibration_time', np.float64),  # s
        ('model', MODEL, _AXES),
    ],
    align=True,
)

COEFFICIENTS = in_lines(
    [
        ('period', np.float64),  # s, that the others were derived for
        ('paper', PAPER_COEFFICIENTS, _AXES),
        ('adaptive', ADAPTIVE_COEFFICIENTS),
        ('rest', LENGTHS),
    ],
)

COUNTS = np.dtype(
    [
        ('samples', np.int64),
        ('repeats', np.int64),
        ('refused', np.int64),
        ('beyond_range', np.int64),  # samples that no gyroscope measures: degrees, not radians?
        ('stuck', np.int64),  # times that all values stayed the same for `STUCK_SECONDS`
        ('clipped', np.int64, _AXES),
        # Normalised innovation squared of the samples that were believed: sum and number.
        ('nis_sum', np.float64, _AXES),
        ('nis_samples', np.int64, _AXES),
        ('unusable', np.int64, _AXES),
        ('outliers', np.int64, _AXES),
    ],
    align=True,
)

RESULT = np.dtype(
    [
        ('status', np.int64),
        ('angular_velocity', np.float64, _AXES),  # filtered, the bias taken off, rad/s
        ('angular_velocity_variance', np.float64, _AXES),  # (rad/s)^2
        ('innovation', np.float64, _AXES),  # rad/s
        ('innovation_variance', np.float64, _AXES),  # (rad/s)^2, fixed before the sample is seen
        ('process_noise', np.float64, _AXES),  # Q, (rad/s)^2
        ('measurement_noise', np.float64, _AXES),  # R, (rad/s)^2
        ('outlier', np.float64, _AXES),  # 0 or 1
        ('bias', np.float64, _AXES),  # subtracted from the rate, rad/s
        ('at_rest', np.float64),  # 0 or 1
    ],
    align=True,
)

# One record: references to rows of arrays would be counted, at the price of a lock each time.
SAMPLE = np.dtype(
    [
        ('stamp', np.int64),  # ns; 0 where the driver does not stamp
        ('angular_velocity', np.float64, _AXES),  # rad/s; what is no number is bridged
        ('linear_acceleration', np.float64, _AXES),  # m/s^2; NaN where unknown
    ]
)

STATE = in_lines(
    [
        ('clock', CLOCK),
        ('counts', COUNTS),
        ('measured', np.float64, _AXES),  # angular velocity of the last sample as it came, rad/s
        ('acceleration', np.float64, _AXES),  # m/s^2, of the last sample
        ('equal', np.int64, _AXES),  # how often the rate has come before in a row
        ('largest', np.float64, _AXES),  # |rate| of those that were stopped at, rad/s
        ('entered', np.float64, _AXES),  # last change of the rate, rad/s
        ('resolution', np.float64, _AXES),  # smallest change of it, rad/s; 0 before the first
        ('equal_all', np.int64),  # how often all rates and accelerations have
        ('stuck', np.bool_),  # and that for `STUCK_SECONDS`
        ('bridged', np.int64, _AXES),  # unusable samples in a row
        ('paper', PAPER_STATE, _AXES),
        ('adaptive', ADAPTIVE_STATE, _AXES),
        ('bias', BIAS),
        ('result', RESULT),  # of the last sample
    ],
)


# In front of a snapshot: other fields, or in another order, may be of the same size.
_LAYOUT = hashlib.sha256(repr(STATE).encode()).digest()


@kernel
def step(sample: Any, settings: Any, coefficients: Any, state: Any) -> bool:
    """Take one sample in and leave its result in `state`.

    Arguments: records of SAMPLE, SETTINGS, COEFFICIENTS and STATE. Live and offline both come
    through here.

    Returns:
        Whether the sample period is another one now: the coefficients have to be derived before
        the next sample.
    """
    counts, clock, result = state['counts'], state['clock'], state['result']
    stamp, rate = sample['stamp'], sample['angular_velocity']
    counts['samples'] += 1
    if _is_repeat(stamp, rate, state):
        counts['repeats'] += 1
        if result['status'] == FILTERED:
            result['status'] = REPEATED
        return False
    elapsed = _elapsed(clock, stamp)
    missing = advance_clock(clock, stamp, settings['sample_rate'], settings['gap_limit'])
    result['status'] = FILTERED
    _note_equal(sample, state)
    _stop_bridging(rate, missing, settings['gap_limit'], state)
    if settings['method'] == ADAPTIVE:
        _step_adaptive(sample, missing, settings, coefficients['adaptive'], state)
    else:
        _step_paper(sample, missing, settings, coefficients['paper'], state)
    _take_bias_off(sample, elapsed, missing, settings, coefficients['rest'], state)
    if result['status'] == REFUSED:
        counts['refused'] += 1
    else:
        _count_result(settings['method'] == ADAPTIVE, state)
    if not (abs(rate[0]) <= RANGE and abs(rate[1]) <= RANGE and abs(rate[2]) <= RANGE):
        _count_unlikely(rate, counts)
    if clock['period'] == coefficients['period']:
        return False
    for axis in range(3):
        rescale_adaptive(state['adaptive'][axis], clock['period'] / coefficients['period'])
    return True


@kernel
def _count_unlikely(rate: Any, counts: Any) -> None:
    """Count rates (3,) of which one is NaN or beyond what gyroscopes measure."""
    beyond = False
    for axis in range(3):
        if not _usable(rate[axis]):
            counts['unusable'][axis] += 1
        if abs(rate[axis]) > RANGE:
            beyond = True
    if beyond:
        counts['beyond_range'] += 1


@kernel
def _count_result(adaptive: bool, state: Any) -> None:
    counts, result = state['counts'], state['result']
    for axis in range(3):
        if result['outlier'][axis] > 0.0:
            counts['outliers'][axis] += 1
            continue
        if adaptive and state['adaptive'][axis]['noise']['blocks'] == 0:
            continue  # nothing is expected before the noise is known
        innovation = result['innovation'][axis]
        squared = innovation * innovation / result['innovation_variance'][axis]
        counts['nis_sum'][axis] += min(squared, LARGEST_NIS)
        counts['nis_samples'][axis] += 1


@kernel
def _note_equal(sample: Any, state: Any) -> None:
    """Count how often values have stayed the same to the last bit, and what that tells."""
    rate, acceleration = sample['angular_velocity'], sample['linear_acceleration']
    counts, equal, largest = state['counts'], state['equal'], state['largest']
    entered, resolution, same = state['entered'], state['resolution'], True
    for axis in range(3):
        if _usable(rate[axis]):
            change = abs(rate[axis] - state['measured'][axis])
            if change > 0.0:
                entered[axis] = change
                if change < resolution[axis] or resolution[axis] == 0.0:
                    resolution[axis] = change
            elif entered[axis] > CLIPPED_STEPS * resolution[axis]:
                largest[axis] = max(largest[axis], abs(rate[axis]))
                fastest = abs(rate[axis]) > CLIPPED_RATE and abs(rate[axis]) == largest[axis]
                if fastest and equal[axis] + 2 >= CLIPPED_SAMPLES:
                    counts['clipped'][axis] += 1
        if rate[axis] == state['measured'][axis]:
            equal[axis] += 1
        else:
            equal[axis] = 0
            same = False
        # NaN, for who has no accelerometer, is the same as NaN.
        force, before = acceleration[axis], state['acceleration'][axis]
        if force != before and (force == force or before == before):
            same = False
        state['measured'][axis] = rate[axis]
        state['acceleration'][axis] = force
    state['equal_all'] = state['equal_all'] + 1 if same else 0
    seconds = state['equal_all'] * state['clock']['period']
    stuck = state['equal_all'] >= STUCK_SAMPLES and seconds >= STUCK_SECONDS
    if stuck and not state['stuck']:
        counts['stuck'] += 1
    state['stuck'] = stuck


@kernel
def _elapsed(clock: Any, stamp: int) -> float:
    """Return the time in s since the last sample, as far as the stamps tell."""
    if stamp == 0 or not clock['started']:
        return float(clock['period'])
    return float(min(max((stamp - clock['stamp']) * 1e-9, 0.0), LONGEST_ABSENCE))


@kernel
def _take_bias_off(
    sample: Any,
    elapsed: float,
    missing: int,
    settings: Any,
    lengths: Any,
    state: Any,
) -> None:
    """Learn the bias if this is rest, and subtract it from the result."""
    bias, result = state['bias'], state['result']
    if missing == RESTART:
        leave_rest(bias)
    believed = result['status'] == FILTERED and state['equal_all'] < STUCK_SAMPLES
    for axis in range(3):
        if result['outlier'][axis] > 0.0:
            believed = False
    track_bias(
        bias,
        sample,
        believed,
        max(missing, 0),
        elapsed,
        lengths,
        settings['bias_max'],
        settings['bias_random_walk'],
        settings['bias_calibration_time'],
    )
    result['at_rest'] = bias['rest']['at_rest']
    for axis in range(3):
        result['bias'][axis] = 0.0
        if settings['bias_enabled']:
            result['bias'][axis] = bias['bias'][axis]
            result['angular_velocity'][axis] -= bias['bias'][axis]
            result['angular_velocity_variance'][axis] += bias_variance(bias, axis)


@kernel
def _stop_bridging(rate: Any, missing: int, gap_limit: float, state: Any) -> None:
    """Let go of the axes that time has jumped on, or that had no usable rate for `gap_limit` s."""
    for axis in range(3):
        bridged = 0 if _usable(rate[axis]) else state['bridged'][axis] + 1 + max(missing, 0)
        state['bridged'][axis] = bridged
        if missing == RESTART or bridged * state['clock']['period'] > gap_limit:
            state['paper'][axis]['tracking'] = False
            state['adaptive'][axis]['tracking'] = False


@kernel
def _usable(rate: float) -> bool:
    return abs(rate) <= LARGEST_RATE  # False for NaN


@kernel
def _is_repeat(stamp: int, rate: Any, state: Any) -> bool:
    clock, measured = state['clock'], state['measured']
    return bool(
        stamp != 0
        and clock['started']
        and stamp == clock['stamp']
        and rate[0] == measured[0]
        and rate[1] == measured[1]
        and rate[2] == measured[2]
    )


@kernel
def _step_paper(sample: Any, missing: int, settings: Any, coefficients: Any, state: Any) -> None:
    """Filter with `kalman` or `sage_husa`; a rate that is no usable number is bridged."""
    rate = sample['angular_velocity']
    adaptive = settings['method'] == SAGE_HUSA
    epsilon = settings['epsilon'] if settings['outlier_enabled'] else np.inf
    result = state['result']
    for axis in range(3):
        paper, constants = state['paper'][axis], coefficients[axis]
        usable = _usable(rate[axis])
        starting = not paper['tracking']
        if starting and not usable:
            result['status'] = REFUSED
            continue
        if starting:
            start_paper(paper, constants, rate[axis])
        else:
            for _ in range(missing if usable else missing + 1):
                bridge_paper(paper, constants, adaptive)
            if usable:
                predict_paper(paper, constants, adaptive)
        process_noise, measurement_noise = paper_noise(paper, constants, adaptive)
        result['process_noise'][axis] = process_noise
        result['measurement_noise'][axis] = measurement_noise
        result['innovation_variance'][axis] = paper['rate_variance'] + measurement_noise
        innovation, outlier = 0.0, not usable
        if usable and not starting:
            innovation, outlier = update_paper(
                paper, constants, adaptive, settings['forgetting_factor'], epsilon, rate[axis]
            )
        result['innovation'][axis] = innovation
        result['outlier'][axis] = outlier
        result['angular_velocity'][axis] = paper_rate(paper, adaptive)
        result['angular_velocity_variance'][axis] = paper['rate_variance']


@kernel
def _step_adaptive(sample: Any, missing: int, settings: Any, coefficients: Any, state: Any) -> None:
    """Filter with `adaptive`: predict all axes, then take in what the sample is on all of them."""
    rate, acceleration = sample['angular_velocity'], sample['linear_acceleration']
    result, ladder = state['result'], coefficients['ladder']
    all_zero = rate[0] == 0.0 and rate[1] == 0.0 and rate[2] == 0.0
    surprised = jolted = False
    for axis in range(3):
        adaptive, usable = state['adaptive'][axis], _usable(rate[axis])
        if not adaptive['tracking']:
            if not usable:
                result['status'] = REFUSED
                continue
            model = settings['model'][axis]
            start_adaptive(adaptive, rate[axis], model['noise_deviation'], model['phi'])
        else:
            for _ in range(missing):
                predict_adaptive(adaptive, ladder)
                miss_adaptive(adaptive)
        if jolts(adaptive, acceleration[axis]):
            jolted = True
        predict_adaptive(adaptive, ladder)
        if usable and surprises(adaptive, rate[axis]):
            surprised = True
    dropout = all_zero and surprised and settings['outlier_enabled']
    for axis in range(3):
        adaptive = state['adaptive'][axis]
        if not adaptive['tracking']:
            continue
        result['innovation_variance'][axis] = adaptive['prediction_variance']
        if _usable(rate[axis]):
            result['innovation'][axis] = rate[axis] - adaptive['prediction']
            result['outlier'][axis] = update_adaptive(
                adaptive, rate[axis], dropout, jolted, coefficients
            )
        else:
            result['innovation'][axis] = 0.0
            result['outlier'][axis] = 1.0
            miss_adaptive(adaptive)
        mean, variance, process_noise = estimate_adaptive(adaptive, ladder)
        if _usable(rate[axis]) and not dropout:
            mean += make_up(adaptive, rate[axis], mean, jolted, state['clock']['period'])
        result['angular_velocity'][axis] = mean
        result['angular_velocity_variance'][axis] = variance
        result['process_noise'][axis] = process_noise
        result['measurement_noise'][axis] = adaptive['noise']['variance']


# numba takes arrays from Python faster than their records.


@entry_kernel(SAMPLE, SETTINGS, COEFFICIENTS, STATE)
def step_sample(sample: Any, settings: Any, coefficients: Any, state: Any) -> bool:
    """Take one sample in: `step` for arrays (1,) of its records."""
    return step(sample[0], settings[0], coefficients[0], state[0])


@entry_kernel(
    int,
    read_only(np.int64),
    read_only((np.float64, 2)),
    read_only((np.float64, 2)),
    SAMPLE,
    SETTINGS,
    COEFFICIENTS,
    STATE,
    RESULT,
)
def run_samples(
    first: int,
    stamps: Any,
    rates: Any,
    accelerations: Any,
    sample: Any,
    settings: Any,
    coefficients: Any,
    state: Any,
    results: Any,
) -> int:
    """Step through samples from `first` on, up to one after which the sample period is another.

    Returns the number of samples done.
    """
    now = sample[0]
    for i in range(first, len(stamps)):
        now['stamp'] = stamps[i]
        for axis in range(3):
            now['angular_velocity'][axis] = rates[i, axis]
            now['linear_acceleration'][axis] = accelerations[i, axis]
        changed = step(now, settings[0], coefficients[0], state[0])
        results[i] = state[0]['result']
        if changed:
            return i + 1
    return len(stamps)


class Filter:
    """The filter of one gyroscope: three axes, one state.

    Attributes:
        parameters: What the filter was configured with.
        state: A record of STATE; everything that `reset` clears and `snapshot` holds.
    """

    def __init__(self, parameters: Parameters | None = None) -> None:
        self._settings = np.zeros(1, SETTINGS)
        self._coefficients = zeroed(COEFFICIENTS)
        self._state = zeroed(STATE)
        self._arrays = self._settings, self._coefficients, self._state
        self._sample = np.zeros(1, SAMPLE)
        self.parameters = parameters or Parameters()
        self.configure(self.parameters)
        self.set_bias(self.parameters.bias_initial)
        self.reset()

    @property
    def state(self) -> Any:
        """The record of STATE, live: a view, not a copy."""
        return self._state[0]

    @property
    def bias_deviation(self) -> NDArray[np.float64]:
        """The standard deviation of the bias at present, (3,) in rad/s."""
        return bias_deviation(self.state['bias'])

    def configure(self, parameters: Parameters) -> None:
        """Take new parameters between two samples; what was learned is kept.

        A part of the model that changes replaces what was learned of it.
        """
        before, self.parameters = self.parameters, parameters
        settings = self._settings[0]
        settings['method'] = METHODS.index(parameters.method)
        settings['forgetting_factor'] = parameters.forgetting_factor
        settings['outlier_enabled'] = parameters.outlier_enabled
        settings['epsilon'] = parameters.epsilon
        settings['outlier_threshold'] = (
            parameters.outlier_threshold if parameters.outlier_enabled else math.inf
        )
        settings['outlier_acceleration'] = parameters.outlier_acceleration
        settings['outlier_run'] = parameters.outlier_run
        settings['sample_rate'] = parameters.sample_rate
        settings['gap_limit'] = parameters.gap_limit
        settings['bias_enabled'] = parameters.bias_enabled
        settings['bias_max'] = parameters.bias_max
        settings['bias_random_walk'] = parameters.bias_random_walk
        settings['bias_calibration_time'] = parameters.bias_calibration_time
        settings['model']['phi'] = parameters.model_phi
        settings['model']['process_noise'] = parameters.model_process_noise
        settings['model']['measurement_noise'] = parameters.model_measurement_noise
        settings['model']['noise_deviation'] = parameters.model_noise_deviation
        self._underived = True
        state = self.state
        for name in ('process_noise', 'measurement_noise'):
            if settings['model'][name].tolist() != list(getattr(before, f'model_{name}')):
                state['paper'][name] = settings['model'][name]
        for axis, deviation in enumerate(parameters.model_noise_deviation):
            if deviation not in (0.0, before.model_noise_deviation[axis]):
                start_noise(state['adaptive'][axis]['noise'], deviation, parameters.model_phi[axis])
        if parameters.sample_rate != before.sample_rate and parameters.sample_rate > 0.0:
            period = period_of(parameters.sample_rate)
            for axis in range(3):
                rescale_adaptive(state['adaptive'][axis], period / state['clock']['period'])
            state['clock']['period'] = period
        if parameters.bias_initial != before.bias_initial:
            self.set_bias(parameters.bias_initial)
        if (parameters.method == 'adaptive') != (before.method == 'adaptive'):
            self._take_over()

    def _take_over(self) -> None:
        """Begin with the state of another method, as old as the last switch, where this one ends.

        So the output does not jump. Where it lags behind the samples it has to: then, and where
        there is no output, the other method begins at the next sample.
        """
        state, settings = self.state, self._settings[0]
        self._derive()
        adaptive = settings['method'] == ADAPTIVE
        before, after = ('paper', 'adaptive') if adaptive else ('adaptive', 'paper')
        result = state['result']
        rates = result['angular_velocity'] + result['bias']
        for axis in range(3):
            tracking = state[before]['tracking'][axis] and result['status'] != REFUSED
            distance = state['measured'][axis] - rates[axis]
            limit = NEAR * math.sqrt(result['innovation_variance'][axis])
            state[after]['tracking'][axis] = False
            if not tracking or not abs(distance) <= limit:
                continue
            if adaptive:
                model = settings['model'][axis]
                start_adaptive(
                    state['adaptive'][axis], rates[axis], model['noise_deviation'], model['phi']
                )
                believe_all_levels(state['adaptive'][axis])
            else:
                start_paper(state['paper'][axis], self._coefficients[0]['paper'][axis], rates[axis])

    def reset(self) -> None:
        """Forget all samples, counts and what was learned of noise and time; not the bias."""
        bias = self.state['bias'].copy()
        self._state[:] = np.zeros(1, STATE)
        self.state['bias'] = bias
        leave_rest(self.state['bias'])
        start_clock(self.state['clock'], self.parameters.sample_rate)
        self._underived = True

    def set_bias(self, bias: Sequence[float], deviation: Sequence[float] | None = None) -> None:
        """Begin with a bias from elsewhere, and forget what was learned of rest.

        Args:
            bias: (3,) in rad/s.
            deviation: (3,) its standard deviation in rad/s; None where it is a mere guess that the
                first rest replaces.
        """
        variance = np.full(3, np.inf) if deviation is None else np.square(deviation)
        self.state['bias'] = np.zeros(1, BIAS)[0]
        start_bias(self.state['bias'], np.asarray(bias, np.float64), variance)

    def hint(self, moves: bool) -> None:
        """Take a word of the robot on whether it moves; it holds for a second."""
        self.state['bias']['hint'] = MOVES if moves else STANDS
        self.state['bias']['hint_seconds'] = HINT_SECONDS

    def note_temperature(self, temperature: float) -> None:
        """Take the sensor's temperature in deg C; a change makes the bias uncertain."""
        warm_bias(
            self.state['bias'],
            temperature,
            self.parameters.bias_temperature_step,
            self.parameters.bias_temperature_coefficient,
        )

    def calibrate(self) -> None:
        """Take the mean rate of the rest under way for the bias, whatever it was before.

        Raises:
            GyroDriftFilterError: The sensor moves, has stood still for less than
                `bias.calibration_time`, or its rate is beyond `bias.max`; the text says so.
        """
        bias, needed = self.state['bias'], self.parameters.bias_calibration_time
        seconds = float(bias['still_seconds'])
        if seconds < needed:
            what = f'has stood still for {seconds:.1f} s only' if seconds else 'moves'
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
        calibrate_bias(bias)

    def snapshot(self) -> bytes:
        """Return the state; `restore` on a filter of the same parameters continues bit for bit."""
        return _LAYOUT + self._state.tobytes()

    def restore(self, snapshot: bytes) -> None:
        """Continue from a snapshot.

        Raises:
            GyroDriftFilterError: The snapshot is of another version.
        """
        if not snapshot.startswith(_LAYOUT) or len(snapshot) != len(_LAYOUT) + STATE.itemsize:
            raise GyroDriftFilterError('the snapshot was taken by another version')
        self._state[:] = np.frombuffer(snapshot, STATE, offset=len(_LAYOUT))
        self._underived = True

    def step(self, stamp: int, rate: Sequence[float], acceleration: Sequence[float]) -> Any:
        """Filter one sample.

        Args:
            stamp: Time of the sample in ns; 0 where the driver does not stamp.
            rate: Angular velocity (3,) in rad/s. A NaN or infinity is bridged by the prediction.
            acceleration: Linear acceleration (3,) in m/s^2; NaN where unknown.

        Returns:
            A record of RESULT, valid until the next step.

        Raises:
            GyroDriftFilterError: The shapes do not agree.
        """
        if np.shape(rate) != (3,) or np.shape(acceleration) != (3,):
            raise GyroDriftFilterError(
                'rate and acceleration must be of three numbers each, not of shapes '
                f'{np.shape(rate)} and {np.shape(acceleration)}'
            )
        sample = self._sample[0]
        sample['stamp'] = stamp
        sample['angular_velocity'] = rate
        sample['linear_acceleration'] = acceleration
        self._underived = step_sample(self._sample, *self.arrays_of_step())
        return self.state['result']

    def arrays_of_step(self) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return settings, coefficients and state, (1,) each, for a kernel that calls `step`.

        They are good up to a step that returns True: then call `note_period`.
        """
        if self._underived:
            self._derive()
        return self._arrays

    def note_period(self) -> None:
        """Have the coefficients derived anew before the next step if the sample period changed."""
        self._underived = bool(self._coefficients[0]['period'] != self.state['clock']['period'])

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
        done = 0
        while done < n:
            arrays = self._sample, *self.arrays_of_step(), results
            done = run_samples(done, stamps, rates, accelerations, *arrays)
            self.note_period()
        return results

    def _derive(self) -> None:
        """Derive the coefficients for the sample period that the clock has."""
        settings, coefficients, state = self._settings[0], self._coefficients[0], self.state
        period = coefficients['period'] = float(state['clock']['period'])
        for axis in range(3):
            derive_paper(
                settings['model'][axis],
                settings['sample_rate'],
                period,
                coefficients['paper'][axis],
            )
        derive_adaptive(
            float(settings['forgetting_factor']),
            float(settings['outlier_threshold']),
            float(settings['outlier_acceleration']),
            int(settings['outlier_run']),
            period,
            coefficients['adaptive'],
        )
        derive_lengths(period, coefficients['rest'])
        self._underived = False
