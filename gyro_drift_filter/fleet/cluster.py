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

"""A Dask cluster on this machine, or the one that users have."""

import logging
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

import dask
from distributed import Client, LocalCluster

from gyro_drift_filter.errors import GyroDriftFilterError, reason

# What a cluster does by the clock, to be looked at while it works: nobody does, and beside bags of
# a minute it took twice the time of the work on them. Bags take seconds, so seconds do.
_BY_THE_CLOCK = {
    'distributed.worker.profile.enabled': False,
    'distributed.scheduler.active-memory-manager.start': False,
    'distributed.admin.tick.interval': '1s',
    'distributed.admin.system-monitor.interval': '1m',
    'distributed.worker.memory.monitor-interval': '1s',
}


@contextmanager
def local_cluster(workers: int, memory_limit: int) -> Iterator[Client]:
    """Yield a client of processes on this machine, each of one thread and so many bytes at most."""
    # What the cluster says of itself in passing is not for who only waits for a table.
    logging.getLogger('distributed').setLevel(logging.ERROR)
    with dask.config.set(_BY_THE_CLOCK):
        # What it starts inherits this: Ctrl-C, and a terminal that is closed, reach all processes,
        # and those that end for that print tracebacks. This one ends them. The tracker is started
        # before, as starting it lets the interrupt through again.
        resource_tracker.ensure_running()
        before = signal.pthread_sigmask(signal.SIG_BLOCK, (signal.SIGINT, signal.SIGHUP))
        cluster = LocalCluster(
            n_workers=0,  # they start below, in seconds, where an interrupt closes the cluster
            threads_per_worker=1,
            processes=True,
            memory_limit=memory_limit,
            host='127.0.0.1',
            # No dashboard: it would show the work to all who reach this machine.
            dashboard_address='127.0.0.1:0',
            scheduler_kwargs={'dashboard': False},
            # Of its processes. They outlive the scheduler by a moment, and each that meanwhile asks
            # it prints a traceback; what fails with a bag is in the table.
            silence_logs=logging.CRITICAL,
        )
        with cluster:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
            with Client(cluster) as client:
                cluster.scale(workers)
                yield client


@contextmanager
def cluster_at(address: str) -> Iterator[Client]:
    """Yield a client of the scheduler at an address.

    Raises:
        GyroDriftFilterError: None answers there.
    """
    logging.getLogger('distributed').setLevel(logging.ERROR)
    try:
        client: Client = Client(address, timeout='20s')
    except (OSError, ValueError) as error:
        raise GyroDriftFilterError(
            f'no Dask scheduler answers at {address}: {reason(error)}'
        ) from error
    with client:
        yield client
