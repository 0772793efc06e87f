"""``rack.yaml``: which units stand in a rack, on which ports, and how each is recorded."""

from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

from pydantic import Field, StringConstraints

from imumon.config import StrictModel, parse_yaml
from imumon.errors import ImumonError, bad_config
from imumon.files import read_text
from imumon.models.model import load_model
from imumon.protocols.device import device_text, parse_device
from imumon.run.setup import Setup, load_setup
from imumon.transport.settings import PortSettings

MOST_UNITS = 100
"""Each takes a process, 60 MB and 6 % of a core at 400 Hz: no computer on a bench has room for more."""

Name = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9][A-Za-z0-9_-]{0,31}$")]
"""Of a unit: part of the name of a folder, and of a path in the viewer."""
Text = Annotated[str, StringConstraints(min_length=1, max_length=4096)]
Baud = Annotated[int, Field(ge=1, le=100_000_000)]
"""Of a serial line; the fastest adapters reach 12 MBd."""


class Shared(StrictModel):
    """What units may have in common: device, baud rate, bias model and pipeline file.

    Files are looked for from the folder of ``rack.yaml``; `device` is a name that imumon knows, or a file.
    """

    device: Text | None = None
    baud: Baud | None = None
    model: Text | None = None
    pipeline: Text | None = None


class Place(Shared):
    """One unit; what it does not state, the default states."""

    port: Text
    serial: Text | None = None


class RackFile(StrictModel):
    """The units by their names, in the order in which they are shown."""

    format: Literal["imumon-rack/1"]
    default: Shared = Shared()
    units: dict[Name, Place] = Field(min_length=1, max_length=MOST_UNITS)


class Plan(NamedTuple):
    """One unit as its process receives it: nothing in it refers to a file."""

    name: str
    device_yaml: str
    settings: PortSettings
    serial: str | None
    setup: Setup


def load_rack(path: Path) -> dict[str, Plan]:
    """Read a rack and every file that it names; return the plan of each unit by its name.

    Raises BAD_CONFIG, with file and line, what was found and what was expected.
    """
    text = read_text(path, hint="give a rack file (format: imumon-rack/1)")
    rack = parse_yaml(text, RackFile, str(path))
    ports: dict[str, str] = {}
    for name, place in rack.units.items():
        if (other := ports.setdefault(place.port, name)) != name:
            raise bad_config(f"{path}: units.{name}.port: {place.port} is the port of {other} already")
    return {name: _plan(name, place, rack.default, path) for name, place in rack.units.items()}


def _plan(name: str, place: Place, default: Shared, path: Path) -> Plan:
    unit = Place.model_validate(default.model_dump() | place.model_dump(exclude_none=True))
    if unit.device is None:
        text = "neither the unit nor the default names its device"
        raise bad_config(f"{path}: units.{name}.device: {text}")
    try:
        own = path.parent / unit.device  # a device file beside the rack's, else a name that imumon knows
        device_yaml, source = device_text(str(own) if own.is_file() else unit.device)
        settings = parse_device(device_yaml, source).port_settings(unit.port, unit.baud)
        setup = Setup() if unit.pipeline is None else load_setup(path.parent / unit.pipeline)
        if unit.model is not None:
            setup = setup.with_options(model=load_model(path.parent / unit.model))
    except ImumonError as error:
        raise ImumonError(error.reason, f"{path}: {name}: {error.seen}", error.hint) from error
    except OSError as error:  # of a name that no file can have, and of a folder that nobody may look into
        raise bad_config(f"{path}: {name}: {error.filename}: {error.strerror}") from error
    return Plan(name, device_yaml, settings, unit.serial, setup)


def changes(path: Path) -> Iterator[bool]:
    """Yield, once for each change, that a file is another one and stays so: it may be half written."""
    read: tuple[int, int, int] | None = None
    latest = read
    while True:
        before, latest = latest, None
        with suppress(OSError):  # there is none
            now = path.stat()
            latest = now.st_mtime_ns, now.st_size, now.st_ino
        is_new = latest is not None and latest == before != read
        if is_new or read is None:
            read = latest
        yield is_new
