"""One open port: exclusive, low latency, read as soon as bytes are there."""

import fcntl
import os
import select
import socket
import termios
from contextlib import AbstractContextManager, suppress
from dataclasses import replace
from urllib.parse import urlsplit

import serial

from .ports import PORT_ERRORS, holders, latency_timer_ms, latency_timer_path, lost_error, open_error
from .settings import PortSettings

READ_SIZE = 1 << 16
"""Bytes taken at once: as many as a Linux tty can hold back after a stall."""
CONNECT_TIMEOUT_S, WRITE_TIMEOUT_S = 5.0, 1.0


class Port(AbstractContextManager["Port"]):
    """An open port; made by `open_port`.

    `handle` is open, and owned from now on; `settings` are those it was opened with.
    """

    def __init__(self, handle: serial.Serial | socket.socket, settings: PortSettings) -> None:
        self.settings = settings
        self._handle = handle
        self._fd: int = handle.fileno()
        self.vanished_reads = 0
        """How often bytes were announced and then gone, because another program took them."""
        self.low_latency = "no serial adapter here"
        """What became of the low-latency mode, and how to get it."""
        self.shared_with: tuple[str, ...] = ()
        """Other programs that had the port open already; what they read is missing here."""
        if isinstance(handle, serial.Serial):
            _set_exclusive(self._fd, termios.TIOCEXCL)
            self.low_latency = _set_low_latency(handle)
            self.shared_with = tuple(holders(settings.url))

    def read(self, timeout_s: float) -> bytes:
        """Return the bytes that are there, waiting for the first at most `timeout_s`; empty when none came.

        Raises LOST when the port failed, hung up, or the peer closed the connection.
        """
        try:
            ready = select.select([self._fd], [], [], max(timeout_s, 0.0))[0]
            return self._take() if ready else b""
        except PORT_ERRORS as error:
            raise lost_error(self.settings, error) from error

    def write(self, data: bytes) -> None:
        """Send bytes to the device.

        Raises LOST when the port failed or takes no bytes for 1 s.
        """
        try:
            send = self._handle.write if isinstance(self._handle, serial.Serial) else self._handle.sendall
            send(data)
        except PORT_ERRORS as error:
            raise lost_error(self.settings, error) from error

    def set_baudrate(self, baudrate: int) -> None:
        """Let the line run at another rate, without closing the port.

        Raises BAD_CONFIG when the adapter has no such rate; LOST when the port failed.
        """
        settings = replace(self.settings, baudrate=baudrate)
        try:
            if isinstance(self._handle, serial.Serial):
                self._handle.baudrate = baudrate
        except ValueError as error:
            raise open_error(settings, error) from error
        except PORT_ERRORS as error:
            raise lost_error(self.settings, error) from error
        self.settings = settings

    def gone(self) -> str:
        """Return why the opened device is no longer the one under its name; empty when it is.

        An adapter that came back under the same name can leave the old descriptor silent without an error.
        """
        if not isinstance(self._handle, serial.Serial):
            return ""
        try:
            now = os.stat(self.settings.url)  # noqa: PTH116  (the same call as fstat below)
        except OSError:
            return "its device node vanished"
        is_same = os.path.samestat(now, os.fstat(self._fd))
        return "" if is_same else "its device node was replaced by another one"

    def close(self) -> None:
        """Close everything the port holds; closing twice does no harm."""
        if isinstance(self._handle, serial.Serial) and self._handle.is_open:
            _set_exclusive(self._fd, termios.TIOCNXCL)
        self._handle.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _take(self) -> bytes:
        """Read the ready descriptor; nothing there means hang-up, or that another program was faster."""
        try:
            data = os.read(self._fd, READ_SIZE)
        except BlockingIOError:
            data = b""
        else:
            if not data and isinstance(self._handle, socket.socket):
                raise lost_error(self.settings, "the peer closed the connection")
        if not data:
            try:
                termios.tcgetattr(self._fd)
            except termios.error as error:
                hung_up = "the device hung up (unplugged, or its driver let go)"
                raise lost_error(self.settings, hung_up) from error
            self.vanished_reads += 1
        return data


def open_port(settings: PortSettings) -> Port:
    """Open a port exclusively and try to set low-latency mode.

    Raises NOT_FOUND, PERMISSION, BUSY, LOST (the device does not answer its driver) or BAD_CONFIG, each with
    what was found and what to do.
    """
    try:
        if settings.has_line:
            return Port(
                serial.Serial(
                    settings.url,
                    settings.baudrate,
                    settings.bytesize,
                    settings.parity,
                    settings.stopbits,
                    write_timeout=WRITE_TIMEOUT_S,
                    exclusive=True,
                ),
                settings,
            )
        url = urlsplit(settings.url)
        if url.scheme != "socket" or not url.hostname or not url.port:
            raise ValueError("neither a device nor socket://host:port")
        connection = socket.create_connection((url.hostname, url.port), CONNECT_TIMEOUT_S)
        connection.settimeout(WRITE_TIMEOUT_S)
        # The system probes an idle connection, or a server without power would look silent for ever.
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        for option, value in ((socket.TCP_KEEPIDLE, 5), (socket.TCP_KEEPINTVL, 2), (socket.TCP_KEEPCNT, 3)):
            connection.setsockopt(socket.IPPROTO_TCP, option, value)
        return Port(connection, settings)
    except (OSError, termios.error, ValueError) as error:  # pyserial also refuses values
        raise open_error(settings, error) from error


def _set_exclusive(fd: int, request: int) -> None:
    """Refuse (or allow) further opening, also by programs that ignore the lock that pyserial takes.

    The flag outlives the descriptor while anyone holds the device, so it is taken back before closing.
    """
    with suppress(OSError):  # the device is gone, which the next read reports with its reason
        fcntl.ioctl(fd, request)


def _set_low_latency(handle: serial.Serial) -> str:
    """Ask the driver not to hold bytes back; return what became of it and how to get more."""
    accepted, device = True, str(handle.port)
    try:
        handle.set_low_latency_mode(True)
    except (ValueError, NotImplementedError):  # the driver has no such call, or this user may not make it
        accepted = False
    return latency_text(accepted, device, latency_timer_ms(device))


def latency_text(accepted: bool, device: str, timer_ms: int | None) -> str:
    """Describe the low-latency mode from what the driver accepted and its latency timer afterwards."""
    if timer_ms is not None and timer_ms > 1:
        return (
            f"off, the adapter holds bytes back for up to {timer_ms} ms; to change it:"
            f" echo 1 | sudo tee {latency_timer_path(device)}, or for good a udev rule:"
            ' ACTION=="add", SUBSYSTEM=="usb-serial", DRIVER=="ftdi_sio", ATTR{latency_timer}="1"'
        )
    if timer_ms is not None:
        return f"on, latency timer {timer_ms} ms"
    return "on" if accepted else "not offered by this driver"
