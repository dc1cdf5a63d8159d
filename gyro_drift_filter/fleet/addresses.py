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

"""Addresses of bags, and what of them and of errors may be shown: never a credential."""

import re

from gyro_drift_filter.errors import printable

# user:password@ behind ://, and what follows a question mark, where signed addresses have theirs.
_USER = re.compile(r'(?<=://)[^/\s@]*@')
_QUERY = re.compile(r'(\b[a-z][a-z0-9+.-]*://[^\s?#\'"]*)[?#][^\s\'")]*', re.IGNORECASE)


def shown(text: str) -> str:
    """Return text in one line, with the addresses in it without user, password and query."""
    return printable(_QUERY.sub(r'\1', _USER.sub('', text)))


def is_remote(address: str) -> bool:
    """Tell whether an address names a store instead of a path of this machine."""
    return '://' in address or '::' in address
