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

"""Whether the covariances of the messages can be what their drivers say."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from gyro_drift_filter.arrays import Floats
from gyro_drift_filter.core.parameters import AXES
from gyro_drift_filter.doctor.findings import Finding, fault, sound

QUANTITIES = ('orientation', 'angular velocity', 'linear acceleration')
# A driver may well state more than the noise at rest, for what motion adds; but ten times as much
# is of no sensor, and half of it is more certain than the noise that everybody can see.
_LEAST, _MOST = 0.5, 10.0


@dataclass
class Stated:
    """What the messages state of one quantity, summed up message by message.

    Attributes:
        messages: How many there are.
        not_reported: Those whose first element is -1: there is no such sensor.
        zero: Those that are all zeros: nobody knows (REP-145).
        impossible: Those that are no covariance: NaN, a negative variance, not symmetric.
        variances: (3,) sums of the diagonals of all others.
    """

    messages: int = 0
    not_reported: int = 0
    zero: int = 0
    impossible: int = 0
    variances: Floats = field(default_factory=lambda: np.zeros(3))

    def add(self, covariances: Floats) -> None:
        """Take the covariances (n, 9) of messages in."""
        not_reported = covariances[:, 0] == -1.0
        zero = (covariances == 0.0).all(axis=1)
        matrices = covariances.reshape(-1, 3, 3)
        diagonals = covariances[:, ::4]
        scale = np.abs(diagonals).max(axis=1, initial=0.0)
        with np.errstate(invalid='ignore'):
            skew = np.abs(matrices - matrices.transpose(0, 2, 1)).max(axis=(1, 2), initial=0.0)
            bad = ~(diagonals >= 0.0).all(axis=1) | ~np.isfinite(covariances).all(axis=1)
            bad |= ~(skew <= 1e-6 * scale)
        bad &= ~not_reported
        self.messages += len(covariances)
        self.not_reported += int(not_reported.sum())
        self.zero += int(zero.sum())
        self.impossible += int(bad.sum())
        self.variances += diagonals[~(not_reported | zero | bad)].sum(axis=0)

    @property
    def deviations(self) -> Floats:
        """Root of the mean variances (3,), NaN where none is stated."""
        count = self.messages - self.not_reported - self.zero - self.impossible
        return np.sqrt(self.variances / count) if count else np.full(3, np.nan)


def judge_covariances(
    stated: tuple[Stated, Stated, Stated], rate_noise: Floats, force_noise: Floats
) -> list[Finding]:
    """Say whether what is stated, of QUANTITIES in their order, can be.

    Args:
        stated: By the messages.
        rate_noise: Deviation at rest (3,) in rad/s, NaN without a rest, 0 where counts hide it.
        force_noise: The same of the accelerations in m/s^2.
    """
    named = dict(zip(QUANTITIES, stated, strict=True))
    values: dict[str, Any] = {}
    for name, of in named.items():
        for count in ('not_reported', 'zero', 'impossible'):
            values[f'{name} {count}'] = getattr(of, count)
        values[f'{name} deviation'] = of.deviations
    found = [
        *_zero(named, values),
        *_impossible(named, values),
        *_invented(QUANTITIES[1], 'rad/s', named, rate_noise, values),
        *_invented(QUANTITIES[2], 'm/s^2', named, force_noise, values),
    ]
    if found:
        return found
    known = [name for name in QUANTITIES if np.isfinite(named[name].deviations).all()]
    text = f'plausible for {" and ".join(known)}' if known else 'nothing is reported'
    return [sound('covariances', text, values)]


def _zero(named: Mapping[str, Stated], values: dict[str, Any]) -> Iterator[Finding]:
    # Of an orientation that is not there zeros are the usual slip; `orientation` tells of it.
    if zero := [name for name in QUANTITIES[1:] if named[name].zero]:
        yield fault(
            'zero covariance',
            f'the covariance of {" and ".join(zero)} is all zeros, which means unknown',
            'have the driver state the variance of the noise; some programs take zeros for '
            'certainty, or refuse them (for the rates this filter writes its own)',
            values,
        )


def _impossible(named: Mapping[str, Stated], values: dict[str, Any]) -> Iterator[Finding]:
    if impossible := [name for name in QUANTITIES if named[name].impossible]:
        yield fault(
            'impossible covariance',
            f'the covariance of {" and ".join(impossible)} is impossible: NaN, a negative '
            'variance, or not symmetric',
            'correct the driver; zeros mean unknown, -1 at the first place not reported',
            values,
        )


def _invented(
    name: str, unit: str, named: Mapping[str, Stated], noise: Floats, values: dict[str, Any]
) -> Iterator[Finding]:
    # Values without any noise are coarser than it is, or not measured at all.
    deviations = named[name].deviations
    ratio = deviations / np.where(noise > 0.0, noise, np.nan)
    if (ratio < _LEAST).any() or (ratio > _MOST).any():
        worst = int(np.nanargmax(np.maximum(ratio, 1.0 / np.maximum(ratio, 1e-300))))
        yield fault(
            f'invented covariance of {name}',
            f'the covariance of {name} says a deviation of {deviations[worst]:.2g} {unit} on '
            f'{AXES[worst]}, at rest it is {noise[worst]:.2g}',
            'have the driver state the variance of the noise',
            values,
        )
