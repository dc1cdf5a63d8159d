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

"""Pieces of sentences that are alike in all commands."""

import math
from collections.abc import Iterable, Sequence
from decimal import Decimal


def counted(count: int, what: str) -> str:
    """Return a count with its noun, as '1 rest' or '2 rests'."""
    return f'{count} {what}{"" if count == 1 else "s"}'


def plain(value: float, digits: int = 3) -> str:
    """Return a number rounded to so many digits, without an exponent: 3600 instead of 3.6e+03."""
    return f'{Decimal(f"{value:.{digits}g}"):f}'


def by_axis(values: Iterable[object]) -> str:
    """Return three values, each behind the name of its axis."""
    return ', '.join(f'{axis} {value}' for axis, value in zip('xyz', values, strict=True))


def time_to_stand(needed: int) -> str:
    """Return for how long a robot shall stand where the first rest needs so many s."""
    seconds = math.ceil(1.5 * needed)
    return 'ten seconds' if seconds <= 10 else f'{seconds} seconds'


def why_no_rest(seconds: float, needed: float, messages: int) -> str:
    """Return why there was no rest in a recording of so many s, where the first needs so many."""
    whole = math.ceil(needed)
    if messages == 1:
        return f'one message is too short a recording for a rest of {whole} s'
    if seconds >= needed:
        return f'the sensor never stood still for {whole} s'
    return f'the recording of {seconds:.3g} s is too short for a rest of {whole} s'


def named_axes(names: Sequence[str]) -> str:
    """Return names of axes behind what they are, as 'axis x' or 'axes x, y'."""
    return f'{"axes" if len(names) > 1 else "axis"} {", ".join(names)}'


def without_rate(known: Sequence[bool], largest: float) -> str:
    """Return which axes had no rate, from whether each had one; empty where all had.

    Args:
        known: For x, y and z.
        largest: Rate in rad/s beyond which it is none.
    """
    silent = [axis for axis, is_known in zip('xyz', known, strict=True) if not is_known]
    if not silent:
        return ''
    about = '' if len(silent) == len(known) else f' about {" and ".join(silent)}'
    return f'no rate{about} is a number of at most {largest:.0f} rad/s'


def rounded_down(value: float) -> str:
    """Return a number as text with one decimal, rounded down so as not to seem to reach a limit."""
    # Less than a millionth of the last digit is an error of rounding.
    return f'{math.floor(10 * value + 1e-6) / 10:.1f}'
