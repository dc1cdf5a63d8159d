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

"""Some fuzzing, and all that it has found so far.

`python -m support.fuzz --seed N` tries other inputs.
"""

import pytest

from support.fuzz import CORPUS, TARGETS, check, fuzz

pytestmark = pytest.mark.slow

INPUTS = {'cdr': 30_000, 'mcap': 6000, 'recovery': 2000, 'parameters': 1500, 'memory': 12_000}
KEPT = sorted(path for path in CORPUS.glob('*/*') if path.is_file())


@pytest.mark.parametrize('path', KEPT, ids=lambda path: f'{path.parent.name}/{path.name}')
def test_what_was_found_before(path, tmp_path):
    check(path.parent.name, path.read_bytes(), tmp_path)


@pytest.mark.parametrize('name', TARGETS)
def test_inputs_that_nobody_meant(name):
    fuzz(name, INPUTS[name])
