"""A firmware image in QEMU: its serial line and its reports on pseudo-terminals, and as a tier of the laws."""

import contextlib
import itertools
import os
import re
import secrets
import select
import socket
import subprocess
import threading
import tty
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from firmware_link.host.serial_port import SerialPort
from firmware_link.protocol.framing import DELIMITER
from firmware_link.protocol.link_errors import LinkError
from firmware_link.protocol.messages import DeviceState

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


FULL_OUTPUT = 32_767
REPORT_PERIOD_US = 1_000
READ_SIZE = 4096
REPORT_WAIT_S = 0.1
LEFT_OVER_US = 10_000
# Only against an endless test: the machine may be slow.
PATIENCE_S = 30.0
# The last word of the RAM of the MPS2, which its boot id is made from.
CHANCE_ADDRESS = 0x203FFFFC
BEFORE_OTHERS = ("nice", "-n", "-10")
"""Begins a command that must keep real time beside others; it only says so where that may not be asked for."""
_TERMINALS = re.compile(r"redirected to (\S+) \(label serial0\)\s+.*redirected to (\S+) \(label serial1\)\n")
_PROMPT = re.compile(r"\(qemu\) $")
# A reset cuts a line short, and the next one follows in it.
_REPORT = re.compile(r"([0-9a-f]{8} ){3}[0-3] [01]( [0-9a-f]{4})+")


@dataclass(frozen=True)
class Report:
    """A line of boards/report.h: peaks are the greatest |output| of each actuator since the last, in fractions."""

    boot_id: int
    device_us: int
    renewed_us: int
    state: DeviceState
    has_high_voltage: bool
    peaks: tuple[float, ...]


class FirmwareImage:
    """A running image: `port` opens like any serial port."""

    def __init__(self, monitor_out: int, monitor_in: int, debugger: Debugger | None) -> None:
        self.debugger = debugger
        self._monitor_out, self._monitor_in = monitor_out, monitor_in
        self.port, report_port = _TERMINALS.findall(self._read_until(_TERMINALS))[0]
        # Held open: QEMU looks only once a second whether somebody has opened a terminal that was closed.
        self._terminals = [os.open(path, os.O_RDWR | os.O_NOCTTY) for path in (self.port, report_port)]
        self._report_line = self._terminals[1]
        tty.setraw(self._report_line)
        os.set_blocking(self._report_line, False)
        self._begun = ""
        self._reports: list[Report] = []
        self._boots = 0
        self._is_open = True
        self._news = threading.Condition()
        self._follower = threading.Thread(target=self._follow)
        self._follower.start()
        if debugger is not None:
            debugger.stop_at("report_done")
            # What is said before QEMU knows of the open terminals is lost.
            while not self.reports():
                debugger.run()

    @property
    def boots(self) -> int:
        return self._boots

    def wait(self, duration_us: int) -> None:
        """Wait until its clock has gone on by so much."""
        with self._news:
            end_us = (self._reports[-1].device_us if self._reports else 0) + duration_us
            assert self._news.wait_for(lambda: self._reports and self._reports[-1].device_us >= end_us, PATIENCE_S)

    def press_reset(self) -> None:
        os.write(self._monitor_in, b"system_reset\n")
        self._read_until(_PROMPT)

    def damage(self, command: bytes) -> None:
        """`w` wedges the main loop, `s` stops the samples."""
        os.write(self._report_line, command)

    def wait_for_boot(self, boots: int) -> None:
        """Wait until it has booted more often than this."""
        with self._news:
            assert self._news.wait_for(lambda: self._boots > boots, PATIENCE_S)

    def wait_for(self, fits: Callable[[Report], bool]) -> Report:
        """The first report of this boot that fits."""
        with self._news:
            assert self._news.wait_for(lambda: any(map(fits, self._reports)), PATIENCE_S)
            return next(filter(fits, self._reports))

    def reports(self) -> list[Report]:
        """All of this boot so far."""
        with self._news:
            return list(self._reports)

    def reports_within(self, start_us: int, stop_us: int) -> list[Report]:
        """Those that tell of nothing but the time between two device times; waits until it has passed."""
        with self._news:
            assert self._news.wait_for(lambda: self._reports and self._reports[-1].device_us >= stop_us, PATIENCE_S)
            pairs = itertools.pairwise(self._reports)
            return [report for before, report in pairs if start_us <= before.device_us and report.device_us <= stop_us]

    def close(self) -> None:
        """Let the terminals go."""
        self._is_open = False
        self._follower.join()
        for terminal in self._terminals:
            os.close(terminal)

    def _read_until(self, pattern: re.Pattern[str]) -> str:
        said = ""
        while not pattern.search(said):
            assert select.select([self._monitor_out], [], [], PATIENCE_S)[0], said
            part = os.read(self._monitor_out, READ_SIZE)
            if not part:
                raise LinkError(f"QEMU has ended, its messages are above; before, it said {said!r}")
            said += part.decode("ascii")
        return said

    def _follow(self) -> None:
        while self._is_open:
            select.select([self._report_line], [], [], REPORT_WAIT_S)
            with self._news:
                self._take_reports()

    def _take_reports(self) -> None:
        text = ""
        with contextlib.suppress(OSError):  # nothing there, or QEMU has ended
            text = os.read(self._report_line, READ_SIZE).decode("ascii")
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            self._take(line)
        self._news.notify_all()

    def _take(self, line: str) -> None:
        if not _REPORT.fullmatch(line):
            return
        boot_id, device_us, renewed_us, state, has_high_voltage, *peaks = (int(word, 16) for word in line.split())
        fractions = tuple(peak / FULL_OUTPUT for peak in peaks)
        report = Report(boot_id, device_us, renewed_us, DeviceState(state), bool(has_high_voltage), fractions)
        if not self._reports or boot_id != self._reports[-1].boot_id:
            self._reports.clear()
            self._boots += 1
        self._reports.append(report)


@contextlib.contextmanager
def run_image(image: Path, machine: str, *, is_stepped: bool = False) -> Iterator[FirmwareImage]:
    """The image for the length of a `with` block; in real time, or from stop to stop of its debugger."""
    command = [
        *("qemu-system-arm", "-M", machine, "-kernel", str(image), "-display", "none", "-monitor", "stdio"),
        # Terminals: a socket holds no more than some hundred bytes that come one by one, or keeps them back.
        *("-serial", "pty", "-serial", "pty"),
        # Time is counted in instructions, 62 million a second: when a busy machine stalls QEMU, the clock of the image
        # stands still too. Left to itself it would lose samples, and be late where a board is not.
        *("-icount", f"shift=4,align={'off' if is_stepped else 'on'},sleep=on"),
        *("-device", f"loader,addr={CHANCE_ADDRESS:#x},data={secrets.randbits(32):#x},data-len=4"),
    ]
    if not is_stepped:
        command = [*BEFORE_OTHERS, *command]
    ours, theirs = socket.socketpair()
    ours.settimeout(PATIENCE_S)
    if is_stepped:
        command += ["-S", "-chardev", f"socket,id=debugger,fd={theirs.fileno()}", "-gdb", "chardev:debugger"]
    pipe = subprocess.PIPE
    with ours, theirs, subprocess.Popen(command, stdin=pipe, stdout=pipe, pass_fds=[theirs.fileno()]) as process:
        assert process.stdin is not None
        assert process.stdout is not None
        try:
            debugger = Debugger(ours, image) if is_stepped else None
            running = FirmwareImage(process.stdout.fileno(), process.stdin.fileno(), debugger)
            try:
                yield running
            finally:
                running.close()
        finally:
            process.kill()


class ImageTier:
    """A freshly reset image and its port.

    The host's clock is the image's own, and goes on in the waits of the law only, from one report to the next: a busy
    machine makes no law slow.
    """

    lease_ms = 100
    slack_us = 2 * REPORT_PERIOD_US

    def __init__(self, image: FirmwareImage, port: SerialPort) -> None:
        assert image.debugger is not None
        self._debugger = image.debugger
        self._image = image
        self._port = port
        self._booted_us = 0
        # What an earlier law left on the line comes to its end first.
        self.write(DELIMITER)
        self.wait(LEFT_OVER_US)
        self.reboot()

    def now_us(self) -> int:
        return self._booted_us + self._debugger.word("report_time_us")

    def write(self, data: bytes) -> None:
        while data:
            written = self._port.write(data)
            data = data[written:]
            if not written:
                self._debugger.run()

    def wait(self, duration_us: int) -> None:
        end_us = self.now_us() + duration_us
        while self.now_us() < end_us:
            self._debugger.run()

    def read(self) -> bytes:
        return self._port.read()

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        # A report is on its way when the image stops, and out when it stops again.
        self.wait(max(0, stop_us - self._debugger.word("report_time_us")) + REPORT_PERIOD_US)
        reports = self._image.reports_within(start_us, stop_us)
        return tuple(max(column) for column in zip(*(report.peaks for report in reports), strict=True)) or (0.0,)

    def reboot(self) -> None:
        boots = self._image.boots
        self._booted_us = self.now_us()
        self._image.press_reset()
        while self._image.boots == boots:
            self._debugger.run()
        self.read()
