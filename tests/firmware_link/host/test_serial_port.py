"""Laws of opening a port that this user may not open."""

import errno
import grp
import os
import re
from pathlib import Path
from types import SimpleNamespace

import pytest

from firmware_link.host.serial_port import SerialPort, path_of
from firmware_link.protocol.link_errors import LinkError


def refusal(
    port: Path, patch: pytest.MonkeyPatch, *, group: str | None, mode: int = 0o660, number: int = errno.EACCES
) -> str:
    """What a user is told who opens this port."""
    port.touch()
    port.chmod(mode)

    def refuse(*_: object, **__: object) -> int:  # whoever asks: root may open all
        raise OSError(number, os.strerror(number), str(port))

    names = {} if group is None else {port.stat().st_gid: SimpleNamespace(gr_name=group)}
    with patch.context() as patched, pytest.raises(LinkError) as error:
        patched.setattr(os, "open", refuse)
        patched.setattr(grp, "getgrgid", names.__getitem__)
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
        ("dialout", 0o660, errno.EIO, False),
    ],
)
def test_no_permission_is_told_with_a_udev_rule_and_with_the_group_where_that_helps_and_another_failure_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, group: str | None, mode: int, number: int, helps: bool
) -> None:
    message = refusal(tmp_path / "ttyACM7", monkeypatch, group=group, mode=mode, number=number)
    assert (f"usermod -aG {group} $USER" in message) == ("usermod" in message) == helps
    rule = 'SUBSYSTEM=="tty", KERNEL=="ttyACM7", TAG+="uaccess"'
    assert message.endswith(rule) == ("udev" in message) == (number != errno.EIO)


def test_the_rule_names_the_port_that_a_link_leads_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "ttyUSB3").touch()
    link = tmp_path / "bar"
    link.symlink_to("ttyUSB3")
    assert 'KERNEL=="ttyUSB3"' in refusal(link, monkeypatch, group="dialout")


def test_a_missing_port_is_named() -> None:
    with pytest.raises(LinkError, match="/dev/nowhere"):
        path_of("/dev/nowhere")
