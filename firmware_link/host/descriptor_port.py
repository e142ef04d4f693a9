"""Bytes of a board over a descriptor that never blocks: what a serial port and the socket to a sound card share."""

import os
from typing import Self

from firmware_link.protocol.link_errors import LinkLostError

READ_SIZE = 4096  # bytes read at once


class DescriptorPort:
    """An open descriptor to a board. Whatever fails later is a LinkLostError, as after an unplug."""

    def __init__(self, path: str, descriptor: int) -> None:
        self.path, self._descriptor = path, descriptor
        os.set_blocking(descriptor, False)

    def fileno(self) -> int:
        """The descriptor, to poll."""
        return self._descriptor

    def read(self) -> bytes:
        """Read what has come, perhaps nothing. Raises LinkLostError when the board is gone."""
        try:
            data = os.read(self._descriptor, READ_SIZE)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise self._gone(error) from error
        if not data:
            raise self._gone("hung up")
        return data

    def write(self, data: bytes) -> int:
        """Write what is taken; returns the number of bytes, perhaps 0. Raises LinkLostError when the board is gone."""
        try:
            return os.write(self._descriptor, data)
        except BlockingIOError:
            return 0
        except OSError as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Close the port; a second close does nothing."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
        self._descriptor = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *unused: object) -> None:
        self.close()

    def _gone(self, reason: object) -> LinkLostError:
        return LinkLostError(f"{self.path} is gone ({reason}): plug the device in and connect again")
