"""Errors of ports: what the operating system reported, what is there, and what to do about it."""

from __future__ import annotations

import errno
import grp
import os
import pwd
import stat
import termios
from contextlib import suppress
from pathlib import Path

from imumon.errors import ImumonError, Reason, bad_config
from imumon.transport.ports import describe_ports, holders
from imumon.transport.settings import PortSettings

PORT_ERRORS: tuple[type[Exception], ...] = (OSError, termios.error)
"""What pyserial and the system raise when a port fails (`SerialException` is an `OSError`)."""
OPEN_ERRORS: tuple[type[Exception], ...] = (*PORT_ERRORS, ValueError)
"""The same while opening, where pyserial also refuses values."""
UDEV_RULES = "/etc/udev/rules.d/70-imumon.rules"
NETWORK_SCHEMES = ("socket", "rfc2217")

_REASON_BY_ERRNO: dict[int, Reason] = {
    errno.EACCES: Reason.PERMISSION,
    errno.EPERM: Reason.PERMISSION,
    errno.EBUSY: Reason.BUSY,
    errno.EAGAIN: Reason.BUSY,
    errno.EIO: Reason.LOST,
}
"""Reason for which opening failed; everything else means that there is no such port."""


def open_error(settings: PortSettings, error: Exception) -> ImumonError:
    """Explain why a port could not be opened: NOT_FOUND, PERMISSION, BUSY, LOST or BAD_CONFIG."""
    number = _errno(error)
    if isinstance(error, ValueError):
        hint = "Check baud rate and URL; besides devices: socket://, rfc2217://, spy://, loop://, hwgrep://."
        return bad_config(f"{settings}: {error}", hint)
    seen = f"{settings} cannot be opened: {_errno_text(number, error)}"
    if settings.scheme in NETWORK_SCHEMES:
        hint = "Check host and port, and that the server runs; a serial server often takes one client only."
        return ImumonError(Reason.NOT_FOUND, seen, hint)
    device = settings.device
    reason = _REASON_BY_ERRNO.get(number or 0, Reason.NOT_FOUND)
    if reason is Reason.PERMISSION:
        more, hint = _permission(device)
    elif reason is Reason.BUSY:
        more, hint = _busy(device)
    elif reason is Reason.LOST:
        more = "the device is there but does not answer its driver"
        hint = f"Replug it; see `dmesg` for {device}."
    else:
        more, hint = _not_found(device, number)
    return ImumonError(reason, f"{seen}; {more}", hint)


def lost_error(settings: PortSettings, cause: Exception | str) -> ImumonError:
    """Explain that an open port failed: LOST with the error or the observation that shows it."""
    what = cause if isinstance(cause, str) else _errno_text(_errno(cause), cause)
    hint = "Check cable and power; `dmesg` shows what the USB bus detected."
    if settings.scheme in NETWORK_SCHEMES:
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


def _not_found(device: str, number: int | None) -> tuple[str, str]:
    if number in (errno.ENOTTY, errno.EINVAL, errno.EISDIR) and Path(device).exists():
        return "it exists but is not a serial port", describe_ports()
    hint = "Plug the device in, or give one of these names."
    ports = describe_ports()
    if ports.startswith("no "):
        hint = "Plug the device in; `dmesg` shows whether the USB bus detects it and a driver takes it."
    return ports, hint


def _busy(device: str) -> tuple[str, str]:
    others = holders(device)
    if others:
        return "open in " + ", ".join(others), "Close that program, then try again."
    return (
        "held by this program itself, or by a user whose processes are not visible",
        f"`sudo fuser -v {device}` shows which program it is; ModemManager is a usual one.",
    )


def _permission(device: str) -> tuple[str, str]:
    """Name owner, group and mode of the node, and the way in that really leads there."""
    try:
        node = Path(device).stat()
    except OSError as error:
        return f"and its folder cannot be searched: {error.strerror}", ""
    owner, group, user = str(node.st_uid), str(node.st_gid), str(os.geteuid())
    with suppress(KeyError):  # an id without a name
        group = grp.getgrgid(node.st_gid).gr_name
        owner, user = (pwd.getpwuid(uid).pw_name for uid in (node.st_uid, os.geteuid()))
    seen = f"{device} is {stat.filemode(node.st_mode)} {owner}:{group}"
    both = stat.S_IRGRP | stat.S_IWGRP
    if node.st_mode & both != both or node.st_gid == 0:
        rule = f'SUBSYSTEM=="tty", KERNEL=="{Path(os.path.realpath(device)).name}", TAG+="uaccess"'
        return seen, (
            "No group may open it. A udev rule (which must sort before 73-seat) gives it to the user at the"
            f" screen:\necho '{rule}' | sudo tee {UDEV_RULES}\n"
            "sudo udevadm control --reload && sudo udevadm trigger"
        )
    if node.st_gid in os.getgroups():
        return seen, f"This session is in group {group}, so a container or security policy refuses."
    return (
        seen,
        f"sudo usermod -aG {group} {user}    (then, or if you are in it already, log out and in again)",
    )
