"""Serial ports of this computer: what they are, who may open them, who has them open."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from serial.tools import list_ports as list_ports_of_pyserial
from serial.tools.list_ports_common import ListPortInfo

SYS_TTY = Path("/sys/class/tty")
BY_ID = Path("/dev/serial/by-id")
PROC = Path("/proc")
TRIES, PAUSE_S = 3, 0.05


@dataclass(frozen=True, slots=True)
class PortInfo:
    """A serial port that exists."""

    device: str
    """Name to open it by."""
    description: str
    """What the adapter or the operating system calls it."""
    vid: int | None
    pid: int | None
    """USB vendor and product id; None for a port that is not USB."""
    serial_number: str | None
    """USB serial number."""
    driver: str | None
    """Kernel driver."""
    by_id: str | None
    """Name under ``/dev/serial/by-id``, which stays the same when adapters are replugged in another order."""
    latency_timer_ms: int | None
    """How long an FTDI adapter holds bytes back at the most; None where the driver has no such timer."""
    accessible: bool
    """Whether this user may read and write it."""
    holders: tuple[str, ...]
    """Other programs that have it open, as far as this user may see them."""

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
    found = [
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
    return sorted(found, key=lambda port: port.device)


def describe_ports() -> str:
    """Return one sentence that names the ports that exist; cheap enough for an error message."""
    devices = sorted(
        f"{port.device} ({port.description})" if port.vid is not None else port.device for port in _comports()
    )
    return "ports that exist: " + ", ".join(devices) if devices else "no serial ports exist"


def _comports() -> list[ListPortInfo]:
    """Ask pyserial, which stumbles over an adapter that is being unplugged at this moment."""
    for _ in range(TRIES):
        try:
            return list(list_ports_of_pyserial.comports())
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

    Only Linux reports them, and only processes that this user may look into; others are not in the list.
    """
    target = os.path.realpath(device)
    found: list[str] = []
    for process in sorted(PROC.glob("[0-9]*"), key=lambda folder: int(folder.name)):
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
        words = (process / "cmdline").read_bytes().split(b"\0")
    except OSError:
        return "a process"
    text = b" ".join(words).decode(errors="replace").strip()
    return text if len(text) <= 60 else text[:57] + "..."


def _sys_device(device: str) -> Path:
    return SYS_TTY / Path(os.path.realpath(device)).name / "device"
