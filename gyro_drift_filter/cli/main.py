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

"""Entry point of `gyro_drift`."""

import os
import sys
from collections.abc import Sequence


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command and return its exit status, see `command.run`."""
    # Before numpy is loaded: it starts a thread for each processor, which waits busily for products
    # of matrices, and takes 70 ms for that. None is large enough here to gain by them.
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')
    # Loading takes a second. Where it is interrupted, nothing has begun that had to be cleaned up.
    try:
        from gyro_drift_filter.cli.command import run

        return run(sys.argv[1:] if arguments is None else arguments)
    except KeyboardInterrupt:
        print('gyro_drift: interrupted, nothing written', file=sys.stderr)
        return 130


if __name__ == '__main__':
    sys.exit(main())
