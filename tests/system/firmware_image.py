"""A firmware image in QEMU: its serial line on a pseudo-terminal, its reports on a socket, and as a tier of the laws."""

import contextlib
import os
import re
import secrets
import select
import socket
import subprocess
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from firmware_link.errors import LinkError
from firmware_link.framing import DELIMITER
from firmware_link.messages import DeviceState
from firmware_link.serial_port import SerialPort

FULL_OUTPUT = 32_767
REPORT_PERIOD_US = 1_000
READ_SIZE = 4096
# Only against an endless test: the machine may be slow.
PATIENCE_S = 30.0
# The last word of the RAM of the MPS2, which its boot id is made from.
CHANCE_ADDRESS = 0x203FFFFC
_TERMINAL = re.compile(r"redirected to (\S+)")
# A reset cuts a line short, and the next one follows in it.
_REPORT = re.compile(r"[0-9a-f]{8} [0-3] [01]( [0-9a-f]{4})+")


@dataclass(frozen=True)
class Report:
    """A line of boards/report.h: greatest |output| of each actuator since the line before, in fractions."""

    device_us: int
    state: DeviceState
    has_high_voltage: bool
    peaks: tuple[float, ...]


class FirmwareImage:
    """A running image: `port` opens like any serial port."""

    def __init__(self, process: "subprocess.Popen[str]", monitor: socket.socket, report_line: socket.socket) -> None:
        assert process.stdout is not None
        found = _TERMINAL.search(process.stdout.readline())
        if found is None:
            raise LinkError(f"QEMU did not start: exit status {process.poll()}, its messages are above")
        self.port = found[1]
        # Held open: QEMU looks only once a second whether somebody has opened a terminal that was closed.
        self._terminal = os.open(self.port, os.O_RDWR | os.O_NOCTTY)
        self._monitor = monitor
        self._read_prompt()
        self._report_line = report_line
        self._report_line.setblocking(False)
        self._begun = ""
        self._reports: list[Report] = []
        self._boots = 0
        self._booted_us = 0
        self._news = threading.Condition()
        threading.Thread(target=self._follow, daemon=True).start()
        self.wait_for_boot(0)

    @property
    def boots(self) -> int:
        """How often the image has started."""
        return self._boots

    def now_us(self) -> int:
        """The image's own clock as of its last report, counted on through its resets."""
        with self._news:
            return self._clock_us()

    def wait(self, duration_us: int) -> None:
        """Wait until its clock has gone on by so much."""
        with self._news:
            end_us = self._clock_us() + duration_us
            assert self._news.wait_for(lambda: self._clock_us() >= end_us, PATIENCE_S)

    def halt(self) -> None:
        """Let its time stand still, all reports until then taken."""
        self._command("stop")
        with self._news:
            while self._take_reports():
                pass

    def go(self) -> None:
        """Let its time go on."""
        self._command("cont")

    def reset(self) -> None:
        """Push the reset button, and wait until the image runs again."""
        boots = self._boots
        self._command("system_reset")
        self.wait_for_boot(boots)

    def damage(self, command: bytes) -> None:
        """`w` wedges the main loop, `s` stops the samples."""
        self._report_line.sendall(command)

    def wait_for_boot(self, boots: int) -> None:
        """Wait until it has booted more often than this."""
        with self._news:
            assert self._news.wait_for(lambda: self._boots > boots, PATIENCE_S)

    def reports(self) -> list[Report]:
        """All of this boot so far."""
        with self._news:
            return list(self._reports)

    def reports_within(self, start_us: int, stop_us: int) -> list[Report]:
        """Those that tell of nothing but the time between two device times; waits until it has passed."""
        with self._news:
            assert self._news.wait_for(lambda: self._reports and self._reports[-1].device_us >= stop_us, PATIENCE_S)
            pairs = zip(self._reports, self._reports[1:], strict=False)
            return [report for before, report in pairs if start_us <= before.device_us and report.device_us <= stop_us]

    def close(self) -> None:
        """Let the terminal go."""
        os.close(self._terminal)

    def _command(self, text: str) -> None:
        self._monitor.sendall(f"{text}\n".encode("ascii"))
        self._read_prompt()

    def _read_prompt(self) -> None:
        said = b""
        while not said.endswith(b"(qemu) "):
            part = self._monitor.recv(READ_SIZE)
            assert part, said
            said += part

    def _clock_us(self) -> int:
        return self._booted_us + (self._reports[-1].device_us if self._reports else 0)

    def _follow(self) -> None:
        # Ends with the line: closed on this side (ValueError) or on the other.
        with contextlib.suppress(ConnectionError, ValueError):
            while True:
                select.select([self._report_line], [], [])
                with self._news:
                    self._take_reports()

    def _take_reports(self) -> bool:
        """Whether any had come."""
        try:
            text = self._report_line.recv(READ_SIZE).decode("ascii")
        except BlockingIOError:
            return False
        if not text:
            raise ConnectionError("QEMU has ended")
        *lines, self._begun = (self._begun + text).split("\n")
        for line in lines:
            self._take(line)
        self._news.notify_all()
        return True

    def _take(self, line: str) -> None:
        if not _REPORT.fullmatch(line):
            return
        device_us, state, has_high_voltage, *peaks = (int(word, 16) for word in line.split())
        fractions = tuple(peak / FULL_OUTPUT for peak in peaks)
        report = Report(device_us, DeviceState(state), bool(has_high_voltage), fractions)
        if not self._reports or report.device_us < self._reports[-1].device_us:
            self._booted_us = self._clock_us()
            self._reports.clear()
            self._boots += 1
        self._reports.append(report)


@contextlib.contextmanager
def run_image(image: Path, machine: str) -> Iterator[FirmwareImage]:
    """The image for the length of a `with` block."""
    with contextlib.ExitStack() as stack:
        # Not Unix sockets: those hold 278 bytes that come one by one, and then the reports stall.
        monitor, reports = (stack.enter_context(socket.create_server(("127.0.0.1", 0))) for _ in range(2))
        command = [
            *("qemu-system-arm", "-M", machine, "-kernel", str(image), "-display", "none"),
            # Time is counted in instructions, 62 million a second: when a busy machine stalls QEMU, the clock of the
            # image stands still too. Left to itself it would lose samples, and be late where a board is not.
            *("-icount", "shift=4,align=off,sleep=on"),
            *("-monitor", f"tcp:127.0.0.1:{monitor.getsockname()[1]}"),
            *("-serial", "pty", "-serial", f"tcp:127.0.0.1:{reports.getsockname()[1]},nodelay=on"),
            *("-device", f"loader,addr={CHANCE_ADDRESS:#x},data={secrets.randbits(32):#x},data-len=4"),
        ]
        process = stack.enter_context(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        stack.callback(process.kill)
        running = FirmwareImage(process, stack.enter_context(_accept(monitor)), stack.enter_context(_accept(reports)))
        stack.callback(running.close)
        yield running


def _accept(server: socket.socket) -> socket.socket:
    server.settimeout(PATIENCE_S)
    connection, _ = server.accept()
    connection.settimeout(PATIENCE_S)
    return connection


class ImageTier:
    """A freshly reset image and its port.

    The host's clock is the image's own, and stands still but for the waits of the law: a busy machine makes no law slow.
    """

    lease_ms = 100
    slack_us = 2 * REPORT_PERIOD_US

    def __init__(self, image: FirmwareImage, port: SerialPort) -> None:
        self._image = image
        self._port = port
        # What an earlier law left on the line comes to its end first.
        image.go()
        self.write(DELIMITER)
        image.wait(20 * REPORT_PERIOD_US)
        self.reboot()

    def now_us(self) -> int:
        return self._image.now_us()

    def write(self, data: bytes) -> None:
        while data:
            written = self._port.write(data)
            data = data[written:]
            if not written:
                self.wait(REPORT_PERIOD_US)

    def wait(self, duration_us: int) -> None:
        self._image.go()
        self._image.wait(duration_us)
        self._image.halt()

    def read(self) -> bytes:
        return self._port.read()

    def peaks(self, start_us: int, stop_us: int) -> tuple[float, ...]:
        self.wait(max(0, stop_us - self._image.reports()[-1].device_us))
        reports = self._image.reports_within(start_us, stop_us)
        return tuple(max(column) for column in zip(*(report.peaks for report in reports), strict=True)) or (0.0,)

    def reboot(self) -> None:
        self._image.go()
        self._image.reset()
        self._image.halt()
        self.read()
