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

from collections.abc import Iterable


def counted(count: int, what: str) -> str:
    """Return a count with its noun, as '1 rest' or '2 rests'."""
    return f'{count} {what}{"" if count == 1 else "s"}'


def by_axis(values: Iterable[object]) -> str:
    """Return three values, each behind the name of its axis."""
    return ', '.join(f'{axis} {value}' for axis, value in zip('xyz', values, strict=True))
