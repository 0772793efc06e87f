"""One open port: exclusive, low latency, read as soon as bytes are there."""

import fcntl
import os
import select
import socket
import struct
import sys
import termios
import time
from contextlib import AbstractContextManager
from dataclasses import replace

import serial
from serial.urlhandler import protocol_socket

from imumon.transport.ports import (
    OPEN_ERRORS,
    PORT_ERRORS,
    holders,
    latency_timer_ms,
    latency_timer_path,
    lost_error,
    open_error,
)
from imumon.transport.settings import PortSettings

READ_SIZE = 1 << 16
"""Bytes taken at once: as many as a Linux tty can hold back after a stall."""
SLICE_S = 0.05
"""Longest wait inside a handler whose descriptor is not read directly."""
WRITE_TIMEOUT_S = 1.0
_SERIAL_STRUCT_BYTES = 128  # struct serial_struct of <linux/serial.h>, with room to grow
_FLAGS_OFFSET = 16  # its int flags
_ASYNC_LOW_LATENCY = 1 << 13


class _SocketHandler(protocol_socket.Serial):
    """pyserial's ``socket://``, which discards what the server sends at once and may leave it open."""

    _socket: socket.socket | None = None

    def reset_input_buffer(self) -> None:
        """Keep everything: on a new connection nothing is stale."""

    def close(self) -> None:
        """Close the connection, also when the peer has closed it first."""
        self.is_open = False
        if self._socket is not None:
            self._socket.close()


Handle = serial.Serial | _SocketHandler


class Port(AbstractContextManager["Port"]):
    """An open port; made by `open_port`.

    `handle` is an open pyserial port, owned from now on; `settings` are those it was opened with.
    """

    def __init__(self, handle: Handle, settings: PortSettings) -> None:
        self.settings = settings
        self._handle = handle
        self._socket: socket.socket | None = getattr(handle, "_socket", None)
        self._native = isinstance(handle, serial.Serial)
        # A subclass (spy://, alt://) wants to see what is read, so only the plain handlers are passed by.
        self._direct = type(handle) in (serial.Serial, _SocketHandler)
        self._fd: int | None = handle.fileno() if self._direct or self._native else None
        self.vanished_reads = 0
        """How often bytes were announced and then gone, because another program took them."""
        self.low_latency = "no serial adapter here"
        """What became of the low-latency mode, and how to get it."""
        self.shared_with: tuple[str, ...] = ()
        """Other programs that had the port open already; what they read is missing here."""
        if self._native and self._fd is not None:
            _set_exclusive(self._fd, True)
            self.low_latency = _set_low_latency(self._fd, str(handle.port))
            self.shared_with = tuple(holders(str(handle.port)))
        if self._socket is not None:
            _keep_alive(self._socket)

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that are there, waiting for the first at most `timeout_s`; empty when none came.

        Raises LOST when the port failed, hung up, or the peer closed the connection.
        """
        try:
            if self._fd is None or not self._direct:
                return self._wait_in_handler(timeout_s)
            ready = select.select([self._fd], [], [], max(timeout_s, 0.0))[0]
            return self._take(self._fd) if ready else b""
        except PORT_ERRORS as error:
            raise lost_error(self.settings, error) from error

    def write(self, data: bytes) -> None:
        """Send bytes to the device.

        Raises LOST when the port failed or takes no bytes for 1 s.
        """
        try:
            self._handle.write(data)
        except PORT_ERRORS as error:
            raise lost_error(self.settings, error) from error

    def set_baudrate(self, baudrate: int) -> None:
        """Let the line run at another rate, without closing the port.

        Raises BAD_CONFIG when the adapter has no such rate; LOST when the port failed.
        """
        try:
            self._handle.baudrate = baudrate
        except ValueError as error:
            raise open_error(replace(self.settings, baudrate=baudrate), error) from error
        except PORT_ERRORS as error:
            raise lost_error(self.settings, error) from error
        self.settings = replace(self.settings, baudrate=baudrate)

    def gone(self) -> str:
        """Return why the opened device is no longer the one under its name; empty when it is.

        An adapter that came back under the same name can leave the old descriptor silent without an error.
        """
        if not self._native or self._fd is None:
            return ""
        try:
            now = os.stat(str(self._handle.port))  # noqa: PTH116  (the same call as fstat below)
        except OSError:
            return "its device node vanished"
        then = os.fstat(self._fd)
        same = (now.st_dev, now.st_ino, now.st_rdev) == (then.st_dev, then.st_ino, then.st_rdev)
        return "" if same else "its device node was replaced by another one"

    def close(self) -> None:
        """Close everything the port holds; closing twice does no harm."""
        if self._native and self._fd is not None:
            _set_exclusive(self._fd, False)
        self._fd = None
        _close(self._handle)
        if self._socket is not None:
            self._socket.close()  # the rfc2217 handler forgets it when the peer has closed first

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self, fd: int) -> bytes:
        """Read the ready descriptor; nothing there means hang-up, or that another program was faster."""
        try:
            data = os.read(fd, READ_SIZE)
        except BlockingIOError:
            data = b""
        else:
            if not data and self._socket is not None:
                raise lost_error(self.settings, "the peer closed the connection")
        if not data:
            if _hung_up(fd):
                raise lost_error(self.settings, "the device hung up (unplugged, or its driver let go)")
            self.vanished_reads += 1
        return data

    def _wait_in_handler(self, timeout_s: float) -> bytes:
        """Wait in slices of the handler's own timeout, `SLICE_S`."""
        end = time.monotonic() + timeout_s
        while True:
            data = bytes(self._handle.read(1))
            if data:
                waiting = self._handle.in_waiting
                return data + bytes(self._handle.read(waiting)) if waiting else data
            if time.monotonic() >= end:
                return b""


def open_port(settings: PortSettings) -> Port:
    """Open a port exclusively and try to set low-latency mode.

    Raises NOT_FOUND, PERMISSION, BUSY, LOST (the device does not answer its driver) or BAD_CONFIG, each with
    what was found and what to do.
    """
    try:
        handle = _make_handle(settings)
    except OPEN_ERRORS as error:
        raise open_error(settings, error) from error
    try:
        handle.open()
        return Port(handle, settings)
    except OPEN_ERRORS as error:
        _close(handle)
        raise open_error(settings, error) from error


def _make_handle(settings: PortSettings) -> Handle:
    """Return a handler of pyserial that is set up and not open yet."""
    handle: Handle
    if settings.scheme == "socket":
        handle = _SocketHandler()
        handle.port = settings.url
    else:
        handle = serial.serial_for_url(settings.url, do_not_open=True)
    handle.baudrate = settings.baudrate
    handle.bytesize = settings.bytesize
    handle.parity = settings.parity
    handle.stopbits = settings.stopbits
    handle.timeout = SLICE_S
    handle.exclusive = True
    if settings.scheme != "rfc2217":  # which refuses to have one
        handle.write_timeout = WRITE_TIMEOUT_S
    return handle


def _close(handle: Handle) -> None:
    """Close a handler, and the file of ``spy://...?file=``, which pyserial leaves open."""
    handle.close()
    output = getattr(getattr(handle, "formatter", None), "output", None)
    if output not in (None, sys.stderr):
        output.close()


def _keep_alive(connection: socket.socket) -> None:
    """Have the system probe an idle connection, or a server without power would look silent for ever."""
    connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 5), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, name):
            connection.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def _set_exclusive(fd: int, on: bool) -> None:
    """Refuse (or allow) further opening, also by programs that ignore the lock that pyserial takes.

    The flag outlives the descriptor while anyone holds the device, so it is taken back before closing.
    """
    try:
        fcntl.ioctl(fd, termios.TIOCEXCL if on else termios.TIOCNXCL)
    except OSError:  # the device is gone, which the next read reports with its reason
        return


def _hung_up(fd: int) -> bool:
    try:
        termios.tcgetattr(fd)
    except termios.error:
        return True
    return False


def _set_low_latency(fd: int, device: str) -> str:
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
