"""Serial ports of this computer: which there are, who has them open; and errors of ports, with what to do."""

import errno
import grp
import os
import pwd
import stat
import termios
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports as list_ports_of_pyserial
from serial.tools.list_ports_common import ListPortInfo

from imumon.errors import ImumonError, Reason, bad_config

from .settings import PortSettings

SYS_TTY = Path("/sys/class/tty")
BY_ID = Path("/dev/serial/by-id")
PROC = Path("/proc")
TRIES, PAUSE_S = 3, 0.05

PORT_ERRORS: tuple[type[Exception], ...] = (OSError, termios.error)
"""What pyserial and the system raise when a port fails (`SerialException` is an `OSError`)."""

_REASON_BY_ERRNO: dict[int, Reason] = {
    errno.EACCES: Reason.PERMISSION,
    errno.EPERM: Reason.PERMISSION,
    errno.EBUSY: Reason.BUSY,
    errno.EAGAIN: Reason.BUSY,
    errno.EIO: Reason.LOST,
}
"""Reason for which opening failed; everything else means that there is no such port."""


@dataclass(frozen=True)
class PortInfo:
    """A serial port that exists, as adapter and system call it.

    `device` opens it; so does `by_id`, of ``/dev/serial/by-id``, which stays the same when adapters are
    replugged in another order.  Vendor, product and serial number are those of USB, None for other ports.
    `latency_timer_ms` is how long an FTDI adapter holds bytes back at the most, None where the driver has no
    such timer; `accessible`: whether this user may read and write the port; `holders`: other programs that
    have it open, as far as this user may see them.
    """

    device: str
    description: str
    vid: int | None
    pid: int | None
    serial_number: str | None
    driver: str | None
    by_id: str | None
    latency_timer_ms: int | None
    accessible: bool
    holders: tuple[str, ...]

    @property
    def usb_id(self) -> str:
        """Vendor and product id as ``0403:6001``; empty for a port that is not USB."""
        return f"{self.vid:04x}:{self.pid:04x}" if self.vid is not None and self.pid is not None else ""

    def __str__(self) -> str:
        facts = ", ".join(fact for fact in (self.description, self.usb_id) if fact and fact != "n/a")
        return f"{self.device} ({facts})" if facts else self.device


def list_ports() -> list[PortInfo]:
    """Return the serial ports that exist, by name."""
    links = {os.path.realpath(link): str(link) for link in sorted(BY_ID.glob("*"))}
    return [
        PortInfo(
            device=port.device,
            description=port.description or "",
            vid=port.vid,
            pid=port.pid,
            serial_number=port.serial_number,
            driver=driver(port.device),
            by_id=links.get(os.path.realpath(port.device)),
            latency_timer_ms=latency_timer_ms(port.device),
            accessible=os.access(port.device, os.R_OK | os.W_OK),
            holders=tuple(holders(port.device)),
        )
        for port in _comports()
    ]


def describe_ports() -> str:
    """Return one sentence that names the ports that exist; cheap enough for an error message."""
    devices = [
        f"{port.device} ({port.description})" if port.vid is not None else port.device for port in _comports()
    ]
    return "ports that exist: " + ", ".join(devices) if devices else "no serial ports exist"


def _comports() -> list[ListPortInfo]:
    """Return what pyserial finds, by name; it stumbles over an adapter that is being unplugged right now."""
    for _ in range(TRIES):
        try:
            return sorted(list_ports_of_pyserial.comports())
        except (OSError, TypeError):  # int(None), from a file of sysfs that has just gone
            time.sleep(PAUSE_S)
    return []


def driver(device: str) -> str | None:
    """Return the kernel driver of a device such as ``/dev/ttyUSB0``, or None."""
    link = _sys_device(device) / "driver"
    return link.resolve().name if link.exists() else None


def latency_timer_path(device: str) -> Path:
    """Return where the kernel keeps the latency timer of an FTDI adapter."""
    return _sys_device(device) / "latency_timer"


def latency_timer_ms(device: str) -> int | None:
    """Return the latency timer in ms, or None where the driver has none."""
    try:
        return int(latency_timer_path(device).read_text())
    except (OSError, ValueError):
        return None


def holders(device: str) -> list[str]:
    """Return the other processes that have the device open, as ``command (pid 123)``.

    Only Linux reports them, and only processes that this user may look into.
    """
    target = os.path.realpath(device)
    found: list[str] = []
    for process in PROC.glob("[0-9]*"):
        open_files = set[str]()
        with suppress(OSError):  # another user's process, or it has just ended
            for entry in (process / "fd").iterdir():
                with suppress(OSError):  # closed since the folder was listed
                    open_files.add(str(entry.readlink()))
        if target in open_files and int(process.name) != os.getpid():
            found.append(f"{_command(process)} (pid {process.name})")
    return found


def _command(process: Path) -> str:
    try:
        text = (process / "cmdline").read_text(errors="replace").replace("\0", " ").strip()
    except OSError:
        return "a process"
    return text if len(text) <= 60 else text[:57] + "..."


def _sys_device(device: str) -> Path:
    return SYS_TTY / Path(os.path.realpath(device)).name / "device"


def open_error(settings: PortSettings, error: Exception) -> ImumonError:
    """Explain why a port could not be opened: NOT_FOUND, PERMISSION, BUSY, LOST or BAD_CONFIG."""
    number = _errno(error)
    if isinstance(error, ValueError):
        return bad_config(f"{settings}: {error}", "Check baud rate and name of the port.")
    seen = f"{settings} cannot be opened: {_errno_text(number, error)}"
    if not settings.has_line:
        hint = "Check host and port, and that the server runs; a serial server often takes one client only."
        return ImumonError(Reason.NOT_FOUND, seen, hint)
    device = settings.url
    reason = _REASON_BY_ERRNO.get(number or 0, Reason.NOT_FOUND)
    if reason is Reason.PERMISSION:
        more, hint = _permission(device)
    elif reason is Reason.BUSY and (others := holders(device)):
        more, hint = "open in " + ", ".join(others), "Close that program, then try again."
    elif reason is Reason.BUSY:
        more = "held by this program itself, or by a user whose processes are not visible"
        hint = f"`sudo fuser -v {device}` shows which program it is; ModemManager is a usual one."
    elif reason is Reason.LOST:
        more = "the device is there but does not answer its driver"
        hint = f"Replug it; see `dmesg` for {device}."
    elif number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR) and Path(device).exists():
        more = "it exists but is not a serial port"
        hint = f"`imumon decode {device} --device NAME` reads a file of bytes; {describe_ports()}"
    else:
        more = describe_ports()
        hint = (
            "Plug the device in (`dmesg` shows whether USB detects it), or give the name of one that exists."
        )
    return ImumonError(reason, f"{seen}; {more}", hint)


def lost_error(settings: PortSettings, cause: Exception | str) -> ImumonError:
    """Explain that an open port failed: LOST with the error or the observation that shows it."""
    what = cause if isinstance(cause, str) else _errno_text(_errno(cause), cause)
    hint = "Check cable and power; `dmesg` shows what the USB bus detected."
    if not settings.has_line:
        hint = "Check the network, and that the server still runs."
    return ImumonError(Reason.LOST, f"{settings} was lost: {what}", hint)


def silent_error(settings: PortSettings, seconds: float) -> ImumonError:
    """Explain that an open port brings no bytes: SILENT with the time waited."""
    return ImumonError(
        Reason.SILENT,
        f"{settings} is open but silent: 0 bytes in the last {seconds:.1f} s",
        "Check power, that RX and TX are not swapped, and that the device sends by itself"
        " (not in command or polled mode).",
    )


def wrong_baud_error(
    settings: PortSettings, bytes_per_s: float, framed: float, odd: float | None = None
) -> ImumonError:
    """Explain that bytes arrive but do not frame: WRONG_BAUD.

    `framed` is the share of bytes that belong to valid packets, `odd` that of 0x00 and 0xFF among all.
    """
    odd_text = "" if odd is None else f", {odd:.0%} are 0x00 or 0xFF"
    return ImumonError(
        Reason.WRONG_BAUD,
        f"{settings}: {bytes_per_s:.0f} bytes/s arrive, {framed:.1%} of them frame{odd_text}",
        f"Another baud rate or protocol? `imumon detect {settings.url}` tries them and shows the evidence.",
    )


def _errno(error: BaseException | None) -> int | None:
    """Return the system's error number from an exception or those it was raised from.

    pyserial often keeps the number only in the exception that it caught.
    """
    while error is not None:
        if isinstance(error, TimeoutError):
            return error.errno or errno.ETIMEDOUT
        number = error.args[0] if error.args else None
        if isinstance(error, PORT_ERRORS) and isinstance(number, int):
            return number
        error = error.__cause__ or error.__context__
    return None


def _errno_text(number: int | None, error: Exception) -> str:
    if number is None or number not in errno.errorcode:  # the resolver has its own, negative numbers
        return str(error)
    return f"{os.strerror(number)} (errno {number}, {errno.errorcode[number]})"


def _permission(device: str) -> tuple[str, str]:
    """Name owner, group and mode of the node, and the usual way in, where it leads there."""
    try:
        node = Path(device).stat()
    except OSError as error:
        return f"and its folder cannot be searched: {error.strerror}", ""
    owner, group, user = str(node.st_uid), str(node.st_gid), str(os.geteuid())
    with suppress(KeyError):  # an id without a name
        group = grp.getgrgid(node.st_gid).gr_name
        owner, user = (pwd.getpwuid(uid).pw_name for uid in (node.st_uid, os.geteuid()))
    seen = f"{device} is {stat.filemode(node.st_mode)} {owner}:{group}"
    if not node.st_mode & stat.S_IWGRP or node.st_gid in (0, *os.getgroups()):
        return seen, "No group gives access: see the udev rules, the container or the security policy."
    return (
        seen,
        f"sudo usermod -aG {group} {user}    (then, or if you are in it already, log out and in again)",
    )
