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

"""YAML as rcl reads it, where that is not as PyYAML does; needs PyYAML."""

import re
from typing import Any, cast

import yaml

_TAG = 'tag:yaml.org,2002:'
_TEXT = f'{_TAG}str'
_BOOLEANS = {'y': True, 'yes': True, 'true': True, 'on': True}
_BOOLEANS |= {'n': False, 'no': False, 'false': False, 'off': False}


class RclLoader(yaml.SafeLoader):
    """Loads a mapping as a tuple of its pairs, as a key may be there several times.

    A scalar is what it looks like, whatever its tag, and what is quoted is text: 2e-5 is a number,
    where PyYAML wants 2.0e-5, and 1_0 is none.
    """

    bool_values = _BOOLEANS

    def compose_node(self, parent: Any, index: Any) -> Any:
        """Take no aliases: a few lines of them can stand for more values than there is memory.

        Raises:
            YAMLError: There is one.
        """
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError('aliases (*name) are not taken')
        return super().compose_node(parent, index)

    def compose_scalar_node(self, anchor: Any) -> Any:
        """Pass over the tag, but for that of a text."""
        node: Any = super().compose_scalar_node(anchor)
        if node.tag != _TEXT:
            is_plain, resolver = node.style not in ('"', "'"), cast(Any, self)
            node.tag = resolver.resolve(yaml.ScalarNode, node.value, (is_plain, True))
        return node

    def construct_yaml_map(self, node: Any) -> Any:
        """Return the pairs of a mapping; a key is text, whatever it looks like."""
        return tuple(
            (
                key.value if isinstance(key, yaml.ScalarNode) else self.construct_object(key, True),
                self.construct_object(value, True),
            )
            for key, value in node.value
        )


# The first that fits is taken, and none of PyYAML's own.
RclLoader.yaml_implicit_resolvers = {}
for _tag, _pattern in (
    ('null', ''),
    ('bool', '|'.join(f'{w}|{w.capitalize()}|{w.upper()}' for w in _BOOLEANS)),
    ('int', r'[-+]?(0[0-7]*|[1-9]\d*|0x[\da-fA-F]+)'),
    ('float', r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?|[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)'),
):
    RclLoader.add_implicit_resolver(f'{_TAG}{_tag}', re.compile(rf'({_pattern})\Z'), None)
RclLoader.add_constructor(f'{_TAG}map', RclLoader.construct_yaml_map)
