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

"""What `/diagnostics` advises where a filter does not fit its sensor: each method has its own."""

from typing import NamedTuple


class Advice(NamedTuple):
    """What to do about one method; without advice of its own a method has these general texts.

    Attributes:
        outliers: Where it diverged, or many samples count as outliers.
        large_innovations: Where innovations are much larger than it expects.
        small_innovations: Where they are far smaller than it expects.
        learns_noise: Whether it learns its noise from blocks of rest where model.noise_deviation is
            0, as `adaptive` does, so that it can't expect too much of it; `Telemetry` has how many
            blocks those were.
    """

    outliers: str = 'look at the raw rates'
    large_innovations: str = (
        'give its model more noise or faster motion, as this sensor has, or set method to adaptive'
    )
    small_innovations: str = (
        'give its model less noise, as this sensor has, or set method to adaptive'
    )
    learns_noise: bool = False
