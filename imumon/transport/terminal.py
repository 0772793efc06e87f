"""What pyserial does not ask of a terminal device: exclusive use, low latency, whether it hung up."""

from __future__ import annotations

import fcntl
import struct
import sys
import termios

from imumon.transport.ports import latency_timer_ms, latency_timer_path

_SERIAL_STRUCT_BYTES = 128  # struct serial_struct of <linux/serial.h>, with room to grow
_FLAGS_OFFSET = 16  # its int flags
_ASYNC_LOW_LATENCY = 1 << 13


def set_exclusive(fd: int, on: bool) -> None:
    """Refuse (or allow) further opening, also by programs that ignore the lock that pyserial takes.

    The flag outlives the descriptor while anyone holds the device, so it is taken back before closing.
    """
    try:
        fcntl.ioctl(fd, termios.TIOCEXCL if on else termios.TIOCNXCL)
    except OSError:  # the device is gone, which the next read tells with its reason
        return


def hung_up(fd: int) -> bool:
    """Return whether the device behind a terminal descriptor is gone."""
    try:
        termios.tcgetattr(fd)
    except termios.error:
        return True
    return False


def set_low_latency(fd: int, device: str) -> str:
    """Ask the driver not to hold bytes back; return what became of it and how to get more."""
    accepted = sys.platform == "linux" and _request_low_latency(fd)
    return latency_text(accepted, latency_timer_ms(device), str(latency_timer_path(device)))


def latency_text(accepted: bool, timer_ms: int | None, timer_path: str) -> str:
    """Describe the low-latency mode from what the driver accepted and its latency timer afterwards."""
    if timer_ms is not None and timer_ms > 1:
        return (
            f"off, the adapter holds bytes back for up to {timer_ms} ms; to change it:"
            f" echo 1 | sudo tee {timer_path}, or for good a udev rule:"
            ' ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
        )
    if timer_ms is not None:
        return f"on, latency timer {timer_ms} ms"
    return "on" if accepted else "not offered by this driver"


def _request_low_latency(fd: int) -> bool:
    """Set the flag and read it back, since some drivers take the call and ignore the flag."""
    buffer = bytearray(_SERIAL_STRUCT_BYTES)
    try:
        fcntl.ioctl(fd, termios.TIOCGSERIAL, buffer)
        (flags,) = struct.unpack_from("i", buffer, _FLAGS_OFFSET)
        struct.pack_into("i", buffer, _FLAGS_OFFSET, flags | _ASYNC_LOW_LATENCY)
        fcntl.ioctl(fd, termios.TIOCSSERIAL, buffer)
        fcntl.ioctl(fd, termios.TIOCGSERIAL, buffer)
    except OSError:  # the driver has no such call, or this user may not make it
        return False
    return bool(struct.unpack_from("i", buffer, _FLAGS_OFFSET)[0] & _ASYNC_LOW_LATENCY)
