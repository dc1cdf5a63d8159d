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

"""The columns of the table: one row for each bag, Imu topic and axis."""

from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.parquet as pq

from gyro_drift_filter.errors import GyroDriftFilterError, reason
from gyro_drift_filter.version import package_version
from gyro_drift_filter.whole_file import whole_file


class Column(NamedTuple):
    """A column: its unit is empty where it has none."""

    name: str
    kind: pa.DataType
    unit: str
    text: str


_WHOLE, _NUMBER, _TEXT = pa.int64(), pa.float64(), pa.string()
# Where a bag is and whose: all else follows from its content.
PLACE = (
    Column('robot', _TEXT, '', 'whose bag it is'),
    Column('source', _TEXT, '', 'address of the bag, without credentials'),
)
MEASURED = (
    Column('content', _TEXT, '', 'SHA-256 of what the bag holds; null where it could not be read'),
    Column('topic', _TEXT, '', 'the Imu topic; null where the bag could not be read so far'),
    Column('frame_id', _TEXT, '', 'of the last message'),
    Column('axis', _TEXT, '', 'x, y or z; null where there are no figures'),
    Column('error', _TEXT, '', 'why there are no figures; else null'),
    Column('notes', pa.list_(_TEXT), '', 'what was said on reading, as of a bag that was cut off'),
    Column('start', pa.timestamp('ns', 'UTC'), '', 'log time of the first message of the bag'),
    Column('duration', _NUMBER, 's', 'from then to the last message'),
    Column('messages', _WHOLE, '', 'Imu messages'),
    Column('sample_rate', _NUMBER, 'Hz', 'of the samples'),
    Column('jitter', _NUMBER, 's', 'deviation of the stamps from even steps'),
    Column('gaps', _WHOLE, '', 'times that samples were missing'),
    Column('missing_samples', _WHOLE, '', 'samples that were'),
    Column('repeats', _WHOLE, '', 'samples whose six values are those of the one before'),
    Column('rest', _NUMBER, 's', 'how long the sensor stood still'),
    Column('noise', _NUMBER, 'rad/s', 'deviation of the raw rate at rest'),
    Column('noise_samples', _WHOLE, '', 'samples at rest that it is of'),
    Column('angle_random_walk', _NUMBER, 'rad/s/sqrt(Hz)', 'Allan deviation at 1 s on slope -1/2'),
    Column('bias_instability', _NUMBER, 'rad/s', 'least Allan deviation by 0.664'),
    Column('bias_instability_is_bound', pa.bool_(), '', 'whether it may be less, in a longer rest'),
    Column('bias', _NUMBER, 'rad/s', 'at the end, as the filter learned it'),
    Column('bias_deviation', _NUMBER, 'rad/s', 'its standard deviation, by the filter'),
    Column('bias_trend', _NUMBER, 'rad/s^2', 'mean slope of the bias over the rests; 0 for none'),
    Column('temperature', _NUMBER, 'degC', 'mean of the temperature topic beside the Imu'),
    Column('vibration', _NUMBER, 'rad/s', 'amplitude of the strongest line above motion; 0: none'),
    Column('vibration_frequency', _NUMBER, 'Hz', 'of that line'),
    Column('outlier_share', _NUMBER, '1', 'samples flagged as outliers, of all'),
    Column('consistency', _NUMBER, '1', 'mean of squared innovation by its variance; 1 is ideal'),
    Column('drift_before', _NUMBER, 'rad/s', 'of the heading by the raw rates; the same for axes'),
    Column('drift_after', _NUMBER, 'rad/s', 'deviation of what the filter leaves of it'),
    Column('outcome', _TEXT, '', 'what the filter did: helped, unsure, useless or harmed'),
    Column('faults', pa.list_(_TEXT), '', 'what the doctor found, by name'),
)
COLUMNS = (*PLACE, *MEASURED)
# Rows that are written at once.
_PART = 10_000


def schema() -> pa.Schema:
    """Return the schema; each field says in its metadata what it is, and its unit."""
    fields = [
        pa.field(
            column.name,
            column.kind,
            metadata={'description': column.text} | ({'unit': column.unit} if column.unit else {}),
        )
        for column in COLUMNS
    ]
    return pa.schema(fields, metadata={'made_by': f'gyro_drift_filter {package_version()}'})


def write_table(path: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the table, a part after the other: the same rows make the same bytes.

    Raises:
        GyroDriftFilterError: It can't be written.
    """
    parts, of_table = iter(rows), schema()
    with (
        whole_file(path) as unfinished,
        pq.ParquetWriter(unfinished, of_table, compression='zstd') as writer,
    ):
        while part := list(islice(parts, _PART)):
            writer.write_table(pa.Table.from_pylist(part, of_table))


def failures_in(table: pa.Table) -> list[dict[str, Any]]:
    """Return robot, source and error where a table has no figures, each once, by source."""
    rows = table.select(['robot', 'source', 'error']).to_pylist()
    once = {(row['source'], row['error']): row for row in rows if row['error']}
    return [once[key] for key in sorted(once)]


def read_table(path: Path) -> pa.Table:
    """Return a table that was written.

    Raises:
        GyroDriftFilterError: There is none, or it is another one.
    """
    try:
        table = pq.read_table(path)
    except FileNotFoundError as error:
        raise GyroDriftFilterError(
            f'{path} can not be read, as it is missing: name the folder that `gyro_drift fleet` '
            'has made'
        ) from error
    except (OSError, pa.ArrowException) as error:
        raise GyroDriftFilterError(f'{path} can not be read: {reason(error)}') from error
    if missing := {column.name for column in COLUMNS} - set(table.column_names):
        raise GyroDriftFilterError(f'{path} is no table of a fleet: it has no {min(missing)}')
    return table
