"""A serial device without hardware: a pseudo-terminal that behaves like a UART with a cable.

A pseudo-terminal has no speed and no plug.  Here it has: bytes leave at the baud rate of the device, a host
that opened it at another rate samples garbage, bytes that are not read are lost and counted, and the cable
can be pulled.  Needs Linux.
"""

import array
import fcntl
import math
import os
import select
import termios
import threading
import time
import tty
from contextlib import AbstractContextManager, suppress
from pathlib import Path

from imumon.errors import ImumonError, Reason, bad_config

DRAIN_S = 10.0
"""How long the last bytes are waited for at the most."""
BITS_PER_BYTE = 10
"""8N1: start bit, eight data bits, stop bit."""
BACKLOG = 1 << 20
"""Bytes that wait to be sent; what a device writes beyond that is lost, as in a UART that overruns."""
CHUNK_S = 0.001
"""Line time of what is handed over at once, as by an adapter in low-latency mode."""
SAMPLING_TOLERANCE = 0.03
"""Rates closer than this are sampled correctly: at the ninth bit the error is a third of a bit."""

_TCGETS2 = 0x802C542A  # termios2 holds the rate as a number, termios only a code
_TCSETS2 = 0x402C542B
_BOTHER = 0o010000
_TERMIOS2_INTS = 64  # 11 are used
_CFLAG, _ISPEED, _OSPEED = 2, 9, 10  # position of these ints


class VirtualPort(AbstractContextManager["VirtualPort"]):
    """A device on a cable, 8N1; the host opens `path` as it would open ``/dev/ttyUSB0``.

    Raises EXISTS when there is something under the name of the link, unless it is a link that leads nowhere,
    as a killed process leaves it; BAD_CONFIG when the link cannot be made.

    `link`: name of a symlink to the device node, made here and removed by `unplug` and `close`; it stays the
        same when the device is plugged in again, as under ``/dev/serial/by-id``.
    """

    def __init__(self, link: Path | None = None, baudrate: int = 115200) -> None:
        self.baudrate = baudrate
        self.bytes_sent = 0
        """Bytes that went over the line while a host had the port open."""
        self.bytes_lost = 0
        """Bytes written that did not: no host, unplugged, or written faster than the line carries."""
        self._link = link
        self._master: int | None = None
        self._node = ""
        self._backlog = bytearray()
        self._closing = False
        self._changed = threading.Condition()
        self.replug()
        self._thread = threading.Thread(target=self._send, name="virtual port", daemon=True)
        self._thread.start()

    @property
    def path(self) -> str:
        """Name by which the host opens the port; it does not exist while unplugged."""
        return str(self._link) if self._link is not None else self._node

    def write(self, data: bytes) -> None:
        """Send bytes to the host; returns at once, whether or not anyone reads."""
        with self._changed:
            if self._master is None:
                self.bytes_lost += len(data)
                return
            room = max(BACKLOG - len(self._backlog), 0)
            self._backlog += data[:room]
            self.bytes_lost += len(data[room:])
            self._changed.notify_all()

    def drain(self) -> bool:
        """Wait until all that was written has left; return whether it has."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._backlog, DRAIN_S)

    def read(self, timeout_s: float = 0.0) -> bytes:
        """Return what the host has sent, as the device samples it, waiting at most `timeout_s`."""
        master = self._master
        if master is None or not self.host_listens() or not select.select([master], [], [], timeout_s)[0]:
            return b""
        try:
            data = os.read(master, 4096)
        except OSError:  # the host has just closed its end
            return b""
        return Sampler(self.host_baudrate() / self.baudrate).feed(data)

    def host_listens(self) -> bool:
        """Return whether a host has the port open."""
        if (master := self._master) is None:
            return False
        poll = select.poll()
        poll.register(master, 0)
        return not any(events & select.POLLHUP for _, events in poll.poll(0))

    def host_baudrate(self) -> int:
        """Return the rate that the host has set."""
        assert self._master is not None
        return _termios2(self._master)[_OSPEED]

    def unplug(self) -> None:
        """Pull the cable: the node disappears and the host's descriptor fails.

        All that is under way is lost, in the middle of a packet.
        """
        with self._changed:
            self._lose_backlog()
            self._close_master()
            if self._link is not None and _leads_to(self._link, self._node):
                self._link.unlink()

    def replug(self) -> None:
        """Plug the device in again: a new node, under the same link when there is one."""
        with self._changed:
            if self._master is not None:
                return
            self._master, slave = os.openpty()
            self._node = os.ttyname(slave)
            tty.setraw(slave)
            _set_rate(slave, self.baudrate)  # a host that sets no rate is right by chance, as at a bench
            os.close(slave)  # from here on the master hangs up while no host has the port open
            os.set_blocking(self._master, False)
            self._sampler = Sampler(1.0)
            if self._link is not None:
                self._make_link(self._link)

    def close(self) -> None:
        """Unplug for good and end the thread."""
        with self._changed:
            self._closing = True
            self._changed.notify_all()
        self._thread.join()
        self.unplug()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _close_master(self) -> None:
        if self._master is not None:
            os.close(self._master)
            self._master = None

    def _make_link(self, link: Path) -> None:
        try:
            if _leads_to(link, self._node) or (link.is_symlink() and not link.exists()):
                link.unlink()  # left behind by a process that was killed
            link.symlink_to(self._node)
        except OSError as error:
            self._close_master()
            if isinstance(error, FileExistsError):
                raise ImumonError(
                    Reason.EXISTS, f"{link} exists already", "remove it, or choose another name for the link"
                ) from error
            raise bad_config(
                f"the link {link} cannot be made: {error.strerror}", "choose another name"
            ) from error

    def _send(self) -> None:
        """Take bytes from the backlog when the line has carried them, and hand them to the host."""
        free_at = time.monotonic()  # when the line has carried all that was sent so far
        while True:
            with self._changed:
                if not self._backlog:
                    self._changed.wait_for(lambda: self._backlog or self._closing)
                    free_at = time.monotonic()
                if self._closing:
                    return
                rate = self.baudrate / BITS_PER_BYTE
                size = self._ready(rate)
            free_at += size / rate
            time.sleep(max(free_at - time.monotonic(), 0.0))
            with self._changed:
                data = bytes(self._backlog[:size])  # shorter when the cable was pulled meanwhile
                self._deliver(data)
                del self._backlog[:size]
                self._changed.notify_all()

    def _ready(self, rate: float) -> int:
        """Return how many bytes are handed over at once, by bytes per s."""
        return min(len(self._backlog), math.ceil(rate * CHUNK_S))

    def _deliver(self, data: bytes) -> None:
        if self._master is None or not self.host_listens():
            self.bytes_lost += len(data)
            return
        ratio = self.baudrate / max(self.host_baudrate(), 1)
        if self._sampler.ratio != ratio:  # the host has set another rate
            self._sampler = Sampler(ratio)
        with suppress(BlockingIOError):  # a host that does not read loses what finds its buffers full
            os.write(self._master, self._sampler.feed(data))
        self.bytes_sent += len(data)

    def _lose_backlog(self) -> None:
        self.bytes_lost += len(self._backlog)
        self._backlog.clear()
        self._changed.notify_all()


_LEVELS = [bytes([0, *((byte >> bit) & 1 for bit in range(8)), 1]) for byte in range(256)]
"""Of the line for each byte: start bit, eight data bits, stop bit."""


class Sampler:
    """What a UART makes of a line whose bits last `ratio` of its own bit times.

    The line is taken as one stream of bytes without pauses, so the result does not depend on how it is cut.
    """

    def __init__(self, ratio: float) -> None:
        self.ratio = ratio
        self._stop = 9.5 * ratio
        self._bits = [int((bit + 1.5) * ratio) for bit in range(8)]  # places behind that of the start bit
        self._line = bytearray([1])  # levels, one per bit of the sender
        self._position = 0.0  # where the receiver looks for the next start bit, in bits of the sender

    def feed(self, data: bytes) -> bytes:
        """Return the bytes that the receiver completes while these are on the line."""
        if abs(self.ratio - 1) <= SAMPLING_TOLERANCE:
            return data
        line = self._line
        line += b"".join(map(_LEVELS.__getitem__, data))
        received = bytearray()
        # Where the line falls from 1 to 0.
        while start := 1 + line.find(b"\x01\x00", int(self._position)):
            stop = start + self._stop
            if stop >= len(line):
                break
            byte = 0
            for bit, place in enumerate(self._bits):
                byte |= line[start + place] << bit
            received.append(byte)
            self._position = stop
        used = max(int(self._position) - 1, 0)
        del self._line[:used]
        self._position -= used
        return bytes(received)


def _leads_to(link: Path, node: str) -> bool:
    return link.is_symlink() and str(link.readlink()) == node


def _termios2(fd: int) -> "array.array[int]":
    buffer = array.array("i", [0] * _TERMIOS2_INTS)
    fcntl.ioctl(fd, _TCGETS2, buffer)
    return buffer


def _set_rate(fd: int, baudrate: int) -> None:
    buffer = _termios2(fd)
    buffer[_CFLAG] = (buffer[_CFLAG] & ~termios.CBAUD) | _BOTHER
    buffer[_ISPEED] = buffer[_OSPEED] = baudrate
    fcntl.ioctl(fd, _TCSETS2, buffer)
