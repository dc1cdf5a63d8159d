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

"""Fleets of simulated robots, and a Dask cluster within the process."""

from contextlib import contextmanager

from distributed import Client, LocalCluster

from gyro_drift_filter.core import Parameters
from gyro_drift_filter.fleet.columns import read_table, write_table
from gyro_drift_filter.fleet.measuring import Job
from gyro_drift_filter.fleet.results import Results
from gyro_drift_filter.fleet.run import FleetRun
from gyro_drift_filter.fleet.sources import find_bags

SECRET = 'very-secret'


@contextmanager
def cluster(workers=1):
    """Yield a client of a cluster whose workers, if any, are threads of this process."""
    with (
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=False,
            dashboard_address='127.0.0.1:0',
            scheduler_kwargs={'dashboard': False},
        ) as made,
        Client(made) as client,
    ):
        yield client


def run_fleet(client, source, out, progress=lambda done, total: None, **job):
    """Measure all bags under a source into a folder; return the run, whose table is written."""
    out.mkdir(exist_ok=True)
    results = Results(out / 'results', Parameters())
    run = FleetRun(find_bags([str(source)], None), Job(Parameters(), **job), results, client)
    run.run(progress)
    write_table(out / 'fleet.parquet', run.rows())
    return run


def rows_without(path, *columns):
    """Return the rows of a table without some of its columns."""
    return read_table(path).drop_columns(list(columns)).to_pylist()
