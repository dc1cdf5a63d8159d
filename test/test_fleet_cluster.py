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

"""Fleets on a cluster of other processes, one of which dies, and bags on an object store."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress
from functools import partial

import psutil
import pytest
from distributed import Client

from gyro_drift_filter.cli.main import main
from gyro_drift_filter.fleet.cluster import local_cluster
from harness.fleet_recordings import FleetSettings, write_fleet
from support.fleets import SECRET, cluster, rows_without, run_fleet

pytestmark = pytest.mark.slow

HOST = '127.0.0.1'


@pytest.fixture(scope='module')
def robots(tmp_path_factory):
    """Path of a fleet of three robots with six bags each, of which two are broken."""
    folder = tmp_path_factory.mktemp('fleet') / 'robots'
    write_fleet(folder, FleetSettings(3, 6, 10.0, faults={}, broken_every=10))
    return folder


@pytest.fixture(scope='module')
def table(robots, tmp_path_factory):
    """Path of the table that one process alone makes."""
    out = tmp_path_factory.mktemp('out') / 'out'
    with cluster() as client:
        run_fleet(client, robots, out)
    return out / 'fleet.parquet'


def free_port():
    with socket.socket() as found:
        found.bind((HOST, 0))
        return found.getsockname()[1]


def start(*arguments):
    return subprocess.Popen(
        [sys.executable, '-m', 'distributed.cli.' + arguments[0], *arguments[1:]],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )


def end(process):
    if process.poll() is None:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait(20)


def test_a_worker_that_is_killed_costs_time_alone(robots, table, tmp_path):
    """A scheduler and two workers, as users start them; one is killed while it measures."""
    address = f'tcp://{HOST}:{free_port()}'
    scheduler = start(
        'dask_scheduler', '--host', HOST, '--port', address.rpartition(':')[2], '--no-dashboard'
    )
    workers = [
        start(
            'dask_worker', address, '--nthreads', '1', '--no-nanny', '--no-dashboard',
            '--memory-limit', '2GB', '--local-directory', str(tmp_path / f'worker{k}'),
        )
        for k in range(2)
    ]  # fmt: skip
    try:
        with Client(address, timeout='60s') as client:
            client.wait_for_workers(2, timeout=60)
            lost = set(client.scheduler_info()['workers'])

            def progress(done, total):
                if done == 4:
                    assert client.processing()
                    workers[0].send_signal(signal.SIGKILL)

            run = run_fleet(client, robots, tmp_path / 'out', progress)
            assert run.measured == 18
            left = set(client.scheduler_info()['workers'])
            assert len(left) == 1
            assert left < lost
        assert (tmp_path / 'out' / 'fleet.parquet').read_bytes() == table.read_bytes()
        # The command finds the same scheduler.
        arguments = ['-o', str(tmp_path / 'out'), '--resume', '--scheduler', address, '--quiet']
        assert main(['fleet', str(robots), *arguments]) == 0
        assert (tmp_path / 'out' / 'fleet.parquet').read_bytes() == table.read_bytes()
    finally:
        for process in (*workers, scheduler):
            end(process)


def test_processes_that_end_say_nothing(monkeypatch, capfd):
    """They ask for the scheduler after it has ended; here all the time instead of now and then."""
    monkeypatch.setattr('distributed.scheduler.heartbeat_interval', lambda workers: 0.002)
    with local_cluster(2, 2 * 10**9) as client:
        assert client.submit(sum, (1, 2)).result() == 3
        time.sleep(1.5)
    assert capfd.readouterr() == ('', '')


def test_an_interrupt_while_processes_start_says_nothing(robots, tmp_path):
    """Ctrl-C reaches all processes; one that starts takes a second in which it is not ready."""
    with subprocess.Popen(
        [sys.executable, '-m', 'gyro_drift_filter.cli.main', 'fleet', str(robots),
         '-o', str(tmp_path / 'out'), '--workers', '2', '--quiet'],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # Tests that run in the background inherit that interrupts are ignored.
        preexec_fn=partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    ) as process:  # fmt: skip
        end = time.monotonic() + 60
        while not any('spawn_main' in command for command in commands_of(started_by(process))):
            assert time.monotonic() < end
            time.sleep(0.01)
        time.sleep(0.2)
        os.killpg(process.pid, signal.SIGINT)
        _, log = process.communicate(timeout=60)
    assert process.returncode == 130
    assert log.startswith('gyro_drift fleet: interrupted')
    assert log.count('\n') == 1


def started_by(process):
    with suppress(psutil.NoSuchProcess):
        return psutil.Process(process.pid).children()
    return []


def commands_of(processes):
    """Yield the command lines of processes, but of those that have ended meanwhile."""
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            yield ' '.join(process.cmdline())


@pytest.fixture
def bucket(robots, monkeypatch):
    """Address of a bucket with the bags, in a server on this machine."""
    moto = pytest.importorskip('moto.server')
    boto3 = pytest.importorskip('boto3')
    pytest.importorskip('s3fs')
    server = moto.ThreadedMotoServer(ip_address=HOST, port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    for name, value in {
        'AWS_ACCESS_KEY_ID': f'key-{SECRET}',
        'AWS_SECRET_ACCESS_KEY': SECRET,
        'AWS_DEFAULT_REGION': 'us-east-1',
        'AWS_ENDPOINT_URL': f'http://{host}:{port}',
        'AWS_EC2_METADATA_DISABLED': 'true',
    }.items():
        monkeypatch.setenv(name, value)
    store = boto3.client('s3')
    store.create_bucket(Bucket='fleet')
    for path in sorted(robots.rglob('*')):
        if path.is_file():
            store.upload_file(str(path), 'fleet', f'robots/{path.relative_to(robots)}')
    yield 's3://fleet/robots'
    server.stop()


@pytest.mark.filterwarnings('ignore::DeprecationWarning', 'ignore::ResourceWarning')
def test_bags_in_an_object_store(bucket, table, tmp_path, capfd):
    """The same table as of the folder, through the command, and nothing secret anywhere."""
    out = tmp_path / 'out'
    assert main(['fleet', bucket, '-o', str(out), '--workers', '1']) == 0
    got, expected = (rows_without(path, 'source') for path in (out / 'fleet.parquet', table))
    assert got == expected
    told = ''.join(capfd.readouterr())
    assert 's3://fleet/robots/robot_00/day_00: the bag can not be read' in told
    # The store tells that nothing has changed: nothing is read once more.
    with cluster() as client:
        run = run_fleet(client, bucket, out)
    assert (run.reused, run.measured) == (18, 0)
    assert main(['fleet', 's3://nobucket/x', '-o', str(tmp_path / 'none')]) == 1
    told += ''.join(capfd.readouterr())
    assert SECRET not in told
    for path in out.rglob('*'):
        assert path.is_dir() or SECRET.encode() not in path.read_bytes()
