from __future__ import annotations

import array
import fcntl
import os
import select
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

from imumon.errors import ImumonError, Reason
from imumon.simulation.virtual_port import VirtualPort
from imumon.transport import port as port_module
from imumon.transport.port import open_port
from imumon.transport.settings import PortSettings
from tests.transport.helpers import read_exactly, tcp_server
from tests.waiting import LIMIT_S, wait_until

pytestmark = pytest.mark.usefixtures("no_leaks")

MESSAGE = bytes(range(256))
TIOCGEXCL = 0x80045440
NOBODY = 65534


@contextmanager
def other_program(device: str, how: str) -> Iterator[int]:
    """Hold the device open in another process; `how` is the expression that opens it."""
    code = f"import os, serial, sys\nheld = {how}\nprint('open', flush=True)\nsys.stdin.read()"
    command = [sys.executable, "-c", code, device]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"open\n"
        try:
            yield process.pid
        finally:
            process.communicate()


@contextmanager
def unprivileged() -> Iterator[None]:
    """Give up the rights of root for a while."""
    before = os.geteuid()
    if before == 0:
        with suppress(PermissionError):  # a root that may not even do this has no other rights either
            os.seteuid(NOBODY)
    try:
        yield
    finally:
        os.seteuid(before)


def test_bytes_arrive_unchanged_and_writes_reach_the_device() -> None:
    with VirtualPort() as device, open_port(PortSettings(device.path)) as port:
        device.write(MESSAGE * 4)
        assert read_exactly(port, 1024) == MESSAGE * 4
        port.write(b"?\r\n\x00\xff")
        assert device.read(LIMIT_S) == b"?\r\n\x00\xff"


def test_reading_an_idle_port_ends_at_the_timeout() -> None:
    with VirtualPort() as device, open_port(PortSettings(device.path)) as port:
        assert port.read(0.0) == b""
        assert port.read(0.02) == b""


def test_an_unplugged_device_is_lost() -> None:
    with VirtualPort() as device, open_port(PortSettings(device.path)) as port:
        device.unplug()
        with pytest.raises(ImumonError) as caught:
            read_exactly(port, 1)
    assert caught.value.reason is Reason.LOST
    assert device.path in caught.value.seen


def test_bytes_stolen_by_another_program_are_not_taken_for_a_hang_up(monkeypatch: pytest.MonkeyPatch) -> None:
    with VirtualPort() as device:
        thief = os.open(device.path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)

        class SelectThenSteal:
            @staticmethod
            def select(*args: Any) -> Any:
                ready = select.select(*args)
                os.read(thief, 4096)
                return ready

        with open_port(PortSettings(device.path)) as port:
            with monkeypatch.context() as patch:
                patch.setattr(port_module, "select", SelectThenSteal)
                device.write(b"?")
                assert port.read(LIMIT_S) == b""
            assert port.vanished_reads == 1
            device.write(b"mine")
            assert read_exactly(port, 4) == b"mine"
        os.close(thief)


def test_a_port_that_this_program_holds_is_busy() -> None:
    with VirtualPort() as device, open_port(PortSettings(device.path)):
        with pytest.raises(ImumonError) as caught:
            open_port(PortSettings(device.path))
        assert caught.value.reason is Reason.BUSY
        assert "EAGAIN" in caught.value.seen or "EBUSY" in caught.value.seen


def test_a_port_that_another_program_holds_is_busy_and_the_program_is_named() -> None:
    opened = "serial.Serial(sys.argv[1], exclusive=True)"
    with VirtualPort() as device, other_program(device.path, opened) as pid:
        with pytest.raises(ImumonError) as caught:
            open_port(PortSettings(device.path))
        assert caught.value.reason is Reason.BUSY
        assert f"(pid {pid})" in caught.value.seen
        assert "Close that program" in caught.value.hint


def test_a_program_that_had_the_port_open_without_a_lock_is_named() -> None:
    opened = "os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)"
    with VirtualPort() as device, other_program(device.path, opened) as pid:
        with open_port(PortSettings(device.path)) as port:
            assert [f"(pid {pid})" in holder for holder in port.shared_with] == [True]
        assert not _is_exclusive(device.path)


def test_programs_that_ignore_locks_are_kept_out_until_the_port_is_closed() -> None:
    with VirtualPort() as device:
        Path(device.path).chmod(0o666)
        with open_port(PortSettings(device.path)), unprivileged(), pytest.raises(OSError, match="busy"):
            os.open(device.path, os.O_RDWR | os.O_NOCTTY)
        assert not _is_exclusive(device.path)


def _is_exclusive(path: str) -> bool:
    fd = os.open(path, os.O_RDWR | os.O_NOCTTY)
    state = array.array("i", [0])
    fcntl.ioctl(fd, TIOCGEXCL, state)
    os.close(fd)
    return bool(state[0])


def test_permission_denied_names_errno_owner_and_mode() -> None:
    with VirtualPort() as device:
        Path(device.path).chmod(0o000)
        with unprivileged(), pytest.raises(ImumonError) as caught:
            open_port(PortSettings(device.path))
    assert caught.value.reason is Reason.PERMISSION
    assert "errno 13, EACCES" in caught.value.seen
    assert "c---------" in caught.value.seen
    assert "udev" in caught.value.hint


def test_a_missing_device_names_errno_and_the_ports_that_exist() -> None:
    with pytest.raises(ImumonError) as caught:
        open_port(PortSettings("/dev/ttyUSB77"))
    assert caught.value.reason is Reason.NOT_FOUND
    assert "errno 2, ENOENT" in caught.value.seen
    assert "ports that exist" in caught.value.seen or "no serial ports exist" in caught.value.seen


def test_a_file_that_is_no_serial_port_is_refused(tmp_path: Path) -> None:
    (tmp_path / "capture.bin").write_bytes(b"x")
    with pytest.raises(ImumonError, match="is not a serial port") as caught:
        open_port(PortSettings(str(tmp_path / "capture.bin")))
    assert caught.value.reason is Reason.NOT_FOUND


@pytest.mark.parametrize(
    "url", ["nonsense://x", "rfc2217://x:1", "socket://localhost:99999", "socket://localhost"]
)
def test_a_url_that_makes_no_sense_is_refused(url: str) -> None:
    with pytest.raises(ImumonError) as caught:
        open_port(PortSettings(url))
    assert caught.value.reason in (Reason.BAD_CONFIG, Reason.NOT_FOUND)
    assert url in caught.value.seen


def test_a_host_that_refuses_is_not_found() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        number = server.getsockname()[1]
    with pytest.raises(ImumonError, match=r"errno 111, ECONNREFUSED") as caught:
        open_port(PortSettings(f"socket://127.0.0.1:{number}"))
    assert caught.value.reason is Reason.NOT_FOUND


def test_a_socket_carries_bytes_both_ways_and_is_lost_when_the_peer_closes() -> None:
    received: list[bytes] = []

    def serve(client: socket.socket) -> None:
        client.sendall(MESSAGE)
        received.append(client.recv(16))

    with tcp_server(serve) as number, open_port(PortSettings(f"socket://127.0.0.1:{number}")) as port:
        assert read_exactly(port, 256) == MESSAGE
        port.write(b"hello")
        with pytest.raises(ImumonError, match="peer closed") as caught:
            read_exactly(port, 1)
    assert caught.value.reason is Reason.LOST
    assert received == [b"hello"]


def test_a_replaced_or_vanished_node_is_noticed(tmp_path: Path) -> None:
    link = tmp_path / "ttyIMU"
    with VirtualPort() as one, VirtualPort() as other:
        link.symlink_to(one.path)
        with open_port(PortSettings(str(link))) as port:
            assert port.gone() == ""
            link.unlink()
            assert "vanished" in port.gone()
            link.symlink_to(other.path)
            assert "replaced" in port.gone()


def test_closing_twice_does_no_harm() -> None:
    with VirtualPort() as device, open_port(PortSettings(device.path)) as port:
        port.close()
        assert wait_until(lambda: not device.host_listens())


@pytest.mark.parametrize(
    ("bytesize", "parity", "stopbits", "bits"), [(8, "N", 1, 10), (8, "E", 1, 11), (7, "O", 2, 11)]
)
def test_what_a_line_carries_counts_start_parity_and_stop(
    bytesize: int, parity: str, stopbits: int, bits: int
) -> None:
    settings = PortSettings("/dev/ttyUSB0", 110_000, bytesize, parity, stopbits)
    assert settings.capacity_bytes_per_s == 110_000 / bits


def test_an_impossible_baud_rate_is_refused() -> None:
    with pytest.raises(ImumonError) as caught:
        PortSettings("/dev/ttyUSB0", 0)
    assert caught.value.reason is Reason.BAD_CONFIG
