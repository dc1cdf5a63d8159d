"""The filter methods, one module each."""

from gyro_drift_filter.core.methods import adaptive, paper
from gyro_drift_filter.core.methods.advice import Advice

_ADVICE = {'kalman': paper.ADVICE, 'sage_husa': paper.ADVICE, 'adaptive': adaptive.ADVICE}


def advice_of(method: str) -> Advice:
    """Return the advice of a method by its name; general texts for one that has none."""
    return _ADVICE.get(method) or Advice()
