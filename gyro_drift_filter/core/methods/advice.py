"""What `/diagnostics` advises where a filter does not fit its sensor: each method has its own."""

from typing import NamedTuple


class Advice(NamedTuple):
    """What to do about one method; without advice of its own a method has these general texts.

    Attributes:
        outliers: Where it diverged, or many samples count as outliers.
        large_innovations: Where innovations are much larger than it expects.
        small_innovations: Where they are far smaller than it expects.
        learns_noise: Whether it learns its noise by itself where model.noise_deviation is 0, so
            that it can't expect too much of it.
    """

    outliers: str = 'look at the raw rates'
    large_innovations: str = 'does its model of noise and motion fit this sensor?'
    small_innovations: str = 'does its model of the noise fit this sensor?'
    learns_noise: bool = False
