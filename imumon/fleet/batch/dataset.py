"""The results of a batch: Parquet files in a folder, which together have each session once."""

import fcntl
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field

from imumon.config import StrictModel, dump_yaml, load_yaml
from imumon.errors import ImumonError, Reason, bad_config
from imumon.files import replacing, write_text
from imumon.models.curves.polynomial import CUBIC
from imumon.recordings.source import RECORDING

ROWS, SETTINGS_NAME, LOCK_NAME = "rows", "batch.yaml", ".lock"
WRITE_S = 60.0
"""What has been computed is written so often: whoever kills a batch loses at most that."""

Row = Mapping[str, Any]
"""Of a session and a channel: the columns of `schema_of` that it has."""


class BatchOptions(StrictModel):
    """A command and its options, the same for all sessions; kept in the folder of the results."""

    format: Literal["imumon-batch/1"] = "imumon-batch/1"
    command: Literal["decode", "replay", "calibrate", "allan", "diagnose"]
    tables: bool = False
    """Whether decode and replay write the samples of every session as well."""
    pipeline_yaml: str | None = None
    """For replay, instead of what a session was recorded with."""
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    heading_deg: float | None = Field(default=None, ge=-360, le=360)
    """For calibrate: with which the earth rate is removed."""
    declared: str = CUBIC
    """For diagnose: the bias model that is assumed."""


_SAMPLES = ("samples", "mean", "sd", "least", "greatest", "duration_s", "lost", "file")
_NOISE = ("angle_random_walk", "bias_instability", "rate_random_walk", "quantization", "rate_ramp",
    "correlated_noise", "correlation_time")  # fmt: skip
RESULTS: dict[str, tuple[str, ...]] = {
    "decode": _SAMPLES,
    "replay": (*_SAMPLES, "identical_to_live"),
    "allan": (
        *(name for term in _NOISE for name in (term, f"{term}_sd")),
        *("lowest", "lowest_tau_s", "longest_tau_s", "rate_hz", "duration_s"),
    ),
    "calibrate": (
        *("curve", "residual_sd", "held_out_rms", "fit_rms", "lag_rms", "rest_s"),
        *("lowest_degc", "highest_degc", "file"),
    ),
    "diagnose": (
        *("effects", "unexplained", "explained_share", "noise_floor_rms"),
        *("train_rms_before", "train_rms_after", "test_rms_before", "test_rms_after", "summary", "file"),
    ),
}
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
        self._waiting: list[Row] = []
        self._written = time.monotonic()
        try:
            (folder / ROWS).mkdir(parents=True, exist_ok=True)
            self._lock = (folder / LOCK_NAME).open("w")
            fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._lock.close()
            raise ImumonError(
                Reason.BUSY, f"another batch adds to {folder} now", "wait for its end"
            ) from error
        except OSError as error:
            raise bad_config(f"{folder}: cannot be made: {error.strerror}") from error
        try:
            path = folder / SETTINGS_NAME
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
        for partial in (folder / ROWS).glob("*.partial"):
            partial.unlink()

    @property
    def parts(self) -> list[Path]:
        """The files, in the order in which they were written."""
        return sorted((self.folder / ROWS).glob("*.parquet"))

    def done(self) -> dict[str, Row]:
        """Return the sessions that are in the table: warnings, and reason and error of a failure."""
        tables = [pq.read_table(part, columns=["session", *_WHY]) for part in self.parts]
        return {row["session"]: row for table in tables for row in table.to_pylist()}

    def rows(self, sessions: Sequence[str]) -> dict[str, list[Row]]:
        """Return all rows of these sessions, by session."""
        found: dict[str, list[Row]] = {}
        for part in self.parts:
            for row in pq.read_table(part, filters=[("session", "in", sessions)]).to_pylist():
                found.setdefault(row["session"], []).append(row)
        return found

    def forget_failures(self) -> None:
        """Take out what failed, so that it is done again."""
        for part in self.parts:
            table = pq.read_table(part)
            good = table.filter(table["reason"].is_null())
            if len(good) < len(table):
                self._put(part, good)

    def add(self, rows: Sequence[Row]) -> None:
        """Add all rows of a session; they are on the medium after some time, or after `write`."""
        self._waiting += rows
        if time.monotonic() - self._written >= WRITE_S:
            self.write()

    def write(self) -> None:
        """Write what was added."""
        self._written = time.monotonic()
        if self._waiting:
            last = int(self.parts[-1].stem.rpartition("-")[2]) if self.parts else 0
            table = pa.Table.from_pylist(self._waiting, self._schema)
            self._put(self.folder / ROWS / f"part-{last + 1:06}.parquet", table)
            self._waiting = []

    def close(self) -> None:
        """Write what was added, and let others add."""
        try:
            self.write()
        finally:
            self._lock.close()

    def _put(self, path: Path, table: pa.Table) -> None:
        with replacing(path) as partial:
            pq.write_table(table, partial, compression="zstd")
