from __future__ import annotations

import errno
import grp
import os
import pwd
from pathlib import Path

import pytest
import serial

from imumon.errors import ImumonError, Reason
from imumon.transport.port import latency_text
from imumon.transport.ports import lost_error, open_error, silent_error, wrong_baud_error
from imumon.transport.settings import PortSettings


def denied(device: Path) -> ImumonError:
    cause = serial.SerialException(errno.EACCES, "could not open port")
    return open_error(PortSettings(str(device)), cause)


@pytest.fixture
def node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A node of a group that this user is not in."""
    path = tmp_path / "ttyUSB0"
    path.touch()
    path.chmod(0o660)
    status = os.stat_result((0o020660, 0, 0, 1, 0, 4242, 0, 0, 0, 0))
    real_stat = Path.stat
    monkeypatch.setattr(
        Path, "stat", lambda self, **more: status if self == path else real_stat(self, **more)
    )
    group = grp.struct_group(("dialout", "x", 4242, []))
    monkeypatch.setattr(grp, "getgrgid", lambda _gid: group)
    monkeypatch.setattr(pwd, "getpwuid", lambda _uid: pwd.struct_passwd(("ada", "x", 1000, 1000, "", "", "")))
    monkeypatch.setattr(os, "getgroups", lambda: [1000])
    return path


def test_permission_denied_names_the_group_that_owns_the_node(node: Path) -> None:
    error = denied(node)
    assert error.reason is Reason.PERMISSION
    assert "errno 13, EACCES" in error.seen
    assert "crw-rw---- ada:dialout" in error.seen
    assert error.hint.startswith("sudo usermod -aG dialout ada ")


def test_permission_denied_in_the_group_points_to_a_policy(
    node: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "getgroups", lambda: [1000, 4242])
    assert "container" in denied(node).hint


def test_a_node_without_a_group_is_a_matter_of_udev(tmp_path: Path) -> None:
    device = tmp_path / "ttyACM0"
    device.touch(mode=0o600)
    assert "udev" in denied(device).hint


@pytest.mark.parametrize(
    ("number", "reason"),
    [
        (errno.ENOENT, Reason.NOT_FOUND),
        (errno.ENXIO, Reason.NOT_FOUND),
        (errno.EBUSY, Reason.BUSY),
        (errno.EAGAIN, Reason.BUSY),
        (errno.EIO, Reason.LOST),
        (errno.EPERM, Reason.PERMISSION),
    ],
)
def test_every_error_number_has_its_reason_and_is_named(number: int, reason: Reason) -> None:
    error = open_error(PortSettings("/dev/ttyUSB77"), OSError(number, "x"))
    assert error.reason is reason
    assert f"errno {number}, {errno.errorcode[number]}" in error.seen


def test_the_number_is_found_in_the_error_that_pyserial_caught() -> None:
    def read() -> None:
        try:
            raise ConnectionResetError(errno.ECONNRESET, "x")
        except ConnectionResetError as inner:
            raise serial.SerialException(f"read failed: {inner}")  # noqa: B904  (as pyserial does)

    with pytest.raises(serial.SerialException) as caught:
        read()
    assert "ECONNRESET" in lost_error(PortSettings("socket://host:1"), caught.value).seen


def test_a_server_that_does_not_answer_is_named_a_timeout() -> None:
    error = open_error(PortSettings("socket://host:1"), TimeoutError("timed out"))
    assert error.reason is Reason.NOT_FOUND
    assert "ETIMEDOUT" in error.seen


def test_a_host_name_that_nobody_knows_is_reported_in_the_words_of_the_resolver() -> None:
    error = open_error(PortSettings("socket://nowhere:1"), OSError(-2, "Name or service not known"))
    assert "Name or service not known" in error.seen


def test_lost_silent_and_wrong_baud_say_what_was_detected() -> None:
    settings = PortSettings("/dev/ttyUSB0", 9600)
    assert lost_error(settings, "the device hung up").seen.endswith(
        "at 9600 8N1 was lost: the device hung up"
    )
    silent = silent_error(settings, 3.0)
    assert (silent.reason, "0 bytes in the last 3.0 s" in silent.seen) == (Reason.SILENT, True)
    wrong = wrong_baud_error(settings, 960.0, 0.013, 0.5)
    assert wrong.reason is Reason.WRONG_BAUD
    assert "960 bytes/s arrive, 1.3% of them frame, 50% are 0x00 or 0xFF" in wrong.seen
    assert "imumon detect /dev/ttyUSB0" in wrong.hint


@pytest.mark.parametrize(
    ("accepted", "timer_ms", "expected"),
    [
        (True, None, "on"),
        (False, None, "not offered by this driver"),
        (True, 1, "on, latency timer 1 ms"),
        (False, 16, "off, the adapter holds bytes back for up to 16 ms"),
    ],
)
def test_low_latency_is_recognised_by_what_the_driver_does(
    accepted: bool, timer_ms: int | None, expected: str
) -> None:
    assert latency_text(accepted, "/dev/ttyUSB0", timer_ms).startswith(expected)
