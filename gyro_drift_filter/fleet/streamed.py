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

"""The files of a bag in a store, read by ranges, and the hash of all that they hold.

fsspec reads a file in blocks as they are asked for and keeps a few of them, so that a bag is never
in memory nor on the disk as a whole. Who reads an MCAP file asks for its end, where the index is,
and then for one chunk after the other. The hash is taken of what passes by on that way; what nobody
has asked for is read at the end.
"""

import hashlib
import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import PurePath, PurePosixPath
from typing import Any, BinaryIO, NamedTuple, Self, cast

# Read at once: large enough for the time to the first byte of an object store, some 50 ms, to be
# small beside the transfer at 100 MB/s.
BLOCK = 2**23
# Kept at a time: the begin, the index at the end, and where the reader is.
_BLOCKS = 4


class Stat(NamedTuple):
    """What is known of a file: its size in bytes."""

    st_size: int


class Content:
    """One file of a store, that several readers share, with the hash of its first bytes.

    Attributes:
        size: In bytes.
        failure: Why the store did not give some part of it; None where it did.
    """

    def __init__(self, files: Any, path: str, size: int) -> None:
        self.size = size
        self.failure: Exception | None = None
        self._files, self._path = files, path
        self._file: Any = None
        self._hash, self._hashed = hashlib.sha256(), 0

    def read(self, offset: int, size: int) -> bytes:
        """Return bytes from an offset on, fewer at the end.

        Raises:
            OSError: The store does not give them.
        """
        # What lies between two chunks is hashed on the way; the index at the end is read first.
        if self._hashed < offset <= self._hashed + BLOCK:
            self._read(self._hashed, offset - self._hashed)
        return self._read(offset, size)

    def _read(self, offset: int, size: int) -> bytes:
        try:
            if self._file is None:
                self._file = self._files.open(
                    self._path,
                    'rb',
                    block_size=BLOCK,
                    cache_type='blockcache',
                    cache_options={'maxblocks': _BLOCKS},
                )
            self._file.seek(offset)
            data = cast(bytes, self._file.read(max(min(size, self.size - offset), 0)))
        except Exception as error:  # each store has its own
            self.failure = error
            raise OSError(f'the store does not give it: {error}') from error
        if offset <= self._hashed < offset + len(data):
            self._hash.update(data[self._hashed - offset :])
            self._hashed = offset + len(data)
        return data

    def digest(self) -> str:
        """Return the SHA-256 of all of it; what has not passed by is read now.

        Raises:
            OSError: The store does not give it.
        """
        while self._hashed < self.size:
            if not self._read(self._hashed, BLOCK):
                raise OSError('the file ends before its size')
        return self._hash.hexdigest()

    def close(self) -> None:
        """Let go of the file."""
        if self._file is not None:
            self._file.close()


class _Reader(io.RawIOBase):
    """A file that is open for reading at a place of its own."""

    def __init__(self, content: Content) -> None:
        super().__init__()
        self._content, self._place = content, 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._place

    def seek(self, offset: int, whence: int = 0) -> int:
        place = (0, self._place, self._content.size)[whence] + offset
        if place < 0:
            raise OSError('no place before the begin of a file')
        self._place = place
        return place

    def read(self, size: int | None = -1) -> bytes:
        whole = size is None or size < 0
        data = self._content.read(self._place, self._content.size if whole else size or 0)
        self._place += len(data)
        return data

    def readinto(self, buffer: Any) -> int:
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)


@dataclass(frozen=True)
class StreamedPath:
    """Stands for a bag in a store, or for a file in it, where readers want a path.

    Its name says nothing of where the bag is: what readers report is about the content alone.

    Attributes:
        contents: The files by their paths below the bag's own; '' is the bag that is one file.
        place: Which of them, or which folder.
        suffix: Of the name.
    """

    contents: Mapping[str, Content]
    place: str
    suffix: str

    @property
    def name(self) -> str:
        """The last part of the path."""
        return PurePosixPath(self.place).name or f'bag{self.suffix}'

    @property
    def stem(self) -> str:
        """The name without its suffix."""
        return self.name.removesuffix(self.suffix)

    def __str__(self) -> str:
        """Return what is said in place of a path."""
        return f'the bag/{self.place}' if self.place else 'the bag'

    def __truediv__(self, key: Self | PurePath | str) -> Self:
        """Return what stands below a folder."""
        place = str(PurePosixPath(self.place) / str(key))
        return type(self)(self.contents, place, PurePosixPath(place).suffix)

    def exists(self) -> bool:
        """Tell whether it is there."""
        return self.place in self.contents or self.is_dir()

    def is_dir(self) -> bool:
        """Tell whether it is a folder: only the bag itself can be one."""
        return not self.place and '' not in self.contents

    def iterdir(self) -> Iterator[Self]:
        """Yield what the folder holds."""
        return (self / place for place in self.contents)

    def glob(self, pattern: str) -> Iterator[Self]:
        """Yield what matches a pattern in the folder."""
        return (path for path in self.iterdir() if fnmatch(path.name, pattern))

    def stat(self, *, follow_symlinks: bool = True) -> Stat:
        """Return what is known of the file."""
        return Stat(self.contents[self.place].size)

    def open(self, *_: Any, **__: Any) -> BinaryIO:
        """Open the file for reading bytes.

        Raises:
            FileNotFoundError: It is not there.
        """
        if self.place not in self.contents:
            raise FileNotFoundError(f'no such file: {self}')
        return cast(BinaryIO, _Reader(self.contents[self.place]))

    def read_text(self, encoding: str | None = None) -> str:
        """Return what a file holds as text."""
        with self.open() as file:
            return file.read().decode(encoding or 'utf-8')


def content_hash(contents: Mapping[str, Content]) -> str:
    """Return the hash of a bag: of its file, or of the names and hashes of its files.

    Raises:
        OSError: The store does not give it all.
    """
    if '' in contents:
        return contents[''].digest()
    lines = [f'{contents[place].digest()}  {place}\n' for place in sorted(contents)]
    return hashlib.sha256(''.join(lines).encode()).hexdigest()
