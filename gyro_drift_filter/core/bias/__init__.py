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

"""The bias of the gyroscope: at rest, in the first seconds, and in motion.

`at_rest.py` tracks it from one rest to the next, by the segments that `core/rest/` finds and
`acceptance.py` accepts; `segments.py` judges several of them together, `slow_turn.py` tells a slow
turn from a bias that has jumped, `shaken_stand.py` has one of a robot that says that it stands and
is never still, and `provisional.py` has one before there is a rest. `in_motion.py` follows the bias
in motion by gravity, by what `core/learning_in_motion.py` gives it, and `without_rest.py` finds it
by that alone where there is no rest; its filter has its state in `motion_state.py`, and prediction
and correction in `motion_filter.py`. `swing.py` says how far a slow swing may put a rest beside the
bias, `contradiction.py` whether rates and accelerations are of one motion. `shared.py` is what is
done to the bias in motion and to that at rest together, `shift.py` what the one is above the other,
and `vibration.py` measures what moves them apart. `records.py` declares the state.
"""
