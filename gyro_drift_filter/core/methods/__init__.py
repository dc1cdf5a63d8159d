"""The filter methods as a set: this is the one place that knows them all.

Each method is a module with the same verbs, kernels on the records of one axis:

    derive    constants from the settings and the sample period
    start     start at a sample: nothing is known but that
    predict   one sample period ahead
    coast     one sample period ahead where there is no sample to take in
    update    take a sample in: innovation, and whether it counts as an outlier
    estimate  rate and variance after that, with Q and R

The functions below choose the method that the settings name. `docs/architecture.md` shows how to
add a method: its module, and a branch in each of these.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, PerAxis, kernel, record
from gyro_drift_filter.core.methods import adaptive, paper
from gyro_drift_filter.core.methods.adaptive import (
    ADAPTIVE_AXIS,
    AdaptiveAxis,
    AdaptiveCoefficients,
    AdaptiveWorkspace,
)
from gyro_drift_filter.core.methods.noise import start_noise
from gyro_drift_filter.core.methods.paper import (
    PAPER_AXIS,
    PAPER_COEFFICIENTS,
    PaperAxis,
    PaperCoefficients,
)
from gyro_drift_filter.core.sample import Result, Sample

if TYPE_CHECKING:
    from gyro_drift_filter.core.records import FilterRecord
    from gyro_drift_filter.core.settings import Settings

METHODS = ('kalman', 'sage_husa', 'adaptive')
KALMAN, SAGE_HUSA, ADAPTIVE = range(len(METHODS))
DEFAULT_METHOD = 'adaptive'


class MethodCoefficients(TypedDict):
    """What each method derives from the settings and the sample period."""

    paper: Annotated[Sequence[PaperCoefficients], PAPER_COEFFICIENTS, (3,)]
    adaptive: AdaptiveCoefficients


class MethodStates(TypedDict):
    """The state of each method, by axis; `kalman` and `sage_husa` share one."""

    paper: Annotated[Sequence[PaperAxis], PAPER_AXIS, (3,)]
    adaptive: Annotated[Sequence[AdaptiveAxis], ADAPTIVE_AXIS, (3,)]


class MethodWorkspace(TypedDict):
    """What the methods need between prediction and estimate."""

    adaptive: AdaptiveWorkspace
    starting: CountPerAxis  # 1 where the sample is the first one, else 0
    # Q and R that the sample is taken in with, (rad/s)^2
    process_noise: PerAxis
    measurement_noise: PerAxis


METHOD_COEFFICIENTS = record(MethodCoefficients, in_cache_lines=True)
METHOD_STATES = record(MethodStates, in_cache_lines=True)
METHOD_WORKSPACE = record(MethodWorkspace, in_cache_lines=True)


@kernel
def derive(filter_: 'FilterRecord', period: float) -> None:
    """Derive the coefficients of all methods for a sample period in s."""
    coefficients, settings = filter_['coefficients']['methods'], filter_['settings']
    for axis in range(3):
        paper.derive(settings, axis, period, coefficients['paper'][axis])
    workspace = filter_['workspace']['methods']['adaptive']
    adaptive.derive(settings, period, coefficients['adaptive'], workspace)


@kernel
def rescale(filter_: 'FilterRecord', periods: float) -> None:
    """Carry what is counted per sample over to a sample period of `periods` old ones."""
    for axis in range(3):
        adaptive.rescale(filter_['state']['methods']['adaptive'][axis], periods)


@kernel
def is_tracking(filter_: 'FilterRecord', axis: int) -> bool:
    """Return whether the method stands at the sample before."""
    states = filter_['state']['methods']
    if filter_['settings']['method'] == ADAPTIVE:
        return states['adaptive'][axis]['tracking']
    return states['paper'][axis]['tracking']


@kernel
def stop_tracking(filter_: 'FilterRecord', axis: int) -> None:
    """Let the next sample be the first one; what was learned is kept."""
    states = filter_['state']['methods']
    states['paper'][axis]['tracking'] = False
    states['adaptive'][axis]['tracking'] = False


@kernel
def start(filter_: 'FilterRecord', axis: int, rate: float) -> None:
    """Start at a rate in rad/s."""
    states, settings = filter_['state']['methods'], filter_['settings']
    if settings['method'] == ADAPTIVE:
        deviation, phi = settings['model_noise_deviation'][axis], settings['model_phi'][axis]
        adaptive.start(states['adaptive'][axis], rate, deviation, phi)
    else:
        paper.start(states['paper'][axis], filter_['coefficients']['methods']['paper'][axis], rate)


@kernel
def predict(filter_: 'FilterRecord', axis: int) -> None:
    """Predict the sample."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        modes = coefficients['adaptive']['modes']
        adaptive.predict(states['adaptive'][axis], workspace['adaptive']['axes'][axis], modes)
    elif not workspace['starting'][axis]:  # safeguard: first sample
        paper.predict(states['paper'][axis], coefficients['paper'][axis], method == SAGE_HUSA)


@kernel
def coast(filter_: 'FilterRecord', axis: int) -> None:
    """Pass over a sample that is missing or no number."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        modes = coefficients['adaptive']['modes']
        adaptive.coast(states['adaptive'][axis], workspace['adaptive']['axes'][axis], modes)
    else:
        paper.coast(states['paper'][axis], coefficients['paper'][axis], method == SAGE_HUSA)


@kernel
def compare_axes(filter_: 'FilterRecord', sample: Sample) -> None:
    """Look at all axes together, between prediction and update."""
    if filter_['settings']['method'] == ADAPTIVE:
        axes = filter_['state']['methods']['adaptive']
        workspace = filter_['workspace']['methods']['adaptive']
        adaptive.compare_axes(axes, workspace, sample, filter_['settings'])


@kernel
def expect(filter_: 'FilterRecord', axis: int, result: Result) -> None:
    """Write the variance of the innovation, before the sample is taken in."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        variance = workspace['adaptive']['axes'][axis]['prediction_variance']
        result['innovation_variance'][axis] = variance
        return
    state = states['paper'][axis]
    process, measurement = paper.noise_of(state, coefficients['paper'][axis], method == SAGE_HUSA)
    workspace['process_noise'][axis] = process
    workspace['measurement_noise'][axis] = measurement
    result['innovation_variance'][axis] = state['rate_variance'] + measurement


@kernel
def update(filter_: 'FilterRecord', axis: int, sample: float) -> tuple[float, bool]:
    """Take a sample (rad/s) in; return its innovation in rad/s, and whether it is an outlier."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    settings, workspace = filter_['settings'], filter_['workspace']['methods']
    method = settings['method']
    if method == ADAPTIVE:
        innovation = sample - workspace['adaptive']['axes'][axis]['prediction']
        outlier = adaptive.update(
            states['adaptive'][axis], workspace['adaptive'], axis, coefficients['adaptive'], sample
        )
        return innovation, outlier
    if workspace['starting'][axis]:
        return 0.0, False
    state, own = states['paper'][axis], coefficients['paper'][axis]
    return paper.update(state, own, settings, method == SAGE_HUSA, sample)


@kernel
def estimate(filter_: 'FilterRecord', axis: int, sample: float, result: Result) -> None:
    """Write rate, variance, Q and R of an axis; `sample` in rad/s, NaN where there is none."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        state, shared = states['adaptive'][axis], workspace['adaptive']
        modes = coefficients['adaptive']['modes']
        rate, variance, process = adaptive.estimate(state, shared['axes'][axis], modes)
        if sample == sample and not shared['dropout']:
            period = filter_['state']['clock']['period']
            rate += adaptive.compensate(state, shared, axis, sample - rate, period)
        measurement = state['noise']['variance']
    else:
        rate, variance = paper.estimate(states['paper'][axis], method == SAGE_HUSA)
        process = workspace['process_noise'][axis]
        measurement = workspace['measurement_noise'][axis]
    result['angular_velocity'][axis] = rate
    result['angular_velocity_variance'][axis] = variance
    result['process_noise'][axis] = process
    result['measurement_noise'][axis] = measurement


@kernel
def is_noise_known(filter_: 'FilterRecord', axis: int) -> bool:
    """Return whether innovations can be judged: nothing is expected before the noise is known."""
    if filter_['settings']['method'] == ADAPTIVE:
        return filter_['state']['methods']['adaptive'][axis]['noise']['blocks'] > 0
    return True


@kernel
def change_model(filter_: 'FilterRecord', settings: 'Settings') -> None:
    """Replace what was learned of a part of the model that other settings give anew."""
    before, states = filter_['settings'], filter_['state']['methods']
    process, measurement = settings['model_process_noise'], settings['model_measurement_noise']
    process_before = before['model_process_noise']
    measurement_before = before['model_measurement_noise']
    process_changed = measurement_changed = False
    for axis in range(3):
        process_changed = process_changed or process[axis] != process_before[axis]
        measurement_changed = measurement_changed or measurement[axis] != measurement_before[axis]
    for axis in range(3):
        if process_changed:
            states['paper'][axis]['process_noise'] = process[axis]
        if measurement_changed:
            states['paper'][axis]['measurement_noise'] = measurement[axis]
        deviation = settings['model_noise_deviation'][axis]
        if deviation != 0.0 and deviation != before['model_noise_deviation'][axis]:
            phi = settings['model_phi'][axis]
            start_noise(states['adaptive'][axis]['noise'], deviation, phi)


@kernel
def share_state(one: int, other: int) -> bool:
    """Return whether two methods have the same state, so that one goes on where the other is."""
    return (one == ADAPTIVE) == (other == ADAPTIVE)


@kernel
def take_over(filter_: 'FilterRecord', axis: int, rate: float) -> None:
    """Start at the rate (rad/s) of another method, so that the output does not jump."""
    start(filter_, axis, rate)
    if filter_['settings']['method'] == ADAPTIVE:
        adaptive.make_equally_likely(filter_['state']['methods']['adaptive'][axis])
