"""A file for HDF5 to write to that never fails: it keeps the first error of the disk for later and goes on in memory.

HDF5 ends the process by a segmentation fault when it closes a file that it could not write. So it is never told. After
the first error, what it writes is kept in memory and read back from there, until the caller sees the error and gives
the file up. Little is written in between: `check` is called after every piece of an array.
"""

import io
from pathlib import Path


class SpoolFile(io.RawIOBase):
    """A new file that is written and read at any place; `check` raises the first OSError that it met."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("x+b", buffering=0)
        self._error: OSError | None = None
        self._place, self._end = 0, 0
        self._kept: list[tuple[int, bytes]] = []  # place and content of what the disk did not take, in order

    def check(self) -> None:
        """Raise the first error of the disk."""
        if self._error is not None:
            raise self._error

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        """Go to a place."""
        self._place = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._place, io.SEEK_END: self._end}[whence]
        return self._place

    def tell(self) -> int:
        """The present place."""
        return self._place

    def write(self, data: "bytes | bytearray | memoryview") -> int:  # type: ignore[override]  # all that HDF5 gives
        """Take all of `data`, on the disk or in memory."""
        view = memoryview(data).cast("B")
        done = 0
        while self._error is None and done < len(view):
            try:
                self._file.seek(self._place + done)
                done += self._file.write(view[done:]) or 0
            except OSError as error:
                self._error = error
        if done < len(view):
            self._kept.append((self._place + done, bytes(view[done:])))
        self._place += len(view)
        self._end = max(self._end, self._place)
        return len(view)

    def readinto(self, buffer: "bytearray | memoryview") -> int:  # type: ignore[override]  # all that HDF5 gives
        """Fill `buffer` from the disk and from what is kept in memory; what was never written is 0."""
        view = memoryview(buffer).cast("B")
        size = max(0, min(len(view), self._end - self._place))
        self._file.seek(self._place)
        content = bytearray(self._file.read(size) or b"").ljust(size, b"\0")
        for place, kept in self._kept:
            first, last = max(place, self._place), min(place + len(kept), self._place + size)
            if first < last:
                content[first - self._place : last - self._place] = kept[first - place : last - place]
        view[:size] = content
        self._place += size
        return size

    def truncate(self, size: int | None = None) -> int:
        """Give the file the length that HDF5 wants."""
        self._end = self._place if size is None else size
        if self._error is None:
            try:
                self._file.truncate(self._end)
            except OSError as error:
                self._error = error
        return self._end

    def flush(self) -> None:
        """Nothing is buffered."""

    def close(self) -> None:
        """Close the file on the disk."""
        self._file.close()
        super().close()
