"""GDB's remote protocol to QEMU: as much of it as it takes to run from breakpoint to breakpoint."""

import socket
import subprocess
from pathlib import Path

READ_SIZE = 4096
STOPPED = "T05"


class Debugger:
    """The debugger of an image that was started stopped; `connection` is QEMU's, `image` has the symbols."""

    def __init__(self, connection: socket.socket, image: Path) -> None:
        self._connection = connection
        self._received = b""
        self._addresses = _addresses_of(image)

    def stop_at(self, function: str) -> None:
        # The lowest bit of an address tells Thumb code, and is no part of it.
        assert self._ask(f"Z0,{self._addresses[function] & ~1:x},2") == "OK"

    def run(self) -> None:
        """Go on until the next stop; from a breakpoint by one step over it."""
        for command in ("s", "c"):
            assert self._ask(command).startswith(STOPPED)

    def word(self, variable: str) -> int:
        """A little-endian 32-bit variable."""
        return int.from_bytes(bytes.fromhex(self._ask(f"m{self._addresses[variable]:x},4")), "little")

    def detach(self) -> None:
        """Let the image run on by itself."""
        self._ask("D")

    def _ask(self, command: str) -> str:
        checksum = sum(command.encode("ascii")) % 256
        self._connection.sendall(f"${command}#{checksum:02x}".encode("ascii"))
        while b"#" not in self._received[:-2]:
            part = self._connection.recv(READ_SIZE)
            assert part, f"QEMU ended at {command}"
            self._received += part
        answer, _, rest = self._received.partition(b"#")
        self._received = rest[2:]
        self._connection.sendall(b"+")
        return answer.lstrip(b"+").removeprefix(b"$").decode("ascii")


def _addresses_of(image: Path) -> dict[str, int]:
    listing = subprocess.run(["arm-none-eabi-nm", str(image)], capture_output=True, text=True, check=True).stdout
    return {name: int(address, 16) for address, _, name in (line.split() for line in listing.splitlines())}
