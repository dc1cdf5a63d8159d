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

"""Whether the driver now and then sends the values of the previous sample once more.

The filter counts rates that repeat where noise or motion forbid it. Here all six values are
compared, over the whole recording; without an accelerometer the three rates. How often they are
equal by chance is known from the sample two before: by chance a sample equals that one as often as
the previous one.
"""

from gyro_drift_filter.doctor.findings import Finding, fault, sound
from gyro_drift_filter.identify.repeats import count_repeats
from gyro_drift_filter.identify.series import Values

# So large a share of messages that come twice is no accident of the line.
_DOUBLED_SHARE = 0.05


def judge_doubles(doubles: int, messages: int) -> list[Finding]:
    """Say whether messages come twice, with stamp and rates: so many of all do."""
    if doubles <= _DOUBLED_SHARE * messages:
        return []
    return [
        fault(
            'doubled messages',
            f'{doubles} of {messages} messages come once more, with the same stamp and rates',
            'is the topic published twice, or recorded twice? The filter passes over them, but '
            'other programs may not',
            {'doubled': doubles},
        )
    ]


def judge_repeats(rates: tuple[Values, ...], accelerations: tuple[Values, ...]) -> Finding:
    """Say whether samples of rates and accelerations, three columns (n,) each, are repeated."""
    repeats = count_repeats(rates, accelerations)
    found = {'repeated': repeats.repeated, 'times': repeats.runs, 'by_chance': repeats.by_chance}
    if not repeats.are_repeats:
        return sound('repeats', 'no sample is repeated', found)
    return fault(
        'repeats',
        f'every value is that of the sample before in {repeats.repeated} samples '
        f'({100.0 * repeats.share:.3g} %), {repeats.runs} times',
        'the bus or the driver hangs, or polls faster than the sensor measures: poll on its '
        'data-ready signal, and do not publish the same sample twice',
        found,
    )
