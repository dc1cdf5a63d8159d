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

"""Why the sensor is not at rest, in words."""

from gyro_drift_filter.core.rest.records import Obstacle
from gyro_drift_filter.messages.motion_hint import STANDING
from gyro_drift_filter.messages.telemetry import Telemetry

_SIGNALS = (
    *(f'the angular velocity about {axis}' for axis in 'xyz'),
    *(f'the acceleration along {axis}' for axis in 'xyz'),
)
_TEXTS = {
    Obstacle.NONE: 'nothing speaks against it yet',
    Obstacle.FEW_SAMPLES: 'too few samples are usable: others are missing or outliers',
    Obstacle.VARIES: '{} varies more than its noise at rest',
    Obstacle.MOVED: '{} has another mean than just before',
    Obstacle.SCATTERS: 'the mean of {} wanders more than that of noise',
    Obstacle.DRIFTS: 'the mean of {} moves one way, as in a slow turn',
    Obstacle.UNEVEN: '{} varies far more at one time than at another',
    Obstacle.LOUD: '{} varies far more than at the rests before',
    Obstacle.TILTED: '{} has changed since the rest before: gravity has moved',
    Obstacle.PUSHED: '{} has changed since the last rest without a turn: the speed changes',
    Obstacle.NOT_ACCEPTED: 'the rate is not accepted as the bias: it is beyond bias.max, '
    'or that of a slow turn, or such a turn has just ended',
    Obstacle.HINTED_MOTION: 'the robot says on motion_hint that it moves, with at least '
    f'{STANDING:g} m/s or rad/s',
}


def why_not_at_rest(state: Telemetry) -> str:
    """Return what showed last that the sensor was not at rest, or that it is at rest."""
    if state.at_rest:
        return 'at rest'
    return _TEXTS[Obstacle(state.rest_obstacle)].format(_SIGNALS[state.rest_obstacle_signal])
