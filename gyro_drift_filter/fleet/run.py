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

"""All bags on a Dask cluster: it hands them out, and again where a worker is lost."""

import logging
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from distributed import Client, Future, as_completed

from gyro_drift_filter.errors import GyroDriftFilterError
from gyro_drift_filter.fleet.bag_report import report_path
from gyro_drift_filter.fleet.measuring import Job, Result, Row, content_of, measure, written_path
from gyro_drift_filter.fleet.results import Results
from gyro_drift_filter.fleet.sources import Bag

# Tasks that go to the scheduler in one message.
_BATCH = 500
# s: a process that was killed is there again within a few seconds, also on a machine that is busy.
_PATIENCE = 30.0
# s: between two looks for results, and for workers.
_PAUSE, _LOOK = 0.02, 2.0
_LOGGER = logging.getLogger('gyro_drift_filter')


class FleetRun:
    """One run over all bags.

    Attributes:
        reused: Bags that an earlier run has measured.
        measured: Bags that this one has.
        kept: Bags that are not measured again where this run ends: failures of a store are. None
            while those of an earlier run are looked for.
    """

    def __init__(self, bags: Sequence[Bag], job: Job, results: Results, client: Client) -> None:
        self._bags, self._job, self._results, self._client = bags, job, results, client
        self._contents: dict[str, str] = {}  # by address
        self._passing: dict[str, list[Row]] = {}  # by address: rows that are not kept
        self.reused = self.measured = 0
        self.kept: int | None = None

    def run(self, progress: Callable[[int, int], None]) -> None:
        """Measure all bags but those whose content has been: it is hashed, or the store tells it.

        Args:
            progress: Called with the number of bags done and their total.

        Raises:
            GyroDriftFilterError: A result can't be kept, or the processes of this machine die.
        """
        left = list(self._bags)
        if self._results.are_there():
            left = self._not_measured()
        self.reused = self.kept = len(self._bags) - len(left)
        for bag, result in self._each(measure, left, job=self._job):
            if not isinstance(result, Result):
                result = Result('', [{'error': result}], lasting=False)
            self._contents[bag.address] = result.content
            if result.lasting and result.content:
                self._results.keep(bag, result)
                self.kept += 1
            else:
                self._passing[bag.address] = result.rows
            self.measured += 1
            progress(self.reused + self.measured, len(self._bags))

    def rows(self) -> Iterator[Row]:
        """Yield the rows of the table, in their order."""
        for bag in sorted(self._bags, key=lambda bag: (bag.robot, bag.source)):
            rows = self._passing.get(bag.address)
            if rows is None:
                rows = self._results.rows(self._contents[bag.address])
            place = {'robot': bag.robot, 'source': bag.source}
            yield from (place | row for row in rows)

    def _not_measured(self) -> list[Bag]:
        """Return the bags that have to be measured."""
        known = self._results.checksums()
        for bag in self._bags:
            if bag.checksum in known:
                self._contents[bag.address] = known[bag.checksum]
        to_be_read = [bag for bag in self._bags if bag.address not in self._contents]
        for bag, content in self._each(content_of, to_be_read):
            self._contents[bag.address] = str(content)
        return [bag for bag in self._bags if not self._is_done(bag)]

    def _is_done(self, bag: Bag) -> bool:
        """Tell whether all that is made of a bag is there."""
        content = self._contents[bag.address]
        if not self._results.has(content):
            return False
        if all(row.get('error') for row in self._results.rows(content)):
            return True
        bags, reports = self._job.bags, self._job.reports
        return (bags is None or written_path(bags, bag).exists()) and (
            reports is None or report_path(reports, content).exists()
        )

    def _each(
        self, work: Callable[..., Any], bags: Sequence[Bag], **arguments: Any
    ) -> Iterator[tuple[Bag, Any]]:
        """Yield each bag with what the cluster has made of it, or in words why it has not."""
        futures = self._client.map(work, bags, pure=False, batch_size=_BATCH, **arguments)
        by_key = {future.key: bag for future, bag in zip(futures, bags, strict=True)}
        # By its own loop: that of another client in this process is another thread.
        loop = self._client.loop
        coming = as_completed(futures, loop=loop, with_results=True, raise_errors=False)
        futures.clear()  # so that each result goes when it is here
        workers = _Workers(self._client)
        while not coming.is_empty():
            if not coming.has_ready():
                workers.watch()
                time.sleep(_PAUSE)
                continue
            future, result = next(coming)
            bag = by_key.pop(future.key)
            yield bag, result if future.status == 'finished' else _why(future)


class _Workers:
    """Whether anybody works: Dask waits for ever for who is not there."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._seen = self._looked = time.monotonic()
        self._is_told = False

    def watch(self) -> None:
        """Tell where the scheduler has had no worker for long.

        Raises:
            GyroDriftFilterError: It is the one of this machine, which starts no others.
        """
        now = time.monotonic()
        if now < self._looked + _LOOK:
            return
        self._looked = now
        if self._client.nthreads():
            self._seen, self._is_told = now, False
        if now < self._seen + _PATIENCE:
            return
        if self._client.cluster is not None:
            raise GyroDriftFilterError(
                'all worker processes have died, as where memory runs out: raise --memory-limit, '
                'or lower --workers, and go on with --resume'
            )
        if not self._is_told:
            self._is_told = True
            _LOGGER.warning('the scheduler has no worker: waiting for one')


def _why(future: Future) -> str:
    """Return in words why there is no result: the work itself raises nothing."""
    error = future.exception()
    if type(error).__name__ == 'KilledWorker':
        return 'each worker that took it was killed, as where memory runs out'
    return f'the worker failed: {type(error).__name__}'
