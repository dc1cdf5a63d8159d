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

"""Find bags under folders, patterns and addresses of stores, and never show a credential."""

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from fsspec.core import url_to_fs

from gyro_drift_filter.bags.opening import FILE_SUFFIXES
from gyro_drift_filter.errors import GyroDriftFilterError, printable
from gyro_drift_filter.fleet.streamed import Content, StreamedPath

# No question mark: behind it addresses have what they are signed with.
_PATTERN = re.compile(r'[*\[]')
_METADATA = 'metadata.yaml'
# What stores say of a file that changes with its content: S3, Google's, Azure's.
_CHECKSUMS = ('ETag', 'md5Hash', 'crc32c', 'content_md5', 'etag')
# user:password@ behind ://, and what follows a question mark, where signed addresses have theirs.
_USER = re.compile(r'(?<=://)[^/\s@]*@')
_QUERY = re.compile(r'(\b[a-z][a-z0-9+.-]*://[^\s?#\'"]*)[?#][^\s\'")]*', re.IGNORECASE)


def shown(text: str) -> str:
    """Return text in one line, with the addresses in it without user, password and query."""
    return printable(_QUERY.sub(r'\1', _USER.sub('', text)))


def _is_remote(address: str) -> bool:
    """Tell whether an address names a store instead of a path of this machine."""
    return '://' in address or '::' in address


@dataclass(frozen=True)
class Bag:
    """A bag in a store.

    Attributes:
        source: Its address as it may be shown.
        robot: Whose it is.
        below: Its path below what it was found by, or below what stands before a pattern's first
            star; the name where it was named itself.
        sizes: In bytes, of its files by their paths below the bag's; '' where it is one file.
        checksum: What the store says of its content; empty where it says nothing.
        address: With the credentials that it may hold: not to be shown.
    """

    source: str
    robot: str
    below: str
    sizes: Mapping[str, int]
    checksum: str
    address: str = field(repr=False)

    @contextmanager
    def opened(self) -> Iterator[StreamedPath]:
        """Open the bag in its store.

        Raises:
            GyroDriftFilterError: The store can't be reached.
        """
        files, path = _store(self.address)
        contents = {
            place: Content(files, f'{path}/{place}' if place else path, size)
            for place, size in self.sizes.items()
        }
        try:
            yield StreamedPath(contents, '', '' if '' not in contents else _suffix(path))
        finally:
            for content in contents.values():
                content.close()


def _suffix(path: str) -> str:
    return PurePosixPath(shown(path)).suffix


def _store(address: str) -> tuple[Any, str]:
    """Return the file system of an address, and the path in it."""
    try:
        files, path = url_to_fs(address)
    except (ImportError, ValueError, OSError) as error:
        raise GyroDriftFilterError(
            f'{shown(address)} can not be opened: {shown(str(error))}'
        ) from None
    return files, path


def find_bags(sources: Sequence[str], robot: str | None, without: Path | None = None) -> list[Bag]:
    """Return all bags under folders, patterns and addresses, in the order of what is shown of them.

    A folder with a metadata.yaml is a bag, and so is each .mcap, .db3 or .bag file that is in none.
    Hidden folders are passed over, as in them stands what is not finished.

    Args:
        sources: Paths, patterns with `*`, or addresses that fsspec knows.
        robot: Regular expression, whose first group in a bag's address is the name of its robot;
            None for the name of the folder that the bag is in.
        without: Folder whose bags are left out, as those that are written themselves.

    Raises:
        GyroDriftFilterError: There is none under one of them, a store can't be reached, or the
            expression does not fit a bag.
    """
    try:
        pattern = None if robot is None else re.compile(robot)
    except re.error as error:
        raise GyroDriftFilterError(f'--robot {robot} is no regular expression: {error}') from error
    if pattern is not None and not pattern.groups:
        raise GyroDriftFilterError(f'--robot {robot} has no group: put the name in parentheses')
    found: dict[str, Bag] = {}
    for source in sources:
        bags = [bag for bag in _bags_under(source, pattern) if not _is_within(bag, without)]
        if not bags:
            raise GyroDriftFilterError(f'no bag under {shown(source)}')
        found |= {bag.address: bag for bag in bags}
    return sorted(found.values(), key=lambda bag: bag.source)


def _bags_under(source: str, pattern: re.Pattern[str] | None) -> Iterator[Bag]:
    files, root = _store(source)
    try:
        magic = _PATTERN.search(root)
        if magic and files.exists(root):
            magic = None  # a name with brackets
        above = root[: magic.start()].rpartition('/')[0] if magic else ''
        for top in sorted(files.glob(root)) if magic else [root]:
            yield from _bags_in(files, source, top, above or top, pattern)
    except FileNotFoundError:
        return
    except GyroDriftFilterError:
        raise
    except Exception as error:  # each store has its own
        raise GyroDriftFilterError(
            f'{shown(source)} can not be listed: {type(error).__name__}: {shown(str(error))}'
        ) from None


def _bags_in(
    files: Any, source: str, top: str, above: str, pattern: re.Pattern[str] | None
) -> Iterator[Bag]:
    """Yield the bags that a path `top` of a file system is or holds, named from `above` on."""
    named = files.info(top)
    is_bag = named['type'] == 'file' and shown(top).endswith(FILE_SUFFIXES)
    details = {top: named} if is_bag else _files_under(files, top)
    folders = {path.rpartition('/')[0] for path in details if path.endswith(f'/{_METADATA}')}
    bags: dict[str, dict[str, Any]] = {}
    for path, detail in details.items():
        folder = path.rpartition('/')[0]
        if _hidden(path[len(top) :]):
            continue
        if folder in folders:
            bags.setdefault(folder, {})[path[len(folder) + 1 :]] = detail
        elif shown(path).endswith(FILE_SUFFIXES):
            bags[path] = {'': detail}
    for path, of_bag in bags.items():
        address = path
        if _is_remote(source):
            address = _with_path(files, source, path)
        name = shown(address)
        folder_name = PurePosixPath(name).parent.name
        robot = folder_name if pattern is None else _robot_of(name, pattern)
        below = path[len(above) :].strip('/') or PurePosixPath(name).name
        sizes = {place: int(detail['size']) for place, detail in sorted(of_bag.items())}
        yield Bag(name, robot, below, sizes, _checksum(of_bag, source), address)


def _files_under(files: Any, top: str) -> dict[str, Any]:
    """Return what a file system says of each file under a path, links to folders included.

    A link is passed over that leads to what is found without it, or to what it stands in itself.
    """
    details: dict[str, Any] = {}
    pending, known = [top], [Path(top).resolve()]
    while pending:
        for path, detail in files.find(pending.pop(), detail=True).items():
            link = Path(path)
            if not (detail.get('islink') and link.is_dir()):
                details[path] = detail
                continue
            folder = link.resolve()
            is_within = link.parent.resolve().is_relative_to(folder)
            if not (is_within or any(folder.is_relative_to(other) for other in known)):
                known.append(folder)
                pending.append(path)
    return details


def _is_within(bag: Bag, folder: Path | None) -> bool:
    path = bag.address.removeprefix('file://')
    if folder is None or _is_remote(path):
        return False
    return Path(path).resolve().is_relative_to(folder.resolve())


def _hidden(below: str) -> bool:
    """Tell whether a path is in a hidden folder, as what a replay has not finished is."""
    return any(part.startswith('.') for part in below.split('/'))


def _with_path(files: Any, source: str, path: str) -> str:
    """Return an address as the source is, user and query included, of another path."""
    address: str = files.unstrip_protocol(path)
    begin, _, rest = source.partition('://')
    user = rest.split('/', 1)[0].rpartition('@')
    if user[1] and '@' not in address:
        address = address.replace('://', f'://{user[0]}@', 1)
    query = source.partition('?')
    return address + query[1] + query[2] if begin and '?' not in address else address


def _robot_of(name: str, pattern: re.Pattern[str]) -> str:
    match = pattern.search(name)
    if match is None or match[1] is None:
        raise GyroDriftFilterError(f'--robot {pattern.pattern} finds no name in {name}')
    return match[1]


def _checksum(details: Mapping[str, Any], source: str) -> str:
    """Return what the store says of the content of all files, empty where it does not of one."""
    said = []
    for place, detail in sorted(details.items()):
        of_file = next((str(detail[name]) for name in _CHECKSUMS if detail.get(name)), '')
        if not of_file:
            return ''
        said.append(f'{place}:{of_file.strip(chr(34))}:{detail["size"]}')
    return f'{source.partition("://")[0]}:' + ','.join(said)
