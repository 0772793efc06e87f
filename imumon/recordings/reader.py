"""Read whole recordings, sessions and tables, as whoever computes from samples needs them.

What no estimate may be made from is left out, as it is for all stages; `imumon.recordings.source.run_over`
has the samples as they were sent, for tables.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imumon.blocks import SampleBlock
from imumon.columns import BodyAxes, Column
from imumon.errors import bad_data
from imumon.pipeline import Estimator, Pipeline
from imumon.protocols.device import DeviceFile
from imumon.recordings.folder import fingerprint, is_session, lost_metadata, open_session
from imumon.recordings.importing import TableImport
from imumon.recordings.source import Count, Source, no_count, open_source, run_over
from imumon.recordings.table import SUFFIXES, iterate_table, read_columns

Stages = Callable[[DeviceFile | None], Sequence[Estimator]]
"""Makes the stages for a device, or for a table when there is none."""


def no_stages(_: DeviceFile | None) -> Sequence[Estimator]:
    """Return no stages."""
    return ()


@dataclass(frozen=True, slots=True, eq=False)
class Recording:
    """A recording that is open; its samples can be read once."""

    source: Source
    """What is read."""
    pipeline: Pipeline
    """What it runs through."""
    count: Count
    """Takes how many more bytes were read."""
    truth: Path
    """The file that everything follows from."""
    name: str
    """Of its folder or file."""
    device: str | None
    """What sent it; None for a table."""
    axes: BodyAxes | None
    """In which body axes it is; None where it is not stated."""
    serial: str | None
    """Serial number of the unit, as its session has it."""
    columns: dict[str, Column]
    """Columns of a table or an imported session; empty for a recording that has to be decoded."""

    def blocks(self) -> Iterator[SampleBlock]:
        """Yield the samples in order, with device_time_ns, segment and what the stages add to them.

        What cannot be is missing, and so are rows whose time does not go on: `warnings` counts them.
        """
        blocks = list[SampleBlock]()
        self.pipeline.sink = blocks.append
        for _ in run_over(self.source.items, self.pipeline, self.count):
            yield from blocks
            blocks.clear()

    def warnings(self) -> list[str]:
        """Return, once the samples were read, what the recording lacks and what the stages report."""
        return [*self.source.warnings(), *self.pipeline.warnings()]

    def sha256(self) -> str:
        """Return the fingerprint of its bytes."""
        return fingerprint(self.truth)


def open_recording(
    path: Path, stages: Stages = no_stages, map_path: Path | None = None, count: Count = no_count
) -> Recording:
    """Open a session, live or imported, or a table: one that imumon wrote, or any with its map.

    Raises BAD_DATA when there is nothing to read, or something that is no recording; BAD_CONFIG for a wrong
    map.

    `path`: folder of a session or its session.yaml, or a table.
    `stages`: what the samples run through; a stage of which a table has a column already is left out.
    `map_path`: states what is in which column of a table from elsewhere.
    `count`: takes how many more bytes were read, for a progress bar.
    """
    source = _open(path, map_path)
    session, there = source.session, {column.name: column for column in source.imported}
    made = stages(source.device)
    wanted = [stage for stage in made if there.keys().isdisjoint(column.name for column in stage.columns)]
    return Recording(
        source, Pipeline(source.device, wanted, source.range), count,
        truth=source.path if session is None else session.truth_path,
        name=(path if session is None else session.path).name or str(path),
        device=None if source.device is None else source.device.name,
        axes=source.axes,
        serial=None if session is None else session.metadata.serial,
        columns=there,
    )  # fmt: skip


def _open(path: Path, map_path: Path | None) -> Source:
    if is_session(path) or not path.is_file():
        return open_source(path)
    if map_path is not None:
        table = TableImport(path, map_path)
        return Source(path, table.blocks(), None, None, tuple(table.columns.values()), table)
    if path.suffix not in SUFFIXES:
        if lost_metadata(path) is not None:
            open_session(path)  # raises, with what to do
        what = f"{path} is neither a session nor a table ({', '.join(SUFFIXES)})"
        hint = "a raw capture becomes a table first: imumon decode FILE --device NAME --out TABLE.parquet"
        raise bad_data(what, hint)
    columns = read_columns(path)
    if "device_time_ns" not in columns:
        seen = f"{path}: has no column device_time_ns, so it is no table of imumon"
        raise bad_data(seen, "a table from elsewhere needs a map: imumon import")
    # Without a column segment it is one segment.
    blocks = (
        block if "segment" in block else block.with_columns({"segment": np.zeros(len(block), np.int64)})
        for block in iterate_table(path)
    )
    return Source(path, blocks, None, None, tuple(columns.values()))
