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

"""Compile the kernels in both ways that the tests compare: as an extension module, and by numba.

    PYTHONPATH=test python -m support.compiling

`gyro_drift compile` makes the extension module alone. For both, numba finds the types in kernels
that others call and translates them, which is half of the work; here it is done once.
"""

import os
import signal
import sys
import traceback
from importlib import import_module

from gyro_drift_filter.accelerate import cache
from gyro_drift_filter.accelerate.kernels import ENTRY_KERNELS, is_compiled, is_extension
from gyro_drift_filter.cli.main import main

# It calls nearly all kernels that others call, which are ready for both ways then.
CALLS_MOST = 'gyro_drift_filter_messages_message_filter_filter_imus'


def compile_by_numba() -> int:
    """Start a process that compiles all entry kernels by numba; return its number."""
    from gyro_drift_filter.accelerate.ahead import fill_cache
    from gyro_drift_filter.accelerate.numba_internals import compile_declared

    for name in cache.kernel_modules():
        import_module(name)
    entry = ENTRY_KERNELS[CALLS_MOST]
    compile_declared(entry.compiled, entry.types)
    process = os.fork()
    if process != 0:
        return process
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        fill_cache()
    except Exception:
        traceback.print_exc()
        os._exit(1)
    os._exit(0)


def compile_both() -> int:
    """Compile what is missing; return the exit status."""
    if is_extension() or not is_compiled() or cache.why_unusable():
        return main(['compile'])
    process = compile_by_numba()
    status = main(['compile'])
    _, ended = os.waitpid(process, 0)
    return status or os.waitstatus_to_exitcode(ended)


if __name__ == '__main__':
    sys.exit(compile_both())
