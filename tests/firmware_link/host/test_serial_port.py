"""Laws of opening a port that this user may not open."""

import errno
import grp
import os
import re
from pathlib import Path

import pytest

from firmware_link.host.serial_port import SerialPort, path_of
from firmware_link.protocol.errors import LinkError


class RefusingSystem:
    """Opens no file, whoever asks (root may open all), and calls every group by one name."""

    def __init__(self, group: str | None, number: int) -> None:
        self.group, self.number = group, number

    def open(self, path: str, *_: object, **__: object) -> int:
        raise OSError(self.number, os.strerror(self.number), path)

    def getgrgid(self, number: int) -> grp.struct_group:
        if self.group is None:
            raise KeyError(f"getgrgid(): gid not found: {number}")
        return grp.struct_group((self.group, "x", number, []))


def refusal(
    port: Path, patch: pytest.MonkeyPatch, *, group: str | None, mode: int = 0o660, number: int = errno.EACCES
) -> str:
    """What a user is told who opens this port."""
    port.touch()
    port.chmod(mode)
    system = RefusingSystem(group, number)
    with patch.context() as patched, pytest.raises(LinkError) as error:
        patched.setattr(os, "open", system.open)
        patched.setattr(grp, "getgrgid", system.getgrgid)
        SerialPort(str(port))
    message = str(error.value)
    assert re.match(rf"cannot open {port} .*{os.strerror(number)}", message)
    return message


@pytest.mark.parametrize(
    ("group", "mode", "number", "helps"),
    [
        ("dialout", 0o660, errno.EACCES, True),
        ("uucp", 0o660, errno.EPERM, True),
        ("root", 0o660, errno.EACCES, False),
        (None, 0o660, errno.EACCES, False),
        ("dialout", 0o600, errno.EACCES, False),
        ("dialout", 0o640, errno.EACCES, False),
        ("dialout", 0o620, errno.EACCES, False),
    ],
)
def test_no_permission_is_told_with_a_udev_rule_and_with_the_group_where_that_helps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: str | None, mode: int, number: int, helps: bool
) -> None:
    message = refusal(tmp_path / "ttyACM7", monkeypatch, group=group, mode=mode, number=number)
    assert (f"usermod -aG {group} $USER" in message) == ("usermod" in message) == helps
    assert message.endswith('SUBSYSTEM=="tty", KERNEL=="ttyACM7", TAG+="uaccess"')


def test_the_rule_names_the_port_that_a_link_leads_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ttyUSB3").touch()
    link = tmp_path / "bar"
    link.symlink_to("ttyUSB3")
    assert 'KERNEL=="ttyUSB3"' in refusal(link, monkeypatch, group="dialout")


def test_another_failure_gets_no_remedy_for_rights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    message = refusal(tmp_path / "ttyACM7", monkeypatch, group="dialout", number=errno.EIO)
    assert "usermod" not in message and "udev" not in message


def test_a_missing_port_is_named() -> None:
    with pytest.raises(LinkError, match="/dev/nowhere"):
        path_of("/dev/nowhere")
