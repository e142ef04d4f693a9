"""Checks serial ports, sound cards, and what the machine allows a real-time loop; writes the udev rules of ports."""

import os
import resource
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from engine.loop.realtime import DMA_LATENCY_PATH, DMA_LATENCY_REMEDY, LIMITS_REMEDY, PRIORITY
from engine.touch.sources.hid_discovery import RULE_FILE
from firmware_link.host.serial_port import PortDescription, permission_remedy
from tactable.audio.interfaces import Interface
from tactable.audio.names import AudioError
from tactable.doctor import Check

_IGNORED = "E:ID_MM_DEVICE_IGNORE=1"


@dataclass(frozen=True)
class SystemFiles:
    """Facts that Linux gives in files below `root`; a missing file means unknown."""

    root: Path = Path("/")

    def runs_modem_manager(self) -> bool:
        """Whether ModemManager runs, which sends AT commands to each new modem-like port."""
        names = (self._read(path) for path in (self.root / "proc").glob("[0-9]*/comm"))
        return "ModemManager" in (name.strip() for name in names)

    def is_left_alone(self, port: PortDescription) -> bool:
        """Whether a udev rule keeps ModemManager from a port."""
        tty = self._tty(port)
        # Our rule marks the port and its USB device; those that come with boards mark either.
        numbers = (self._read(folder / "dev").strip() for folder in (tty, *(tty / "device").resolve().parents))
        records = (self._read(self.root / "run/udev/data" / f"c{number}") for number in numbers if number)
        return any(_IGNORED in record.splitlines() for record in records)

    def latency_timer_ms(self, port: PortDescription) -> int | None:
        """How long the driver collects bytes before it delivers them; None for a driver without such a timer."""
        text = self._read(self._tty(port) / "device" / "latency_timer").strip()
        return int(text) if text.isdecimal() else None

    def governors(self) -> set[str]:
        """The frequency governors of the processors; empty where the kernel has none."""
        paths = (self.root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor")
        return {self._read(path).strip() for path in paths} - {""}

    def _tty(self, port: PortDescription) -> Path:
        return self.root / "sys/class/tty" / Path(port.path).name

    def _read(self, path: Path) -> str:
        try:
            return path.read_text(encoding="utf-8", errors="replace")
        except OSError:
            return ""


def check_ports(ports: Sequence[PortDescription], files: SystemFiles) -> list[Check]:
    """Checks of the permission of every port, and of ModemManager where it runs."""
    if not ports:
        return [Check("serial port", "none found", "plug the firmware's board in")]
    checks = [_check_permission(port, files) for port in ports]
    if files.runs_modem_manager():
        checks += [_check_modem_manager(port, files) for port in ports if port.vendor_id is not None]
    return checks


def check_cards(cards: Callable[[], Sequence[Interface]]) -> list[Check]:
    """A check for each sound card with an output; without one, a check that says why. No command needs a card."""
    try:
        found = [card for card in cards() if card.outputs]
    except AudioError as error:
        finding, _, remedy = str(error).partition(": ")
        return [Check("sound cards", finding, f"{remedy}; only audio:... needs it", needed=False)]
    if not found:
        return [Check("sound cards", "none found; only audio:... needs one")]
    return [
        Check(
            f"sound card {card.name}",
            f"{card.outputs} outputs, {card.inputs} inputs, {1e3 * card.output_latency_s:.1f} ms from program to "
            "output, as its driver says",
        )
        for card in found
    ]


def _check_permission(port: PortDescription, files: SystemFiles) -> Check:
    name, finding = f"serial port {port.path}", port.description
    timer_ms = files.latency_timer_ms(port)
    if timer_ms is not None:
        finding += f", latency timer {timer_ms} ms" + (" (a run sets 1 ms)" if timer_ms > 1 else "")
    if os.access(port.path, os.R_OK | os.W_OK):
        return Check(name, finding)
    return Check(name, "no permission", permission_remedy(port.path))


def _check_modem_manager(port: PortDescription, files: SystemFiles) -> Check:
    name = f"ModemManager and {port.path}"
    if files.is_left_alone(port):
        return Check(name, "leaves it alone")
    return Check(
        name,
        "it may speak AT commands to this port and keep it busy for seconds after it is plugged in",
        rule_remedy(port.stable_id, "board"),
    )


def rule_remedy(name: str, what: str) -> str:
    """How a udev rule for a port or a digitizer of this name is written."""
    return (
        f"run `tactable doctor --emit-udev {name} | sudo tee -a {RULE_FILE}` and `sudo udevadm control --reload`, "
        f"then plug the {what} in again"
    )


def port_rules(port: PortDescription) -> tuple[str, ...]:
    """Rules of udev that give a USB port to the logged-in user and keep ModemManager off; none for other ports."""
    if port.vendor_id is None or port.product_id is None:
        return ()
    numbers = f'ATTRS{{idVendor}}=="{port.vendor_id:04x}", ATTRS{{idProduct}}=="{port.product_id:04x}"'
    return (f'{numbers}, ENV{{ID_MM_DEVICE_IGNORE}}="1"', f'SUBSYSTEM=="tty", {numbers}, TAG+="uaccess"')


_LOCKED_BYTES = 1 << 29  # more memory than a run uses, with numpy and a table of ten zones
_FAST = "performance"


def check_machine(files: SystemFiles) -> list[Check]:
    """Checks of everything that can make a run late; none is needed for it to work."""
    return [
        _check_sleep(files),
        _check_limit("priority", resource.RLIMIT_RTPRIO, PRIORITY, "SCHED_FIFO"),
        _check_limit("locked memory", resource.RLIMIT_MEMLOCK, _LOCKED_BYTES, "mlockall"),
        _check_processors(),
        _check_governor(files),
    ]


def _check_sleep(files: SystemFiles) -> Check:
    path = files.root / DMA_LATENCY_PATH.relative_to("/")
    if not path.exists():
        return Check("processor sleep", "this kernel has no cpu_dma_latency")
    if os.access(path, os.W_OK):
        return Check("processor sleep", "a run may keep processors awake: --realtime dma-latency")
    return Check("processor sleep", "a run may not keep processors awake", DMA_LATENCY_REMEDY, needed=False)


def _check_limit(name: str, limit: int, wanted: int, what: str) -> Check:
    _, most = resource.getrlimit(limit)
    if os.geteuid() == 0 or most == resource.RLIM_INFINITY or most >= wanted:
        return Check(name, f"a run may have {what}")
    return Check(name, f"a run may not have {what}: the limit is {most}, {wanted} wanted", LIMITS_REMEDY, needed=False)


def _check_processors() -> Check:
    count = len(os.sched_getaffinity(0))
    if count > 1:
        return Check("processors", f"{count}")
    return Check("processors", "one: everything else runs where the loop does", "use a machine with two", needed=False)


def _check_governor(files: SystemFiles) -> Check:
    slow = files.governors() - {_FAST}
    if not slow:
        return Check("governor", ", ".join(files.governors()) or "the kernel sets none")
    remedy = "run `sudo cpupower frequency-set -g performance`"
    return Check("governor", f"{', '.join(sorted(slow))}: a processor that rested begins slowly", remedy, needed=False)
