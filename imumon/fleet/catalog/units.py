"""Sessions with what they show, and the units that they are of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from imumon.columns import TEMPERATURES
from imumon.errors import ImumonError
from imumon.fleet.batch.dataset import Dataset
from imumon.fleet.batch.options import BatchOptions
from imumon.fleet.batch.places import find
from imumon.fleet.batch.tasks import Job, work
from imumon.models.model import BiasModel, load_model
from imumon.recordings.folder import METADATA_NAME, Session, open_session
from imumon.recordings.reduced import GYRO
from imumon.recordings.source import RECORDING
from imumon.run.setup import recorded_setup

SIGMAS = tuple(name.replace("gyro_", "gyro_bias_sd_") for name in GYRO)
LARGEST_MODEL = 1 << 20
"""Bytes: a larger YAML file is no model."""

Tell = Callable[[str], None]


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """A session of the catalog."""

    session: Session
    model: BiasModel | None
    """That it ran with."""
    channels: Mapping[str, Mapping[str, Any]]
    """What a replay says of each channel: mean, sd, least, greatest."""
    failure: str = ""
    """Why there are none; empty when there are."""
    lacking: tuple[str, ...] = ()
    """What the recording lacks, one sentence each."""

    @property
    def hours(self) -> float:
        """Length of the samples that can be read; NaN when that is not known."""
        read_s = next((row.get("duration_s") for row in self.channels.values()), 0.0)
        # Results of an earlier version do not have it.
        return (self.session.metadata.duration_s if read_s is None else float(read_s)) / 3600.0

    @property
    def temperatures(self) -> tuple[float, float]:
        """The lowest and the highest reading of all thermometers, °C; NaN without one."""
        there = [self.channels[name] for name in TEMPERATURES if name in self.channels]
        low, high = (row["least"] for row in there), (row["greatest"] for row in there)
        return min(low, default=np.nan), max(high, default=np.nan)

    @property
    def sigmas(self) -> tuple[float, float]:
        """The smallest sigma of the gyro bias that was reached, of the best axis and of the worst, rad/s."""
        reached = [self.channels[name]["least"] for name in SIGMAS if name in self.channels]
        return min(reached, default=np.nan), max(reached, default=np.nan)

    @property
    def lost(self) -> int | None:
        """Packets that are missing or damaged in what can be read; None where nothing can."""
        return max((row["lost"] for row in self.channels.values()), default=None)


@dataclass(frozen=True, slots=True, eq=False)
class Dated:
    """A bias model, when its latest data is from (Unix time, ns), and where it was found."""

    model: BiasModel
    time_ns: int
    found: str


@dataclass(slots=True, eq=False)
class Unit:
    """A unit: its sessions, the oldest first, and its models, in the order of their data."""

    name: str
    """Serial number; of sessions without one the device, in brackets."""
    device: str
    entries: list[Entry] = field(default_factory=list)
    models: list[Dated] = field(default_factory=list)

    @property
    def temperatures(self) -> tuple[float, float]:
        """The lowest and the highest reading of all sessions, °C."""
        return _range(entry.temperatures for entry in self.entries)

    @property
    def sigmas(self) -> tuple[float, float]:
        """The best and the worst of `Entry.sigmas`, rad/s."""
        return _range(entry.sigmas for entry in self.entries)

    @property
    def begun(self) -> list[int]:
        """When each session began, Unix time, ns."""
        return [entry.session.metadata.created_ns for entry in self.entries]

    @property
    def hours(self) -> float:
        """Of all samples that can be read."""
        return float(np.nansum([entry.hours for entry in self.entries]))


def read_sessions(
    folder: Path, results: Path, tell: Tell = lambda _: None
) -> tuple[list[Entry], dict[str, str]]:
    """Return the sessions below a folder, the oldest first, and why what is none by its metadata is left out.

    What `results` does not have of them is replayed.

    Raises BAD_DATA when there is no session; as `Dataset` for the results.

    Parameters
    ----------
    results : Path
        Folder of ``imumon batch replay``, to which the new ones are added.
    """
    options = BatchOptions(command="replay")
    sessions, left_out = dict[str, Session](), dict[str, str]()
    for place in find(str(folder)):
        try:
            sessions[place] = open_session(Path(place))
        except ImumonError as error:
            left_out[place] = error.line
    known = Dataset(results.absolute(), options)
    try:
        done = known.done()
        for place in sessions:
            if place not in done:
                tell(f"replaying {Path(place).name}")
                known.add(work(Job(place, options, str(known.folder))))
        known.write()
        rows = known.rows([*sessions])
    finally:
        known.close()
    entries = [_entry(session, rows.get(place, [])) for place, session in sessions.items()]
    return sorted(entries, key=lambda entry: entry.session.metadata.created_ns), left_out


def _entry(session: Session, rows: Sequence[Mapping[str, Any]]) -> Entry:
    channels = {row["channel"]: row for row in rows if row["channel"]}
    warnings = (rows[0].get("warnings") if rows else None) or ()
    lacking = tuple(text for text in warnings if RECORDING in text)
    failure = next((row["error"] for row in rows if row["reason"]), "")
    try:
        model = recorded_setup(session).bias_model
    except ImumonError as error:
        return Entry(session, None, channels, failure or error.line, lacking)
    return Entry(session, model, channels, failure, lacking)


def read_models(folder: Path) -> dict[str, BiasModel]:
    """Return the model files below a folder, by their path."""
    found = {}
    for path in sorted(folder.rglob("*.yaml")):
        if path.name == METADATA_NAME or path.stat().st_size > LARGEST_MODEL:
            continue
        if "imumon-bias-model/" in path.read_text(encoding="utf-8", errors="replace"):
            try:
                found[str(path)] = load_model(path)
            except ImumonError:
                continue  # another file that speaks of the format
    return found


def units_of(entries: Sequence[Entry], models: Mapping[str, BiasModel]) -> list[Unit]:
    """Return the units, by name: a serial number is the session's own, or that of a model made of it."""
    trained: dict[str, str] = {}
    for model in [*models.values(), *(entry.model for entry in entries if entry.model is not None)]:
        if model.serial is not None:
            trained |= {run.session: model.serial for run in model.trained_on}
    units: dict[tuple[str, str], Unit] = {}
    begun: dict[str, int] = {}
    for entry in entries:
        metadata, name = entry.session.metadata, entry.session.path.name
        of_model = None if entry.model is None else entry.model.serial
        serial = metadata.serial or trained.get(name) or of_model
        unit = _unit(units, serial, metadata.device)
        unit.entries.append(entry)
        begun[name] = metadata.created_ns
        if entry.model is not None and entry.model.serial in (None, serial):
            _add(unit, entry.model, str(entry.session.path), begun)
    for path, model in models.items():
        _add(_unit(units, model.serial, model.device or "unknown"), model, path, begun)
    for unit in units.values():
        unit.models.sort(key=lambda dated: dated.time_ns)
    return sorted(units.values(), key=lambda unit: unit.name)


def _unit(units: dict[tuple[str, str], Unit], serial: str | None, device: str) -> Unit:
    name = serial or f"({device})"
    return units.setdefault((name, device), Unit(name, device))


def _add(unit: Unit, model: BiasModel, found: str, begun: Mapping[str, int]) -> None:
    """Add a model, unless the unit has it already."""
    if model.channels and all(dated.model != model for dated in unit.models):
        created = int(np.datetime64(model.created.removesuffix("Z"), "ns").astype(np.int64))
        data = [begun[run.session] for run in model.trained_on if run.session in begun]
        unit.models.append(Dated(model, max(data, default=created), found))


def _range(pairs: Iterable[tuple[float, float]]) -> tuple[float, float]:
    """Return the least of the first and the greatest of the second; NaN where nobody knows."""
    known = [pair for pair in pairs if np.isfinite(pair).all()]
    return min((low for low, _ in known), default=np.nan), max((high for _, high in known), default=np.nan)
