"""What this computer lacks for imumon, each finding with what to do about it."""

from __future__ import annotations

import errno
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import Enum
from importlib import metadata
from pathlib import Path

from imumon.errors import ImumonError
from imumon.run.plugins import installed
from imumon.transport.errors import open_error
from imumon.transport.ports import PortInfo, latency_timer_path, list_ports
from imumon.transport.settings import PortSettings
from imumon.transport.terminal import latency_text
from imumon.view.viewer import (
    VIEWER_PORT,
    WEB_PORT,
    Answer,
    has_display,
    probe,
    quiet_environment,
    viewer_binary,
)

DISTRIBUTION = "imumon"
VULKAN_DRIVERS = tuple(Path(place, "vulkan/icd.d") for place in ("/usr/share", "/usr/local/share", "/etc"))
GRAPHICS_CARDS = ("/dev/dri/renderD*", "/dev/nvidia[0-9]*")
"""What the kernel makes for a graphics card; without one, drivers of cards draw nothing."""
BYTES_PER_DAY = 400 * 60 * 86_400
"""A day of packets of 60 bytes at 400 Hz, as wire.mcap keeps them."""
ANSWER_S = 10.0


class State(Enum):
    """How bad a finding is."""

    GOOD = "good"
    WARNING = "warning"
    """It works, and less well than it could."""
    FAULT = "fault"
    """Something does not work."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Something that was looked at."""

    subject: str
    """What was looked at."""
    state: State
    seen: str
    """What is there."""
    remedy: str = ""
    """What to do; empty when it is good."""


def examine(folder: Path) -> Iterator[Finding]:
    """Look at everything that a recording needs, one finding after the other.

    Parameters
    ----------
    folder : Path
        Where sessions are written.
    """
    looks: tuple[Callable[[], Iterator[Finding]], ...] = (
        packages,
        plug_ins,
        compiled_code,
        lambda: disk(folder),
        serial_ports,
        viewer,
        graphics,
    )
    for look in looks:
        yield from look()


def packages() -> Iterator[Finding]:
    """Look whether each package that imumon requires is there in a version that it takes."""
    from packaging.requirements import Requirement  # a requirement of matplotlib

    yield Finding("Python", State.GOOD, f"{platform.python_version()} on {platform.platform(terse=True)}")
    wrong, found = [], [f"{DISTRIBUTION} {metadata.version(DISTRIBUTION)}"]
    for text in metadata.requires(DISTRIBUTION) or ():
        required = Requirement(text)
        if required.marker is not None and not required.marker.evaluate({"extra": ""}):
            continue
        try:
            version = metadata.version(required.name)
        except metadata.PackageNotFoundError:
            wrong.append(f"{required} is not installed")
            continue
        if required.specifier.contains(version, prereleases=True):
            found.append(f"{required.name} {version}")
        else:
            wrong.append(f"{required.name} {version} is not {required.specifier}")
    if wrong:
        yield Finding(
            "packages", State.FAULT, "; ".join(wrong), "install imumon again, with what it requires"
        )
    yield Finding("packages", State.GOOD, ", ".join(found))


def plug_ins() -> Iterator[Finding]:
    """Look whether each plug-in loads."""
    found = installed()
    for plugin in found:
        if plugin.problem:
            remedy = f"mend or remove it (pip uninstall {plugin.package}), or imumon --without-plugins"
            yield Finding("plug-ins", State.FAULT, plugin.problem, remedy)
    if whole := [f"{plugin.name} of {plugin.package}" for plugin in found if not plugin.problem]:
        yield Finding("plug-ins", State.GOOD, ", ".join(whole))


def compiled_code() -> Iterator[Finding]:
    """Look whether compiled code can be kept, and whether there is any."""
    spec = importlib.util.find_spec(DISTRIBUTION)
    package = Path(next(iter((spec.submodule_search_locations if spec else None) or [""])))
    kept = os.environ.get("NUMBA_CACHE_DIR")
    own = Path.home() / ".cache" / "numba"
    places = [Path(kept)] if kept else [package, own]
    usable = [place for place in places if _writable(place)]
    if not usable:
        tried = " nor ".join(map(str, places))
        yield Finding(
            "compiled code",
            State.FAULT,
            f"neither {tried} can be written to, so each start compiles anew",
            "set NUMBA_CACHE_DIR to a folder of yours",
        )
        return
    count = sum(1 for place in usable for _ in place.rglob("*.nbi"))
    if not count:
        yield Finding(
            "compiled code",
            State.WARNING,
            f"none in {usable[0]}: the first recording waits until it is made",
            "imumon virtual in one terminal, imumon monitor in another: what they need is then ready",
        )
        return
    yield Finding("compiled code", State.GOOD, f"{count} functions kept in {usable[0]}")


def disk(folder: Path) -> Iterator[Finding]:
    """Look whether the folder of the sessions can be written to, and for how long."""
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    if not _writable(there):
        yield Finding("disk", State.FAULT, f"{there} cannot be written to", "monitor --out writes elsewhere")
        return
    free = shutil.disk_usage(there).free
    days = free / BYTES_PER_DAY
    seen = f"{free / 1e9:.1f} GB free in {there}: {days:.3g} days of 400 packets of 60 bytes a second"
    if days < 1.0:
        yield Finding("disk", State.WARNING, seen, "make room; monitor --out writes elsewhere")
    else:
        yield Finding("disk", State.GOOD, seen)


def serial_ports() -> Iterator[Finding]:
    """Look whether there are serial ports, and what keeps them from being read well."""
    ports = list_ports()
    if not ports:
        yield Finding(
            "serial ports",
            State.WARNING,
            "there are none",
            "plug the adapter in; dmesg tells whether the system saw it.  imumon virtual needs none",
        )
    for port in ports:
        yield _port(port)


def _port(port: PortInfo) -> Finding:
    settings = PortSettings(port.device)
    if not port.accessible:
        error = open_error(settings, PermissionError(errno.EACCES, os.strerror(errno.EACCES)))
        return Finding(port.device, State.FAULT, error.seen, error.hint)
    if port.holders:
        return Finding(
            port.device,
            State.WARNING,
            f"{port}: open in {', '.join(port.holders)}",
            "two readers of one port take bytes from each other: end the other",
        )
    timer = port.latency_timer_ms
    if timer is not None and timer > 1:
        text = latency_text(False, timer, str(latency_timer_path(port.device)))
        seen, _, remedy = text.partition("; to change it: ")
        return Finding(port.device, State.WARNING, f"{port}: low latency is {seen}", remedy)
    return Finding(port.device, State.GOOD, str(port))


def viewer() -> Iterator[Finding]:
    """Look whether the Rerun viewer is there and starts, and who has its ports."""
    try:
        binary = viewer_binary()
        words = subprocess.run(
            [binary, "--version"],
            env=quiet_environment(),
            capture_output=True,
            text=True,
            timeout=ANSWER_S,
            check=True,
        ).stdout.split()
    except ImumonError as error:
        yield Finding("viewer", State.FAULT, error.seen, error.hint)
    except (OSError, subprocess.SubprocessError) as error:
        yield Finding(
            "viewer", State.FAULT, f"it does not start: {error}", "pip install --force-reinstall rerun-sdk"
        )
    else:
        yield Finding("viewer", State.GOOD, f"Rerun {words[1] if len(words) > 1 else 'of unknown version'}")
    for port, use in ((VIEWER_PORT, "a window"), (WEB_PORT, "a browser")):
        if probe(port) in (Answer.OTHER, Answer.SILENT):
            yield Finding(
                "viewer",
                State.WARNING,
                f"port {port}, where {use} is served, belongs to another program",
                "nothing to do: the next free one is taken, and the address that is printed says so",
            )


def graphics() -> Iterator[Finding]:
    """Look whether a window can be opened and what draws it."""
    if not has_display():
        yield Finding(
            "display",
            State.WARNING,
            "there is none: no window can be opened",
            "--view web shows a run in a browser, --view terminal where it runs",
        )
    if sys.platform != "linux":
        return
    drivers = [file.name for place in VULKAN_DRIVERS if place.is_dir() for file in place.glob("*.json")]
    if not drivers:
        yield Finding(
            "graphics",
            State.WARNING,
            "no Vulkan driver: the viewer's window needs one, or OpenGL",
            "install that of the graphics card, or mesa-vulkan-drivers, which draws on the processor",
        )
    elif not any(list(Path("/").glob(pattern[1:])) for pattern in GRAPHICS_CARDS):
        yield Finding(
            "graphics",
            State.WARNING,
            "no graphics card that this user sees: the window is drawn by the processor, slowly",
            "--view web shows a run in a browser on another computer; --view terminal needs neither",
        )
    else:
        yield Finding("graphics", State.GOOD, ", ".join(sorted(drivers)))


def _writable(place: Path) -> bool:
    """Return whether a folder can be written to, or be made."""
    there = next(folder for folder in (place, *place.absolute().parents) if folder.exists())
    return os.access(there, os.W_OK | os.X_OK)
