"""What the stamps of a recording say: the sample period, bursts, gaps.

Samples are taken to be evenly spaced between gaps, as a sensor takes them, whatever the stamps say:
drivers deliver in bursts, and stamp what they deliver.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gyro_drift_filter.identify.errors import IdentificationError

Integers = NDArray[np.int64]
Bools = NDArray[np.bool_]

# A step of the stamps beyond both is a gap. Bursty delivery waits up to half a second.
GAP_PERIODS = 10.0
GAP_SECONDS = 0.6
BLOCK_SECONDS, LEAST_BLOCK = 2.0, 10
# A step is uneven where it is off by more than this share of the period.
UNEVEN = 0.5


@dataclass(frozen=True)
class Timing:
    """How the samples lie in time.

    Attributes:
        period: In s.
        gaps: (n - 1,) whether the recording is cut between two samples: time is missing there, or
            jumps back.
        uneven: Share of the other steps that are off by more than half a period.
    """

    period: float
    gaps: Bools
    uneven: float

    @property
    def cuts(self) -> int:
        """Number of gaps."""
        return int(self.gaps.sum())


def learn_timing(stamps: Integers) -> Timing:
    """Learn the sample period from blocks of two seconds, and find the gaps.

    Args:
        stamps: (n,) in ns.

    Raises:
        IdentificationError: The stamps don't advance.
    """
    steps = np.diff(stamps) * 1e-9
    usual = float(np.median(steps)) if len(steps) else 0.0
    period = _period(np.where(_jumps(steps, usual), 0.0, steps))
    gaps = _jumps(steps, period)
    uneven = np.abs(steps[~gaps] - period) > UNEVEN * period
    return Timing(period, gaps, float(uneven.mean()) if len(uneven) else 0.0)


def _jumps(steps: NDArray[np.float64], period: float) -> Bools:
    return np.abs(steps) > max(GAP_PERIODS * period, GAP_SECONDS)


def _period(steps: NDArray[np.float64]) -> float:
    """Return the median over blocks of the time per sample in s; a block is longer than a burst."""
    seconds = np.maximum.accumulate(np.concatenate([[0.0], np.cumsum(steps)]))
    if not seconds[-1] > 0.0:
        raise IdentificationError(
            'the stamps do not advance: there is no sample rate to be learned'
        )
    edges = np.searchsorted(seconds, np.arange(0.0, seconds[-1], BLOCK_SECONDS))
    edges = np.append(edges[np.append(True, np.diff(edges) >= LEAST_BLOCK)], len(seconds) - 1)
    counts = np.diff(edges)
    used = counts > 0
    if not used.any():
        return float(seconds[-1] / len(steps))
    return float(np.median(np.diff(seconds[edges])[used] / counts[used]))
