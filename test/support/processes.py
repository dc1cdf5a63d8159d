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

"""Other processes."""

import os
import subprocess
from collections.abc import Mapping
from typing import Any


def run_command(
    *command: object, environment: Mapping[str, str] | None = None, **options: Any
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; return its status and what it has printed.

    Args:
        command: Its words.
        environment: What differs from that of the tests.
        options: Others of `subprocess.run`.
    """
    return subprocess.run(
        list(map(str, command)),
        env=os.environ | dict(environment or {}),
        capture_output=True,
        text=True,
        check=False,
        **{'timeout': 120, **options},
    )
