"""What this computer lacks for imumon, and the plug-ins: of which package each is, and whether it loads."""

import errno
import os
import platform
import re
import shutil
import subprocess
from collections.abc import Iterator
from importlib import metadata
from itertools import chain
from pathlib import Path
from typing import Literal, NamedTuple

from imumon.effects.kinds import EFFECT, guarded, is_effect
from imumon.errors import ImumonError
from imumon.plugins import DEVICES, EFFECTS, STAGES, WINGS, entries, load, package_of
from imumon.protocols.device import FOLDER, is_folder, load_device
from imumon.stage import STAGE, is_callable, made_by
from imumon.transport.port import latency_text
from imumon.transport.ports import PortInfo, list_ports, open_error
from imumon.transport.settings import PortSettings
from imumon.view.viewer import has_display, quiet_environment, viewer_binary
from imumon.wing import NEEDED, is_wing

VULKAN_DRIVERS = tuple(Path(place, "vulkan/icd.d") for place in ("/usr/share", "/usr/local/share", "/etc"))
BYTES_PER_DAY = 400 * 60 * 86_400
"""A day of packets of 60 bytes at 400 Hz, as wire.mcap keeps them."""


State = Literal["good", "warning", "fault"]
"""How bad a finding is; with a warning it works, and less well than it could."""


class Finding(NamedTuple):
    """Something that was examined: what is there, and what to do about it; nothing when it is good."""

    subject: str
    state: State
    seen: str
    remedy: str = ""


def examine(folder: Path) -> Iterator[Finding]:
    """Examine everything that a recording needs; `folder` is where sessions are written."""
    return chain(packages(), compiled_code(), disk(folder), serial_ports(), viewer(), graphics())


def packages() -> Iterator[Finding]:
    """Name the versions of what imumon requires, and what is missing; `pip check` shows whether they fit."""
    yield Finding("Python", "good", f"{platform.python_version()} on {platform.platform(terse=True)}")
    versions, lacking = list[str](), list[str]()
    needed = [text for text in metadata.requires("imumon") or () if "extra ==" not in text]
    for name in ("imumon", *(re.split(r"[^\w.-]", text)[0] for text in needed)):
        try:
            versions.append(f"{name} {metadata.version(name)}")
        except metadata.PackageNotFoundError:
            lacking.append(name)
    yield Finding("packages", "good", ", ".join(versions))
    if lacking:
        yield Finding(
            "packages",
            "fault",
            f"not installed: {', '.join(lacking)}; imumon needs each of them",
            f"pip install {' '.join(lacking)}",
        )


def compiled_code() -> Iterator[Finding]:
    """Test whether compiled code can be kept."""
    kept = os.environ.get("NUMBA_CACHE_DIR")
    own = [Path(__file__).parents[1], Path.home() / ".cache" / "numba"]
    usable = [place for place in ([Path(kept)] if kept else own) if _writable(place)]
    if usable:
        yield Finding("compiled code", "good", f"it is kept in {usable[0]}")
    else:
        yield Finding(
            "compiled code",
            "fault",
            "no folder for it can be written to, so each start compiles anew",
            "set NUMBA_CACHE_DIR to a folder of yours",
        )


def disk(folder: Path) -> Iterator[Finding]:
    """Test whether the folder of the sessions can be written to, and for how long."""
    elsewhere = "make room, or monitor --out writes elsewhere"
    there = _nearest(folder)
    free = shutil.disk_usage(there).free
    days = free / BYTES_PER_DAY
    seen = f"{free / 1e9:.1f} GB free in {there}: {days:.3g} days of 400 packets of 60 bytes a second"
    if not _writable(there):
        yield Finding("disk", "fault", f"{there} cannot be written to", elsewhere)
    elif days < 1.0:
        yield Finding("disk", "warning", seen, elsewhere)
    else:
        yield Finding("disk", "good", seen)


def serial_ports() -> Iterator[Finding]:
    """Test whether there are serial ports, and what keeps them from being read well."""
    ports = list_ports()
    if not ports:
        yield Finding(
            "serial ports",
            "warning",
            "there are none",
            "plug the adapter in; dmesg shows whether the system found it.  imumon virtual needs none",
        )
    yield from map(_port, ports)


def _port(port: PortInfo) -> Finding:
    timer = port.latency_timer_ms
    if not port.accessible:
        error = open_error(
            PortSettings(port.device), PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        )
        return Finding(port.device, "fault", error.seen, error.hint)
    if port.holders:
        return Finding(
            port.device,
            "warning",
            f"{port}: open in {', '.join(port.holders)}",
            "two readers of one port take bytes from each other: end the other",
        )
    if timer is not None and timer > 1:
        remedy = latency_text(False, port.device, timer)
        return Finding(port.device, "warning", f"{port}: bytes come in bursts", remedy)
    return Finding(port.device, "good", str(port))


def viewer() -> Iterator[Finding]:
    """Test whether the Rerun viewer is there and starts."""
    try:
        command = [str(viewer_binary()), "--version"]
        done = subprocess.run(
            command, env=quiet_environment(), capture_output=True, text=True, timeout=10.0, check=True
        )
        yield Finding("viewer", "good", " ".join(done.stdout.split()[:2]))
    except ImumonError as error:
        yield Finding("viewer", "fault", error.seen, error.hint)
    except (OSError, subprocess.SubprocessError) as error:
        yield Finding(
            "viewer",
            "fault",
            f"it does not start: {error}",
            "pip install --force-reinstall rerun-sdk",
        )


def graphics() -> Iterator[Finding]:
    """Test whether a window can be opened and what draws it."""
    if not has_display():
        yield Finding(
            "display",
            "warning",
            "there is none: no window can be opened",
            "--view web shows a run in a browser, --view terminal where it runs",
        )
    drivers = [file.name for place in VULKAN_DRIVERS if place.is_dir() for file in place.glob("*.json")]
    if drivers:
        yield Finding("graphics", "good", ", ".join(sorted(drivers)))
    else:
        yield Finding(
            "graphics",
            "warning",
            "no Vulkan driver: the viewer's window needs one, or OpenGL",
            "install that of the graphics card, or mesa-vulkan-drivers, which draws on the processor",
        )


def _nearest(place: Path) -> Path:
    """Return a folder, or the one above it that exists."""
    return next(folder for folder in (place, *place.absolute().parents) if folder.exists())


def _writable(place: Path) -> bool:
    return os.access(_nearest(place), os.W_OK | os.X_OK)


class Installed(NamedTuple):
    """An entry point of an installed package."""

    group: str
    name: str
    package: str
    version: str
    # Columns of a stage, devices of a folder, the sensors of an effect; empty when it does not load.
    brings: tuple[str, ...] = ()
    problem: str = ""  # why it does not load; empty when it does


def installed() -> list[Installed]:
    """Return the plug-ins of all groups, each loaded for a try."""
    found = []
    for entry in chain.from_iterable(map(entries, (STAGES, DEVICES, EFFECTS, WINGS))):
        brings, problem = list[str](), ""
        try:
            if entry.group == STAGES:
                brings = [column.name for column in made_by(load(entry, STAGE, is_callable)).columns]
            elif entry.group == DEVICES:
                files = sorted(Path(load(entry, FOLDER, is_folder).offered).glob("*.yaml"))
                brings = [load_device(str(file)).name for file in files]
            elif entry.group == EFFECTS:
                brings = [*guarded(load(entry, EFFECT, is_effect)).sensors]
            else:
                brings = [*load(entry, NEEDED, is_wing).offered.commands]
        except ImumonError as error:
            problem = error.seen
        found.append(Installed(entry.group, entry.name, *package_of(entry), tuple(brings), problem))
    return found
