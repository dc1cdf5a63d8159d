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

"""The filter methods as a set: this is the one place that knows them all.

Each method is a module with the same verbs, kernels that mostly take the records of one axis, and
the filter where they look at all axes together:

    derive               constants from the settings and the sample period
    start                start at a sample; what was learned of noise is kept
    predict              one sample period ahead
    coast                one sample period ahead where there is no sample to take in
    innovation_variance  what is expected of the sample before it is seen; above 0
    update               take a sample in: its innovation, and whether it counts as an outlier
    estimate             rate and variance after that, with Q and R

For each sample `step.py` calls the first of these lines on all axes, then the second, and so on:

    start, if this is the first sample; note_circumstances, once for all axes
    coast for each sample that is missing before it; predict, or coast where it is no number
    compare_axes, once for all axes
    innovation_variance; update, unless the sample is no number; estimate

So the first sample goes through `predict` and `update`, too; the paper's methods skip both there,
by `starting`. Coefficients are those of the sample period before the step; if the clock finds
another one in the step, `change_period` is called at its end. The other verbs are for methods that
need them: `note_circumstances` (of `adaptive` in `circumstances.py`) and `compare_axes` for what
all axes show together, `change_period` for what is counted per sample, `start_over`,
`learned_noise`, `noise_block_seconds` and `is_noise_known` for noise that is learned
(`is_noise_known` is asked after `update`, but is about the innovation variance that was predicted
before), `divergences` for a method that starts anew where it has diverged, `reason`,
`innovation_limits` and `was_not_measured` for one that judges samples by several rules,
`flags_motion` for one that flags samples as it lags behind motion, `change_model` for what
parameters replace, and `take_over` for a start at the rate of another method.

The functions below choose the method that the settings name. `docs/architecture.md` shows how to
add a method: its module, and a line or a branch in each of the seven listed first, also where it
has nothing to do there, as an else belongs to the paper's methods, and in others that it needs.
"""

from collections.abc import Collection, Mapping, Sequence
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, NamedTuple, TypedDict

from gyro_drift_filter.accelerate import CountPerAxis, inlined_kernel, kernel, record
from gyro_drift_filter.core.methods import adaptive, circumstances, paper, reasons
from gyro_drift_filter.core.methods.adaptive import AdaptiveCoefficients, AdaptiveWorkspace
from gyro_drift_filter.core.methods.adaptive_axis import ADAPTIVE_AXIS, AdaptiveAxis
from gyro_drift_filter.core.methods.advice import Advice
from gyro_drift_filter.core.methods.noise import NOISE_BLOCK_SECONDS
from gyro_drift_filter.core.methods.paper import (
    PAPER_AXIS,
    PAPER_COEFFICIENTS,
    PAPER_WORKSPACE,
    PaperAxis,
    PaperCoefficients,
    PaperWorkspace,
)
from gyro_drift_filter.core.sample import Sample

if TYPE_CHECKING:
    from gyro_drift_filter.core.records import FilterRecord
    from gyro_drift_filter.core.settings import Settings


# Of the reasons of every method, that of most samples.
WITHIN_LIMITS = 0


class Method(NamedTuple):
    """A method that users can choose.

    Attributes:
        name: What users write.
        state: Its field of `MethodStates`; a switch between methods that share one keeps the state.
        advice: What to do where it does not fit its sensor; without its own, general texts.
        reasons: Why a sample is accepted or an outlier, by the numbers that `reason` returns. That
            of `WITHIN_LIMITS` says that there was nothing special about it.
        unmeasured: Those of samples that the sensor has not measured; outliers in a row go on over
            them.
    """

    name: str
    state: str
    advice: Advice = Advice()
    reasons: Mapping[int, str] = MappingProxyType({0: 'accepted', 1: 'an outlier'})
    unmeasured: Collection[int] = ()


METHODS = (
    Method('kalman', 'paper', paper.ADVICE, paper.REASONS),
    Method('sage_husa', 'paper', paper.ADVICE, paper.REASONS),
    Method('adaptive', 'adaptive', adaptive.ADVICE, reasons.REASONS, (reasons.Reason.REPEATED,)),
)
METHOD_NAMES = tuple(method.name for method in METHODS)
ADVICE = {method.name: method.advice for method in METHODS}
# The numbers of the methods in `settings['method']`.
SAGE_HUSA, ADAPTIVE = METHOD_NAMES.index('sage_husa'), METHOD_NAMES.index('adaptive')


class MethodCoefficients(TypedDict):
    """What each method derives from the settings and the sample period."""

    paper: Annotated[Sequence[PaperCoefficients], PAPER_COEFFICIENTS, (3,)]
    adaptive: AdaptiveCoefficients


class MethodStates(TypedDict):
    """The state of each method, by axis."""

    tracking: CountPerAxis  # 1 where the method holds a state, 0 where the next sample starts it
    paper: Annotated[Sequence[PaperAxis], PAPER_AXIS, (3,)]
    adaptive: Annotated[Sequence[AdaptiveAxis], ADAPTIVE_AXIS, (3,)]


class MethodWorkspace(TypedDict):
    """What the methods need between prediction and estimate."""

    # 1 where the sample is the first one, else 0: where the method was not tracking before it
    starting: CountPerAxis
    paper: Annotated[Sequence[PaperWorkspace], PAPER_WORKSPACE, (3,)]
    adaptive: AdaptiveWorkspace


record(MethodCoefficients, in_cache_lines=True)
METHOD_STATES = record(MethodStates, in_cache_lines=True)
record(MethodWorkspace, in_cache_lines=True)


@kernel
def derive(filter_: 'FilterRecord', period: float) -> None:
    """Derive the coefficients of all methods for a sample period in s."""
    coefficients, settings = filter_['coefficients']['methods'], filter_['settings']
    workspace = filter_['workspace']['methods']
    for axis in range(3):
        paper.derive(settings, axis, period, coefficients['paper'][axis])
    adaptive.derive(settings, period, coefficients['adaptive'], workspace['adaptive'])


@kernel
def start(filter_: 'FilterRecord', axis: int, rate: float) -> None:
    """Start at a rate in rad/s; what was learned of noise is kept."""
    states, settings = filter_['state']['methods'], filter_['settings']
    if settings['method'] == ADAPTIVE:
        adaptive.start(states['adaptive'][axis], settings, axis, rate)
    else:
        paper.start(states['paper'][axis], filter_['coefficients']['methods']['paper'][axis], rate)
    states['tracking'][axis] = 1


@inlined_kernel
def predict(filter_: 'FilterRecord', axis: int) -> None:
    """Predict the sample."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        modes = coefficients['adaptive']['modes']
        adaptive.predict(states['adaptive'][axis], workspace['adaptive'], axis, modes)
    elif not workspace['starting'][axis]:  # safeguard: first sample
        paper.predict(states['paper'][axis], coefficients['paper'][axis], method == SAGE_HUSA)


@kernel
def coast(filter_: 'FilterRecord', axis: int) -> None:
    """Pass over a sample that is missing or no number: the prediction stands in for it."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        modes = coefficients['adaptive']['modes']
        adaptive.coast(states['adaptive'][axis], workspace['adaptive'], axis, modes)
    else:
        paper.coast(states['paper'][axis], coefficients['paper'][axis], method == SAGE_HUSA)


@kernel
def note_circumstances(filter_: 'FilterRecord', sample: Sample, possibly_missing: int) -> None:
    """Look at the accelerometer and at all axes together, before prediction."""
    if filter_['settings']['method'] == ADAPTIVE:
        circumstances.note_circumstances(filter_, sample, possibly_missing)


@kernel
def compare_axes(filter_: 'FilterRecord', sample: Sample, missing: int) -> None:
    """Look at the rates of all axes together, between prediction and update.

    Before the sample `missing` ones were lost.
    """
    if filter_['settings']['method'] == ADAPTIVE:
        adaptive.compare_axes(filter_, sample, missing)


@inlined_kernel
def innovation_variance(filter_: 'FilterRecord', axis: int) -> float:
    """Return the variance of the innovation to come, in (rad/s)^2."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        return adaptive.innovation_variance(workspace['adaptive']['axes'][axis])
    state, own = states['paper'][axis], workspace['paper'][axis]
    constants = coefficients['paper'][axis]
    return paper.innovation_variance(state, own, constants, method == SAGE_HUSA)


@inlined_kernel
def update(filter_: 'FilterRecord', axis: int, sample: float) -> tuple[float, bool]:
    """Take a sample (rad/s) in; return its innovation in rad/s, and whether it is an outlier."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    settings, workspace = filter_['settings'], filter_['workspace']['methods']
    method = settings['method']
    if method == ADAPTIVE:
        state, shared = states['adaptive'][axis], workspace['adaptive']
        return adaptive.update(state, shared, axis, coefficients['adaptive'], sample)
    if workspace['starting'][axis]:  # safeguard: first sample
        return 0.0, False
    constants = coefficients['paper'][axis]
    return paper.update(states['paper'][axis], constants, settings, method == SAGE_HUSA, sample)


@inlined_kernel
def estimate(
    filter_: 'FilterRecord', axis: int, sample: float
) -> tuple[float, float, float, float]:
    """Return rate in rad/s, its variance, Q and R; `sample` is NaN where there is none."""
    states, coefficients = filter_['state']['methods'], filter_['coefficients']['methods']
    method, workspace = filter_['settings']['method'], filter_['workspace']['methods']
    if method == ADAPTIVE:
        state, shared = states['adaptive'][axis], workspace['adaptive']
        modes, period = coefficients['adaptive']['modes'], filter_['state']['clock']['period']
        return adaptive.estimate(state, shared, axis, modes, sample, period)
    return paper.estimate(states['paper'][axis], workspace['paper'][axis], method == SAGE_HUSA)


# What a method may need besides: branches only for those that do.


@kernel
def change_period(filter_: 'FilterRecord', periods: float) -> None:
    """Get ready for coefficients of a sample period of `periods` old ones."""
    for axis in range(3):
        adaptive.change_period(filter_['state']['methods']['adaptive'][axis], periods)


@kernel
def start_over(filter_: 'FilterRecord') -> None:
    """Start at the next sample, and learn the noise anew."""
    states = filter_['state']['methods']
    for axis in range(3):
        states['tracking'][axis] = 0
        paper.start_over(states['paper'][axis])
        adaptive.start_over(states['adaptive'][axis])


@kernel
def is_noise_known(filter_: 'FilterRecord', axis: int) -> bool:
    """Return whether the innovation can be judged: noise is known, and the sample was measured."""
    if filter_['settings']['method'] == ADAPTIVE:
        repeated = filter_['workspace']['methods']['adaptive']['circumstances']['repeated']
        known = filter_['state']['methods']['adaptive'][axis]['noise']['blocks'] > 0
        return known and not repeated
    return True


@kernel
def reason(filter_: 'FilterRecord', axis: int, outlier: bool) -> int:
    """Return why a sample that was taken in counts as an outlier or not, see `Method.reasons`."""
    if filter_['settings']['method'] == ADAPTIVE:
        return filter_['workspace']['methods']['adaptive']['axes'][axis]['reason']
    return 1 if outlier else 0


@kernel
def innovation_limits(filter_: 'FilterRecord', axis: int) -> tuple[float, float]:
    """Return what an innovation has to exceed to be doubtful, in rad/s; 0 where that is no limit.

    The first limit is by noise, the second one by what a body can do.
    """
    if filter_['settings']['method'] == ADAPTIVE:
        return adaptive.limits_of(filter_['workspace']['methods']['adaptive']['axes'][axis])
    return 0.0, 0.0


@kernel
def was_not_measured(filter_: 'FilterRecord', axis: int) -> bool:
    """Return whether the sensor has not measured a sample, by its reason: `Method.unmeasured`."""
    if filter_['settings']['method'] == ADAPTIVE:
        reason = filter_['workspace']['methods']['adaptive']['axes'][axis]['reason']
        return bool(reason == reasons.Reason.REPEATED)
    return False


@kernel
def flags_motion(filter_: 'FilterRecord') -> bool:
    """Return whether a sample may be flagged for no more than that the estimate lags in motion.

    The paper's test on the square of a rate knows nothing of what a body can do.
    """
    return bool(filter_['settings']['method'] != ADAPTIVE)


@kernel
def learned_noise(filter_: 'FilterRecord', axis: int) -> tuple[int, float, float]:
    """Return how many blocks of rest the noise was learned from, and how samples correlate.

    That is those one apart, and those two apart. All are 0 for a method that learns no noise,
    whatever another one had learned before.
    """
    if filter_['settings']['method'] == ADAPTIVE:
        noise = filter_['state']['methods']['adaptive'][axis]['noise']
        return noise['blocks'], noise['autocorrelation'][0], noise['autocorrelation'][1]
    return 0, 0.0, 0.0


@kernel
def noise_block_seconds(filter_: 'FilterRecord') -> float:
    """Return how long the blocks of rest are that the noise is learned from; 0 without them."""
    if filter_['settings']['method'] == ADAPTIVE:
        samples = filter_['coefficients']['methods']['adaptive']['noise']['block_samples']
        # A block of whole samples may be a little shorter than the time that it is meant for.
        return max(NOISE_BLOCK_SECONDS, samples * filter_['state']['clock']['mean_period'])
    return 0.0


@kernel
def divergences(filter_: 'FilterRecord', axis: int) -> int:
    """Return how often an axis has diverged since the reset.

    The count outlives a switch to another method, so that a switch back does not make it grow.
    """
    return filter_['state']['methods']['paper'][axis]['divergences']


@kernel
def change_model(filter_: 'FilterRecord', settings: 'Settings') -> None:
    """Replace what was learned of those parts of the model that new settings change."""
    before, state = filter_['settings'], filter_['state']
    states, coefficients = state['methods'], filter_['coefficients']['methods']['paper']
    for axis in range(3):
        paper.derive(settings, axis, state['clock']['period'], coefficients[axis])
        paper.change_model(states['paper'][axis], before, settings, axis, coefficients[axis])
        adaptive.change_model(states['adaptive'][axis], before, settings, axis)


@kernel
def take_over(filter_: 'FilterRecord', axis: int, rate: float) -> None:
    """Start at the rate (rad/s) of another method, so that the output does not jump."""
    start(filter_, axis, rate)
    if filter_['settings']['method'] == ADAPTIVE:
        adaptive.make_equally_likely(filter_['state']['methods']['adaptive'][axis])
