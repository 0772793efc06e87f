from __future__ import annotations

import os
import time
from pathlib import Path

import pytest
import serial
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.errors import ImumonError, Reason
from imumon.simulation.virtual_port import Sampler, VirtualPort
from tests.faults.port import FaultyPort
from tests.waiting import LIMIT_S, wait_until

pytestmark = pytest.mark.usefixtures("no_leaks")

MESSAGE = bytes(range(256))


def test_a_host_at_the_rate_of_the_device_reads_what_was_written() -> None:
    with VirtualPort(baudrate=921600) as device, serial.Serial(device.path, 921600, timeout=LIMIT_S) as host:
        device.write(MESSAGE)
        assert host.read(256) == MESSAGE
    assert (device.bytes_sent, device.bytes_lost) == (256, 0)


def test_bytes_leave_no_faster_than_the_line_carries_them() -> None:
    with VirtualPort(baudrate=38400) as device, serial.Serial(device.path, 38400, timeout=LIMIT_S) as host:
        start = time.monotonic()
        device.write(bytes(384))
        assert len(host.read(384)) == 384
        assert time.monotonic() - start >= 0.1


def test_a_host_at_another_rate_reads_garbage_of_the_length_that_fits_its_rate() -> None:
    with VirtualPort(baudrate=115200) as device, serial.Serial(device.path, 57600, timeout=LIMIT_S) as host:
        device.write(MESSAGE * 4)
        garbage = Sampler(2.0).feed(MESSAGE * 4)
        seen = host.read(len(garbage))
    assert seen == garbage
    assert MESSAGE[:8] not in seen
    assert 0.3 < len(seen) / 1024 < 0.7


def test_a_rate_without_a_termios_constant_is_distinguished_as_well() -> None:
    with VirtualPort(baudrate=250000) as device:
        with serial.Serial(device.path, 250000, timeout=LIMIT_S) as host:
            assert device.host_baudrate() == 250000
            device.write(MESSAGE)
            assert host.read(256) == MESSAGE
        with serial.Serial(device.path, 256000, timeout=LIMIT_S) as host:  # within the tolerance of a UART
            device.write(MESSAGE)
            assert host.read(256) == MESSAGE


def test_bytes_that_no_host_listens_to_are_lost_and_counted() -> None:
    with VirtualPort(baudrate=921600) as device:
        device.write(MESSAGE)
        assert wait_until(device.drain)
        assert device.bytes_lost == 256
        with serial.Serial(device.path, 921600, timeout=0.1) as host:
            assert host.read(1) == b""


def test_a_host_that_does_not_read_overruns_instead_of_blocking_the_device() -> None:
    with VirtualPort(baudrate=8000000) as device, serial.Serial(device.path, 8000000, timeout=0) as host:
        device.write(bytes(400_000))
        assert wait_until(device.drain)
        seen = 0
        while chunk := host.read(65536):
            seen += len(chunk)
        assert 0 < seen < device.bytes_sent == 400_000


def test_what_the_host_writes_reaches_the_device() -> None:
    with VirtualPort() as device:
        assert device.read() == b""
        with serial.Serial(device.path, 115200) as host:
            host.write(b"\r\n\x03\x11\x13?")
            assert device.read(LIMIT_S) == b"\r\n\x03\x11\x13?"


def test_a_mute_device_sends_nothing_until_it_resumes() -> None:
    with FaultyPort() as device, serial.Serial(device.path, 115200, timeout=0.1) as host:
        device.silence()
        device.write(b"lost")
        assert host.read(4) == b""
        device.resume()
        host.timeout = LIMIT_S
        device.write(b"back")
        assert host.read(4) == b"back"
        assert device.bytes_lost == 4


def test_what_is_under_way_when_the_cable_is_pulled_is_lost() -> None:
    with VirtualPort(baudrate=9600) as device, serial.Serial(device.path, 9600, timeout=LIMIT_S) as host:
        device.write(bytes(96_000))
        device.unplug()
        assert device.bytes_lost > 80_000
        with pytest.raises(serial.SerialException):
            host.read(96_000)


def test_the_link_names_the_node_while_plugged_in(tmp_path: Path) -> None:
    link = tmp_path / "ttyIMU"
    with VirtualPort(link) as device:
        assert device.path == str(link)
        assert os.path.realpath(link).startswith("/dev/pts/")
        device.unplug()
        assert not link.is_symlink()  # its node may be another process's by now
        with pytest.raises(serial.SerialException):
            serial.Serial(str(link), 115200)
        device.replug()
        with serial.Serial(str(link), 115200, timeout=LIMIT_S) as host:
            device.write(b"again")
            assert host.read(5) == b"again"
    assert not link.is_symlink()


@settings(max_examples=50, deadline=None)
@given(
    st.binary(max_size=60), st.lists(st.integers(0, 60)), st.sampled_from([0.25, 0.5, 0.8, 1.25, 2.0, 12.0])
)
def test_what_a_wrong_rate_shows_does_not_depend_on_how_the_line_is_cut(
    data: bytes, cuts: list[int], ratio: float
) -> None:
    sampler, seen, start = Sampler(ratio), b"", 0
    for cut in [*sorted(cuts), len(data)]:
        seen += sampler.feed(data[start:cut])
        start = max(start, cut)
    assert seen == Sampler(ratio).feed(data)


@settings(max_examples=50, deadline=None)
@given(st.binary(max_size=200))
def test_the_sampler_at_equal_rates_reads_the_bytes(data: bytes) -> None:
    assert Sampler(1.0).feed(data) == data


@pytest.mark.parametrize(("ratio", "first"), [(0.5, 0b01100110), (0.25, 0b01111000)])
def test_a_receiver_that_is_too_fast_sees_each_bit_several_times(ratio: float, first: int) -> None:
    # 0xA5 on the line is start 0, then 1 0 1 0 0 1 0 1, then stop 1.
    assert Sampler(ratio).feed(b"\xa5")[0] == first


def test_a_link_that_a_killed_process_left_is_replaced_and_anything_else_is_not(tmp_path: Path) -> None:
    link = tmp_path / "ttyIMU"
    link.symlink_to("/dev/pts/none")
    with VirtualPort(link) as device:
        assert os.path.realpath(link).startswith("/dev/pts/")
        with pytest.raises(ImumonError, match="exists already") as caught:
            VirtualPort(link)
        assert caught.value.reason is Reason.EXISTS
        assert link.is_symlink()
        link.unlink()
        link.write_text("someone else's")
        device.unplug()
    assert link.read_text() == "someone else's"
    with pytest.raises(ImumonError, match="cannot be made"):
        VirtualPort(tmp_path / "none" / "ttyIMU")
