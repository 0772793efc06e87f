"""Sessions and the units that they are of, each with its row of the catalog's tables."""

from collections.abc import Callable, Sequence
from contextlib import closing, suppress
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imumon.columns import TEMPERATURES
from imumon.errors import ImumonError
from imumon.lab.diagnosis.page import shown
from imumon.models.model import BiasModel, load_model
from imumon.recordings.folder import METADATA_NAME, Session, fingerprint, open_session
from imumon.recordings.reduced import GYRO
from imumon.run.setup import recorded_setup

from ..batch.dataset import BatchOptions, Dataset, Row, lacking
from ..batch.places import find
from ..batch.tasks import Job, work

SIGMAS = tuple(name.replace("gyro_", "gyro_bias_sd_") for name in GYRO)
COLDEST, HOTTEST = "coldest_degc", "hottest_degc"
BEST, WORST = "best_sigma_rad_per_s", "worst_sigma_rad_per_s"
"""Columns of a session and of a unit; the sigmas are the smallest of the gyro bias that were reached."""
EXTREMES = {COLDEST: np.fmin, HOTTEST: np.fmax, BEST: np.fmin, WORST: np.fmax}
"""What a unit has of its sessions; NaN counts for none."""


class Entry(NamedTuple):
    """A session of the catalog, with the model it ran with, and what its recording lacks, one sentence each.

    `row` is that of the table of sessions: times in ns, unknown numbers NaN.
    """

    session: Session
    model: BiasModel | None
    row: Row
    lacking: Sequence[str]


class Dated(NamedTuple):
    """A bias model, and when its latest data is from (Unix time, ns)."""

    model: BiasModel
    time_ns: int


class Outlier(NamedTuple):
    """A value of a unit, in rad/s, far from those of the others of its device.

    `score` is the modified z-score: about its distance from the median in sigmas of the others.
    """

    what: str
    value: float
    median: float
    score: float

    def __str__(self) -> str:
        factor, unit = shown("rad/s")
        values = f"{factor * self.value:.3g} {unit}, the others {factor * self.median:.3g}"
        return f"{self.what}: {values} (score {self.score:.1f})"


@dataclass(eq=False)
class Unit:
    """A unit: its sessions, the oldest first, its models, in the order of their data, and its worst outliers.

    Its name is the serial number; of sessions without one the device, in brackets.
    """

    name: str
    device: str
    entries: list[Entry] = field(default_factory=list)
    models: list[Dated] = field(default_factory=list)
    outliers: list[Outlier] = field(default_factory=list)

    @property
    def row(self) -> dict[str, Any]:
        """Of the table of units, without its outliers."""
        rows = [entry.row for entry in self.entries]
        begun = [row["begun"] for row in rows]
        return {
            "unit": self.name,
            "device": self.device,
            "sessions": len(rows),
            "first": min(begun, default=None),
            "last": max(begun, default=None),
            "hours": float(np.nansum([row["hours"] for row in rows])),
            **{
                name: float(pick.reduce([row[name] for row in rows], initial=np.nan))
                for name, pick in EXTREMES.items()
            },
            "models": len(self.models),
            "latest_model": self.models[-1].model.created if self.models else None,
        }


def read_sessions(
    folder: Path, results: Path, progress: Callable[[str], None]
) -> tuple[list[Entry], dict[str, str]]:
    """Return the sessions below a folder, the oldest first, and why what is none by its metadata is left out.

    What the folder `results` of ``imumon batch replay`` does not have of them is replayed and added to it.

    Raises BAD_DATA when there is no session; as `Dataset` for the results.
    """
    sessions, left_out = dict[str, Session](), dict[str, str]()
    for place in find(str(folder)):
        try:
            sessions[place] = open_session(Path(place))
        except ImumonError as error:
            left_out[place] = error.line
    options = BatchOptions(command="replay")
    with closing(Dataset(results.absolute(), options)) as known:
        begun = {place: session.metadata.created_ns for place, session in sessions.items()}
        left = known.left(begun, retry=True)
        for number, place in enumerate(left, 1):
            progress(f"replaying {Path(place).name}, {number} of {len(left)}")
            known.add(work(Job(place, options, str(known.folder))))
        known.write()
        rows = known.rows(sessions)
    entries = [_entry(session, rows[place]) for place, session in sessions.items()]
    return sorted(entries, key=lambda entry: entry.row["begun"]), left_out


def _entry(session: Session, rows: Sequence[Row]) -> Entry:
    """Return a session with what the rows of its replay show, one for each channel."""
    metadata, channels = session.metadata, {row["channel"]: row for row in rows if row["channel"]}
    any_row: Row = next(iter(channels.values()), {"duration_s": 0.0})
    failure = next((row["error"] for row in rows if row["reason"]), None)
    model = None
    try:
        model = recorded_setup(session).bias_model
    except ImumonError as error:
        failure = failure or error.line

    def extreme(pick: Callable[..., float], names: Sequence[str], of: str) -> float:
        return pick((channels[name][of] for name in names if name in channels), default=np.nan)

    row = {
        "session": str(session.path),
        "device": metadata.device,
        "state": session.state,
        "begun": metadata.created_ns,
        "hours": any_row["duration_s"] / 3600.0,
        COLDEST: extreme(min, TEMPERATURES, "least"),
        HOTTEST: extreme(max, TEMPERATURES, "greatest"),
        BEST: extreme(min, SIGMAS, "least"),
        WORST: extreme(max, SIGMAS, "least"),
        "lost": any_row.get("lost"),
        "model": None if model is None else model.created,
        "error": failure,
    }
    return Entry(session, model, row, lacking(rows[0]) if rows else ())


def read_models(folder: Path) -> list[BiasModel]:
    """Return the models in the files below a folder."""
    found = []
    for path in sorted(folder.rglob("*.yaml")):
        if path.name != METADATA_NAME and b"imumon-bias-model/" in path.read_bytes():
            with suppress(ImumonError):  # another file that mentions the format
                found.append(load_model(path))
    return found


def units_of(entries: Sequence[Entry], models: Sequence[BiasModel]) -> list[Unit]:
    """Return the units, by name: a serial number is the session's own, or that of a model made of it."""
    every = [*models, *(entry.model for entry in entries if entry.model is not None)]
    runs = [(run, one.serial) for one in every if one.serial for run in one.trained_on]
    trained, names = {run.sha256: serial for run, serial in runs}, {run.session for run, _ in runs}
    units: dict[tuple[str, str], Unit] = {}
    made: list[tuple[Unit, BiasModel]] = []

    def unit_of(serial: str | None, device: str) -> Unit:
        name = serial or f"({device})"
        return units.setdefault((name, device), Unit(name, device))

    for entry in entries:
        metadata, model = entry.session.metadata, entry.model
        serial = metadata.serial
        if not serial and entry.session.path.name in names:  # two units may have sessions of one name
            serial = trained.get(fingerprint(entry.session.truth_path))
        serial = serial or (None if model is None else model.serial)
        unit = unit_of(serial, metadata.device)
        unit.entries.append(entry)
        if model is not None and model.serial in (None, serial):
            made.append((unit, model))
    made += [(unit_of(model.serial, model.device or "unknown"), model) for model in models]
    for unit, model in made:
        of = {run.session for run in model.trained_on}
        data = [entry.row["begun"] for entry in unit.entries if entry.session.path.name in of]
        if model.channels and all(dated.model != model for dated in unit.models):
            with suppress(ValueError):  # it has no date
                if not data:
                    data = [round(datetime.fromisoformat(model.created).timestamp() * 1e9)]
                unit.models.append(Dated(model, max(data)))
    for unit in units.values():
        unit.models.sort(key=lambda dated: dated.time_ns)
    return sorted(units.values(), key=lambda unit: unit.name)
