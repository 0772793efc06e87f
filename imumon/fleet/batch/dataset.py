"""The results of a batch: Parquet files in a folder, which together have each session once."""

import fcntl
import os
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from pydantic import Field

from imumon.config import StrictModel, dump_yaml, load_yaml
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.files import TRUTH, replacing, write_text
from imumon.models.curves.polynomial import CUBIC
from imumon.recordings.source import RECORDING

ROWS = "rows"
WRITE_S = 60.0
"""What has been computed is written so often: whoever kills a batch loses at most that."""
LATE_S = 3600.0
"""So long before its rows were written a session may have been read."""

Row = Mapping[str, Any]
"""Of a session and a channel: the columns of `schema_of` that it has."""


class BatchOptions(StrictModel):
    """A command and its options, the same for all sessions; kept in the folder of the results.

    decode and replay may write `tables` of the samples of each session; replay takes a pipeline file instead
    of what a session was recorded with, calibrate a place, with which the earth rate is removed, diagnose the
    bias model that is assumed.
    """

    format: Literal["imumon-batch/1"] = "imumon-batch/1"
    command: Literal["decode", "replay", "calibrate", "allan", "diagnose"]
    tables: bool = False
    pipeline_yaml: str | None = None
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    heading_deg: float | None = Field(default=None, ge=-360, le=360)
    declared: str = CUBIC


_SAMPLES = ("samples", "mean", "sd", "least", "greatest", "duration_s", "lost", "file")
_NOISE = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization", "rate_ramp",
    "correlated_noise", "correlation_time")  # fmt: skip
RESULTS: dict[str, tuple[str, ...]] = {
    "decode": _SAMPLES,
    "replay": (*_SAMPLES, "identical_to_live"),
    "allan": (*(name for term in _NOISE for name in (term, f"{term}_sd")), "lowest", "lowest_tau_s",
        "longest_tau_s", "rate_hz", "duration_s"),
    "calibrate": ("curve", "residual_sd", "held_out_rms", "fit_rms", "lag_rms", "rest_s", "lowest_degc",
        "highest_degc", "file"),
    "diagnose": ("effects", "unexplained", "explained_share", "noise_floor_rms", "train_rms_before",
        "train_rms_after", "test_rms_before", "test_rms_after", "summary", "file"),
}  # fmt: skip
"""Columns of what each command reports of a channel, in SI units."""
_WHAT, _WHY = ("session", "device", "serial", "begun", "channel", "unit"), ("warnings", "reason", "error")
_TYPES: dict[str, pa.DataType] = {
    **dict.fromkeys((*_WHAT, *_WHY, "curve", "summary", "file"), pa.string()),
    **dict.fromkeys(("warnings", "effects"), pa.list_(pa.string())),
    **dict.fromkeys(("samples", "lost"), pa.int64()),
    **dict.fromkeys(("identical_to_live", "unexplained"), pa.bool_()),
    "begun": pa.timestamp("ns", "UTC"),
}
"""Of the columns that are not float64."""


def schema_of(command: str) -> pa.Schema:
    """Return the columns of the table of a command."""
    names = (*_WHAT, *RESULTS[command], *_WHY)
    return pa.schema([(name, _TYPES.get(name, pa.float64())) for name in names])


def lacking(row: Row) -> list[str]:
    """Return what the recording of a row lacks, one sentence each."""
    return [text for text in row.get("warnings") or () if RECORDING in text]


def _is_left(row: Row | None, begun: int | None, retry: bool) -> bool:
    """Return whether a session with this row is to be done; the row may be of another at its place."""
    if row is None or begun not in (None, row["begun"]):
        return True
    files = (Path(row["session"]) / name for name in TRUTH)
    changed = (path.stat().st_mtime for path in files if path.is_file())
    is_changed = lacking(row) and max(changed, default=0.0) > row["written"] - LATE_S
    return bool(is_changed or (retry and row["reason"]))


def _read(part: Path, **chosen: Any) -> pa.Table:
    """Return rows of a file; raises BAD_DATA when it is damaged."""
    try:
        return pq.read_table(part, **chosen)
    except (pa.ArrowException, OSError) as error:
        raise bad_data(f"{part} is damaged", "remove it: its sessions are done again") from error


def _are_of(sessions: Collection[str]) -> pc.Expression:
    return pc.field("session").isin(pa.array(sessions, pa.string()))


def _listed(table: pa.Table) -> list[dict[str, Any]]:
    """Return rows with `begun` as Unix time, ns."""
    at = table.schema.get_field_index("begun")
    rows: list[dict[str, Any]] = table.set_column(at, "begun", table["begun"].cast(pa.int64())).to_pylist()
    return rows


class Dataset:
    """The results so far, to which one program at a time adds.

    A file appears under its name when it is complete and on the medium, and never changes; it has all rows
    of its sessions.

    Raises EXISTS when the folder was begun with other options; BUSY when another program adds to it;
    BAD_CONFIG when it cannot be made.
    """

    def __init__(self, folder: Path, options: BatchOptions) -> None:
        self.folder = folder
        self._schema = schema_of(options.command)
        self._written = time.monotonic()
        try:
            (folder / ROWS).mkdir(parents=True, exist_ok=True)
            self._lock = (folder / ".lock").open("w")
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._lock.close()
            raise ImumonError(
                Reason.BUSY, f"another batch adds to {folder} now", "wait for its end"
            ) from error
        except OSError as error:
            raise bad_config(f"{folder}: cannot be made: {error.strerror}") from error
        try:
            path = folder / "batch.yaml"
            if not path.exists():
                write_text(path, dump_yaml(options.model_dump()))
            elif load_yaml(path, BatchOptions) != options:
                raise ImumonError(
                    Reason.EXISTS,
                    f"{folder} holds a batch with other settings ({path.name})",
                    "nothing was overwritten; give another folder, or the same command and options",
                )
        except (ImumonError, OSError):
            self._lock.close()
            raise
        last = int(self.parts[-1].stem.rpartition("-")[2]) if self.parts else 0
        self._next: tuple[int, list[Row]] = last + 1, []
        """Number and rows of the next file; both change at once, or Ctrl-C would have rows written twice."""

    @property
    def parts(self) -> list[Path]:
        """The files, in the order in which they were written."""
        return sorted((self.folder / ROWS).glob("*.parquet"))

    def done(self) -> dict[str, Row]:
        """Return the sessions that are in the table: when they began (Unix time, ns) and their rows were
        written (s), warnings, and reason and error of a failure.
        """
        return {
            row["session"]: {**row, "written": part.stat().st_mtime}
            for part in self.parts
            for row in _listed(_read(part, columns=["session", "begun", *_WHY]))
        }

    def rows(self, sessions: Collection[str]) -> dict[str, list[Row]]:
        """Return all rows of these sessions, by session; `begun` is Unix time, ns."""
        found: dict[str, list[Row]] = {session: [] for session in sessions}
        for part in self.parts:
            for row in _listed(_read(part, filters=_are_of(sessions))):
                found[row["session"]].append(row)
        return found

    def left(self, sessions: Mapping[str, int | None], retry: bool) -> list[str]:
        """Return which of these sessions are to be done, and take out what is known of them.

        They are new, or lacked something and have changed since, or have failed, with `retry`, or are others
        by when they began: Unix time, ns; None where that is not known.
        """
        done = self.done()
        left = [session for session, begun in sessions.items() if _is_left(done.get(session), begun, retry)]
        for part in self.parts if done.keys() & left else ():
            table = _read(part)
            others = table.filter(~_are_of(left))
            if len(others) < len(table):
                self._put(part, others)
        return left

    def add(self, rows: Sequence[Row]) -> None:
        """Add all rows of a session; they are on the medium after some time, or after `write`."""
        self._next[1].extend(rows)
        if time.monotonic() - self._written >= WRITE_S:
            self.write()

    def write(self) -> None:
        """Write what was added."""
        self._written = time.monotonic()
        number, rows = self._next
        if rows:
            table = pa.Table.from_pylist(rows, self._schema)
            self._put(self.folder / ROWS / f"part-{number:06}.parquet", table)
            self._next = number + 1, []

    def close(self) -> None:
        """Write what was added, and let others add."""
        try:
            self.write()
        finally:
            self._lock.close()

    def _put(self, path: Path, table: pa.Table) -> None:
        """Write a file of rows; one that replaces another keeps the time at which its rows were written."""
        written_ns = path.stat().st_mtime_ns if path.exists() else None
        with replacing(path) as partial:
            pq.write_table(table, partial, compression="zstd")
        if written_ns is not None:
            os.utime(path, ns=(written_ns, written_ns))
