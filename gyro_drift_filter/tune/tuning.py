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

"""Tune parameters on half of a recording's stretches, and judge them on those held back."""

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from gyro_drift_filter.arrays import Bools, Floats
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.tune.objective import STRETCHES, Material, Objective
from gyro_drift_filter.tune.ranges import RANGES, at_places
from gyro_drift_filter.tune.search import Evaluations, TimeIsUpError, downhill, search

# Another value is worth it where it predicts by so much better, in nats a sample: a hundredth is
# one per cent of the error of the prediction. And where so large a gain is less likely than this to
# come about by the scatter between stretches.
LEAST_GAIN, LARGEST_CHANCE = 0.01, 0.05
# Evaluations for each parameter.
BUDGET = 40
# One in so many of them refines what was found by all stretches.
REFINING = 4
# Of the time; the rest is for what the search leads to.
SEARCH_SHARE = 0.7
# Steps of each parameter by which its sensitivity is told, in parts of its range.
_STEPS = 2.0 ** -np.arange(1.0, 7.0)


@dataclass(frozen=True)
class Gain:
    """By how much one set of parameters is better than another.

    In nats a sample: 0.01 is one per cent of the error.

    Attributes:
        mean: Over stretches.
        deviation: Standard error of that, by the scatter between stretches.
        chance: How likely a mean as large is by chance, if each stretch may as well lose what it
            gains: the share of all choices of signs that give one. The gains are far from normal,
            as a rest gains little, and a stretch with a blow in it much.
    """

    mean: float
    deviation: float
    chance: float

    @property
    def is_worth_it(self) -> bool:
        """Whether it is large enough to be of use, and beyond the scatter."""
        return self.mean > LEAST_GAIN and self.chance <= LARGEST_CHANCE


@dataclass(frozen=True)
class Sensitivity:
    """How much depends on one parameter, with the others as they were chosen.

    Attributes:
        name: Of the parameter.
        before: Its value before.
        chosen: Its value now.
        low: Down to here the loss is below LEAST_GAIN; of a value per axis that of x.
        high: Up to here it is.
        loss: At the worst of the values that were tried, in nats a sample; None, as low and high
            are, where there was no time.
    """

    name: str
    before: float | tuple[float, ...]
    chosen: float | tuple[float, ...]
    low: float | None
    high: float | None
    loss: float | None


@dataclass(frozen=True)
class Tuning:
    """What was found.

    Attributes:
        before: The parameters that were to be tuned.
        chosen: Those that suit the recording: the best, refined by all stretches, or those before
            where they are as good.
        best: The best for the stretches that were searched on.
        gain: Of the best over those before, on the stretches held back.
        cost_before: Of the parameters before, on the stretches held back: nats a sample, or with
            truth the rms error in rad/s.
        cost_best: The same of the best, or again of those before where they stay.
        sensitivities: Of all parameters that were tuned, the largest first.
        evaluations: How often the filter ran through the recording.
        out_of_time: Whether the time limit has left something out.
    """

    before: Parameters
    chosen: Parameters
    best: Parameters
    gain: Gain
    cost_before: float
    cost_best: float
    sensitivities: list[Sensitivity]
    evaluations: int
    out_of_time: bool


def tune(
    material: Material,
    before: Parameters,
    *,
    seconds: float = math.inf,
    seed: int = 0,
    budget: int | None = None,
    on_evaluation: Callable[[int, int], None] = lambda count, most: None,
) -> Tuning:
    """Tune the parameters of `before.method` that `RANGES` lists.

    Args:
        material: The recording.
        before: Where the search starts; what is not tuned stays.
        seconds: Time limit.
        seed: Of the random numbers.
        budget: Evaluations of the search, else BUDGET for each parameter; those of the sensitivity
            come on top.
        on_evaluation: Called after each evaluation, with their number and what it may come to.

    Raises:
        GyroDriftFilterError: The recording is too short, or nothing of the method is tuned.
    """
    if before.method not in RANGES:
        raise GyroDriftFilterError(
            f'no parameter of the method {before.method} is tuned, only of {", ".join(RANGES)}'
        )
    dimensions = len(RANGES[before.method])
    budget = budget or BUDGET * dimensions
    most = budget + (2 * len(_STEPS) + dimensions) * dimensions
    start = time.monotonic()
    objective = Objective(material)
    with Evaluations(
        objective, start + SEARCH_SHARE * seconds, lambda count: on_evaluation(count, most)
    ) as evaluations:
        return _Run(objective, evaluations, before, start + seconds).tune(budget, seed)


class _Run:
    """One run of `tune`, until `end` by `time.monotonic`."""

    def __init__(
        self, objective: Objective, evaluations: Evaluations, before: Parameters, end: float
    ) -> None:
        self._objective = objective
        self._evaluations = evaluations
        self._before = before
        self._ranges = RANGES[before.method]
        self._end = end

    def tune(self, budget: int, seed: int) -> Tuning:
        """Return what `tune` does."""
        # Of each pair of neighbours one is held back: motion that comes at intervals is in both.
        first = np.random.default_rng(seed).random(STRETCHES // 2) < 0.5
        held_back = np.column_stack([first, ~first]).ravel()
        before, noise = self._before, self._objective.noise
        default = self._evaluations.costs(before)
        start = np.array([range_.place(before, noise) for range_ in self._ranges])
        best = before
        with suppress(TimeIsUpError):
            cost = self._cost_of(~held_back)
            place = search(cost, start, self._evaluations, budget - budget // REFINING, seed)
            best = self._at(place)
        self._evaluations.deadline = self._end
        best = self._without_the_idle(best, ~held_back)
        costs = self._evaluations.costs(best)
        gain = self._gain(default, costs, held_back)
        if gain.is_worth_it:
            chosen = self._refined(budget // REFINING)
        else:
            chosen, costs = before, default
        sensitivities = self._sensitivities(chosen)
        return Tuning(
            before=before,
            chosen=chosen,
            best=best,
            gain=gain,
            cost_before=self._shown(default[held_back]),
            cost_best=self._shown(costs[held_back]),
            sensitivities=sorted(sensitivities, key=lambda one: -(one.loss or 0.0)),
            evaluations=self._evaluations.count,
            out_of_time=self._evaluations.out_of_time,
        )

    def _refined(self, budget: int) -> Parameters:
        """Return the best by all stretches: the search has seen half of them."""
        everywhere, noise = np.full(STRETCHES, True), self._objective.noise
        # The filter ran through all stretches each time, so nothing of it is lost.
        best = self._evaluations.best(self._total)
        start = np.array([range_.place(best, noise) for range_ in self._ranges])
        with suppress(TimeIsUpError):
            best = self._at(downhill(self._cost_of(everywhere), start, budget))
        return self._without_the_idle(best, everywhere)

    def _at(self, place: Floats) -> Parameters:
        return at_places(self._ranges, place.tolist(), self._before, self._objective.noise)

    def _cost_of(self, stretches: Bools) -> Callable[[Floats], float]:
        """Return what the search makes small on some stretches."""
        return lambda place: self._total(self._evaluations.costs(self._at(place))[stretches])

    def _total(self, costs: Floats) -> float:
        """Return what the search makes small, in nats."""
        mean = float(costs.mean())
        return 0.5 * math.log(max(mean, 1e-300)) if self._objective.is_error else mean

    def _shown(self, costs: Floats) -> float:
        mean = float(costs.mean())
        return math.sqrt(mean) if self._objective.is_error else mean

    def _gain(self, worse: Floats, better: Floats, stretches: Bools) -> Gain:
        """Return by how much costs are smaller on some stretches."""
        gains = (worse - better)[stretches]
        if self._objective.is_error:  # the logarithm of an rms error, for small changes
            gains = gains / (2.0 * max(float(worse[stretches].mean()), 1e-300))
        n = len(gains)
        signs = 1.0 - 2.0 * (np.arange(2**n)[:, None] >> np.arange(n) & 1)
        chance = float((signs @ gains >= gains.sum() * (1.0 - 1e-12)).mean())
        return Gain(float(gains.mean()), float(gains.std(ddof=1) / math.sqrt(n)), chance)

    def _without_the_idle(self, best: Parameters, stretches: Bools) -> Parameters:
        """Return the best with all parameters put back that gain nothing, the idlest first."""
        old = self._before.names()
        while True:
            now = self._evaluations.costs(best)
            losses = {}
            for name in [r.name for r in self._ranges if best.names()[r.name] != old[r.name]]:
                try:
                    costs = self._evaluations.costs(best.with_names({name: old[name]}))
                except TimeIsUpError:
                    return best
                losses[name] = self._total(costs[stretches]) - self._total(now[stretches])
            if not losses or min(losses.values()) > LEAST_GAIN:
                return best
            name = min(losses, key=lambda name: losses[name])
            best = best.with_names({name: old[name]})

    def _sensitivities(self, chosen: Parameters) -> list[Sensitivity]:
        """Return how much depends on each parameter: the losses at values over its range."""
        names, noise = chosen.names(), self._objective.noise
        now = self._total(self._evaluations.costs(chosen))
        trials = []
        found: dict[str, list[tuple[float, Any, float]]] = {}
        for range_ in self._ranges:
            own = range_.place(chosen, noise)
            beside = np.concatenate([own - _STEPS, own + _STEPS])
            places = {0.0, 1.0, *beside[(beside > 0.0) & (beside < 1.0)].tolist()} - {own}
            found[range_.name] = [(own, names[range_.name], 0.0)]
            trials += [
                _Trial(range_.name, place, range_.value(place, chosen, noise), abs(place - own))
                for place in places
            ]
        # The far ones first, as they tell most where the time is up before the end.
        trials.sort(key=lambda trial: -trial.distance)

        def loss(trial: _Trial) -> float:
            costs = self._evaluations.costs(chosen.with_names({trial.name: trial.value}))
            return self._total(costs) - now

        for trial, lost in zip(trials, self._evaluations.side_by_side(loss, trials), strict=True):
            if lost is not None:
                found[trial.name].append((trial.place, trial.value, lost))
        old = self._before.names()
        return [_sensitivity(name, old[name], names[name], found[name]) for name in found]


class _Trial(NamedTuple):
    """A parameter with the value of another place, so far from the one that was chosen."""

    name: str
    place: float
    value: Any
    distance: float


def _sensitivity(
    name: str, before: Any, chosen: Any, found: list[tuple[float, Any, float]]
) -> Sensitivity:
    """Return the sensitivity to a parameter from places, values and losses, one being `chosen`."""
    if len(found) == 1:
        return Sensitivity(name, before, chosen, None, None, None)
    found = sorted(found, key=lambda one: one[0])
    low = high = [value for _, value, _ in found].index(chosen)
    losses = [lost for _, _, lost in found]
    while low > 0 and losses[low - 1] < LEAST_GAIN:
        low -= 1
    while high < len(found) - 1 and losses[high + 1] < LEAST_GAIN:
        high += 1
    least, most = (float(np.ravel(found[k][1])[0]) for k in (low, high))
    return Sensitivity(name, before, chosen, least, most, max(losses))
