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

"""The search for the best parameters: wide first, on all cores, then from the best downhill."""

import math
import os
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from typing import Any, Self

import numpy as np
from scipy.optimize import minimize

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core import Parameters
from gyro_drift_filter.tune.objective import Objective

# A third of the evaluations is spread evenly; then Nelder and Mead's simplex goes downhill from the
# best of them, as thresholds make steps that have no slope. Its first steps are so wide.
_FIRST_STEP = 0.12
_ENOUGH = {'xatol': 5e-3, 'fatol': 5e-5}


class TimeIsUpError(Exception):
    """There is no time for another evaluation."""


class Evaluations:
    """Costs of parameters, each found once, until the time is up. Threads may share it.

    Attributes:
        count: How many there were.
        out_of_time: Whether one was wanted for which there was no time.
        deadline: By `time.monotonic`, in s.
    """

    def __init__(
        self, objective: Objective, deadline: float, on_evaluation: Callable[[int], None]
    ) -> None:
        self.count = 0
        self.out_of_time = False
        self.deadline = deadline
        self._objective = objective
        self._on_evaluation = on_evaluation
        self._known: dict[Parameters, Floats] = {}
        # Kernels let go of the interpreter's lock, so that threads are enough.
        self._pool = ThreadPoolExecutor(os.cpu_count())

    def __enter__(self) -> Self:
        """Return this."""
        return self

    def __exit__(self, *_: object) -> None:
        """End all evaluations; where this is an interrupt, some are under way."""
        self.deadline = -math.inf
        self._pool.shutdown(cancel_futures=True)

    def costs(self, parameters: Parameters) -> Floats:
        """Return the costs of each stretch (STRETCHES,).

        Raises:
            TimeIsUpError: The time is up; the first evaluation is always made.
        """
        if parameters not in self._known:
            if self.count and time.monotonic() > self.deadline:
                self.out_of_time = True
                raise TimeIsUpError
            self._known[parameters] = self._objective.costs(parameters)
            self.count += 1
            self._on_evaluation(self.count)
        return self._known[parameters]

    def best(self, total: Callable[[Floats], float]) -> Parameters:
        """Return those of all that were evaluated whose total over the stretches is least."""
        return min(self._known, key=lambda parameters: total(self._known[parameters]))

    def side_by_side(self, function: Callable[[Any], Any], values: Iterable[Any]) -> list[Any]:
        """Return what a function makes of values, on all cores; None where the time was up."""

        def guarded(value: Any) -> Any:
            try:
                return function(value)
            except TimeIsUpError:
                return None

        return list(self._pool.map(guarded, values))


def search(
    cost: Callable[[Floats], float],
    start: Floats,
    evaluations: Evaluations,
    budget: int,
    seed: int,
) -> Floats:
    """Return the best place (d,) in the unit cube: found all over it, then down from the best.

    `start` is a place (d,), and `cost` a function of one, which makes the evaluations. It is called
    `budget` times at most.

    Raises:
        TimeIsUpError: There was no time for any place.
    """
    dimensions = len(start)
    places = np.vstack([start, _spread(budget // 3 - 1, dimensions, seed)])
    found = evaluations.side_by_side(cost, places)
    ranked = [
        (value, place)
        for value, place in zip(found, places.tolist(), strict=True)
        if value is not None
    ]
    if not ranked:
        raise TimeIsUpError
    _, best = min(ranked)
    return downhill(cost, np.array(best), budget - budget // 3)


def downhill(cost: Callable[[Floats], float], start: Floats, budget: int) -> Floats:
    """Return the best place (d,) found in the unit cube on the way down from the start (d,).

    `cost` is called `budget` times at most.

    Raises:
        TimeIsUpError: There was no time for any place.
    """
    best = cost(start), start.tolist()

    def noted(trial: Floats) -> float:
        nonlocal best
        value = cost(trial)
        best = min(best, (value, trial.tolist()))
        return value

    steps = np.where(start > 0.5, -_FIRST_STEP, _FIRST_STEP) * np.eye(len(start))
    options = {'initial_simplex': np.vstack([start, start + steps]), 'maxfev': budget, **_ENOUGH}
    bounds = [(0.0, 1.0)] * len(start)
    with suppress(TimeIsUpError):  # the best so far counts
        minimize(noted, start, method='Nelder-Mead', bounds=bounds, options=options)
    return np.array(best[1])


def _spread(count: int, dimensions: int, seed: int) -> Floats:
    """Return places (count, dimensions), one in each of `count` equal layers along each of them."""
    random = np.random.default_rng(seed)
    layers = np.stack([random.permutation(count) for _ in range(dimensions)], axis=1)
    return (layers + random.random((count, dimensions))) / max(count, 1)
