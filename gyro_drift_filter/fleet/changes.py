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

"""A change in a series that is more than its scatter, and more than others of the kind show.

A series is cut into stretches of one level each by PELT (Killick, Fearnhead and Eckley, J. Am.
Stat. Assoc. 107 (2012) 1590). A short series can't show by itself how much it scatters. The other
sensors of the fleet show the rest: how much they scatter from bag to bag, how different their
scatter is (Smyth, Stat. Appl. Genet. Mol. Biol. 3 (2004) 3), and how far they wander over many
bags, for example with the seasons.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import ruptures
from numpy.typing import NDArray
from scipy import stats

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.identify.blocks import PER_MEDIAN_DEVIATION

# A level and its change can be told from four bags on: two make a stretch, as one odd bag is none.
_STRETCH = 2
LEAST_BAGS = 2 * _STRETCH
# How often chance alone may make a finding in a whole fleet.
_CHANCE = 0.01
# A change within so many deviations of the history is one that happens.
MATTERS = 3.0
# Series of white noise by which it is known what chance makes, and their greatest length.
_DRAWN, _LONGEST = 1000, 200
# Has a logarithm, and is less than any scatter.
_SMALLEST = 1e-100
# Series whose median says how far the values of a fleet wander.
_TELLING = 300


class Found(NamedTuple):
    """A change in a series.

    Attributes:
        since: Index of the first value after it.
        before: Median of the stretch before it.
        after: Median of the last stretch.
        size: Of the change, in deviations of the history.
        certain: Whether chance does not make it.
    """

    since: int
    before: float
    after: float
    size: float
    certain: bool


@dataclass(frozen=True)
class Series:
    """One quantity of one axis over time.

    Attributes:
        robot: Whose it is: its series say nothing of what is usual for each other.
        values: (n,) in the order of time.
        own: Deviation that each value has by itself.
    """

    robot: str
    values: Floats
    own: float


class Usual:
    """What is usual for a quantity in a fleet.

    Attributes:
        scatter: Deviation of a value from one bag to another.
        prior_freedom: Degrees of freedom that this knowledge is worth: the fewer, the more the
            sensors differ.
    """

    def __init__(self, fleet: Sequence[Series]) -> None:
        self._fleet = [series for series in fleet if len(series.values) >= LEAST_BAGS]
        self._wander: dict[int, tuple[NDArray[Any], Floats]] = {}  # by bags in a mean
        self._of_others: dict[tuple[str, int], float] = {}
        self.scatter = self.prior_freedom = 0.0
        if self._fleet:
            steps = np.array([_log_steps(series.values) for series in self._fleet])
            means, variances = np.array([_by_chance(len(s.values)) for s in self._fleet]).T
            owns = np.array([max(series.own, _SMALLEST) for series in self._fleet])
            logs = np.maximum(steps - means, 2.0 * np.log(owns))
            centre = float(np.median(logs))
            self.scatter = math.exp(0.5 * centre)
            # Few series do not tell that the sensors are alike: so much more may be by chance.
            unsure = float(np.mean(variances)) * math.sqrt(2.0 / len(self._fleet))
            more = max(float(np.mean(np.square(logs - centre) - variances)), 0.0) + unsure
            # The variance of the logarithm of a chi-square is about 2 / n + 2 / n^2.
            self.prior_freedom = (1.0 + math.sqrt(1.0 + 2.0 * more)) / more

    def wander(self, series: Series) -> float:
        """Return how many times more than white noise other robots vary over many bags."""
        bags, most = 1, 1.0
        while 2 * bags <= len(series.values):
            most = max(most, self._wander_of_others(series.robot, bags))
            bags *= 2
        return most

    def _wander_of_others(self, robot: str, bags: int) -> float:
        """Return this factor for means of so many bags; 0 if there are no other robots."""
        if bags not in self._wander:
            # So many tell a median well enough, and more cost time.
            long = [series for series in self._fleet if len(series.values) >= 2 * bags]
            some = long[:: max(len(long) // _TELLING, 1)]
            self._wander[bags] = (
                np.array([one.robot for one in some]),
                np.array([_deviation_of_means(s.values, bags) / self.least(s) for s in some]),
            )
        if (robot, bags) not in self._of_others:
            robots, wander = self._wander[bags]
            others = wander[robots != robot]
            self._of_others[robot, bags] = float(np.median(others)) if len(others) else 0.0
        return self._of_others[robot, bags]

    def least(self, series: Series) -> float:
        """Return the deviation that a series has at least."""
        return max(series.own, self.scatter, usual_scatter(series.values))


def usual_scatter(values: Floats) -> float:
    """Return the deviation of values (n,) from one to the next: a jump and a drift hardly count."""
    steps = np.diff(values)
    return (
        PER_MEDIAN_DEVIATION * float(np.median(np.abs(steps - np.median(steps)))) / math.sqrt(2.0)
    )


def _log_steps(values: Floats) -> float:
    """Return the logarithm of the variance from one value to the next, without the largest step."""
    squares = np.square(np.diff(values))
    variance = (squares.sum() - squares.max()) / (2.0 * (len(squares) - 1))
    return math.log(max(float(variance), _SMALLEST))


@lru_cache
def _by_chance(bags: int) -> tuple[float, float]:
    """Return mean and variance of `_log_steps` for white noise of deviation 1."""
    drawn = np.random.default_rng(0).standard_normal((_DRAWN, min(bags, _LONGEST)))
    logs = [_log_steps(values) for values in drawn]
    return float(np.mean(logs)), float(np.var(logs))


def _deviation_of_means(values: Floats, bags: int) -> float:
    """Return the deviation of the means of so many values, times the root of their number.

    For white noise this is the deviation of a single value.
    """
    blocks = len(values) // bags
    means = np.sort(values[len(values) - blocks * bags :].reshape(blocks, bags).mean(axis=1))
    first, second = np.triu_indices(blocks, 1)
    apart = float(np.median(means[second] - means[first]))
    return PER_MEDIAN_DEVIATION * apart * math.sqrt(bags / 2.0)


def _median_variance(count: int) -> float:
    """Return the variance of the median of so many Gaussian values of deviation 1, within 2 %."""
    return 0.5 * math.pi / (count + 0.5 * math.pi - 1.0)


def find_change(series: Series, usual: Usual, tests: int, *, both_ways: bool) -> Found | None:
    """Return the change for the worse between an earlier stretch of a series and the last one.

    The earlier stretch is the best one, or the first one if a change either way is for the worse.

    Args:
        series: What is looked at.
        usual: What is usual in the fleet.
        tests: Values of all series that are looked at, each of which might be where chance makes a
            change.
        both_ways: Whether less is worse, too, and not only more.
    """
    values = series.values
    if len(values) < LEAST_BAGS:
        return None
    chance, wander = _CHANCE / tests, usual.wander(series)
    # White noise of deviation 1 is split by this penalty with the probability `chance` only.
    penalty = float(stats.chi2.isf(chance, 1)) * wander**2
    # A linear kernel's cost is that of a change of the mean; it is compiled.
    cut = ruptures.KernelCPD('linear', min_size=_STRETCH)
    scaled = (values / usual.least(series)).reshape(-1, 1)
    edges = [0, *cut.fit(scaled).predict(pen=penalty)]
    stretches = [np.sort(values[a:b]) for a, b in pairwise(edges)]
    if len(stretches) < 2:
        return None
    *history, last = stretches
    levels = [float(np.median(stretch)) for stretch in history]
    reference = 0 if both_ways else int(np.argmin(levels))
    before, after = levels[reference], float(np.median(last))
    if not both_ways and after <= before:
        return None
    low, high = (history[reference], last) if after > before else (last, history[reference])
    # The median of an even number of bags is taken as the middle one that is nearer to the other
    # stretch, so that one odd bag of two does not make a change.
    difference = max(float(high[(len(high) - 1) // 2] - low[len(low) // 2]), 0.0)
    # The scatter is that of the history alone: what gets worse may scatter as it does. What is
    # known of it from the fleet counts as so many degrees of freedom more.
    least = max(series.own, usual.scatter)
    freedom = sum(map(len, history)) - len(history) + usual.prior_freedom
    squares = sum(float(np.square(s - s.mean()).sum()) for s in history)
    pooled = math.sqrt((squares + usual.prior_freedom * least**2) / freedom)
    scatter = wander * max(pooled, least)
    size = difference / scatter
    ratio = size / math.sqrt(_median_variance(len(low)) + _median_variance(len(high)))
    certain = size > MATTERS and 2.0 * float(stats.t.sf(ratio, freedom)) < chance
    return Found(int(edges[reference + 1]), before, after, size, certain)
