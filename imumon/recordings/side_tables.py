"""Tables of a run: the main stream in the file that was asked for, each side stream in one beside it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from imumon.blocks import SampleBlock
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.files import check_output, naming, target
from imumon.protocols.base import MAIN
from imumon.recordings.conversions import CONVERTED, convert
from imumon.recordings.table import CLOCKS, TableWriter

if TYPE_CHECKING:
    from imumon.pipeline import Pipeline
    from imumon.recordings.source import Source


@dataclass(frozen=True, slots=True)
class Exported:
    """What was written."""

    rows: int
    """Of the main stream."""
    tables: dict[str, Path]
    """Of each stream that has rows."""
    left_out: list[str] = field(default_factory=list)
    """What the format has no place for."""

    def as_dict(self) -> dict[str, Any]:
        """Return it as ``--json`` has it."""
        return {"out": self.tables.get(MAIN), "rows": self.rows, "tables": self.tables}

    @property
    def warnings(self) -> list[str]:
        """What is to be said of it."""
        return [f"not written: {text}" for text in self.left_out]


def side_path(out: Path, stream: str) -> Path:
    """Return where the table of a side stream goes: NAME.gnss.parquet beside NAME.parquet."""
    return out.with_name(f"{out.stem}.{stream}{out.suffix}")


def export_run(
    blocks: Iterable[SampleBlock],
    pipeline: Pipeline,
    source: Source,
    out: Path,
    columns: Sequence[str] | None,
) -> Exported:
    """Write what a run yields, in the format that the suffix of `out` says.

    A run with rows in side streams only has their tables.

    Raises BAD_CONFIG when a column that was chosen is not there, naming those that are, or the format has no
    place for any of it; BAD_DATA when there is no sample; OSError when the disk is full or fails; a file that
    was there before is untouched.

    `blocks`: the run over `source`, which goes through `pipeline`.
    `columns`: columns of the main table, and no others are written; None for all, and all side streams.
    """
    if out.suffix not in CONVERTED:
        return _tables(blocks, pipeline, source, out, columns)
    check_output(out, replace=True)
    with naming(out), TemporaryDirectory(prefix=".imumon-", dir=target(out).parent) as folder:
        table = Path(folder) / f"{out.stem}.parquet"
        also = CLOCKS if out.suffix == ".mcap" else ()
        made = _tables(blocks, pipeline, source, table, columns, also)
        names = {stream: out if stream == MAIN else side_path(out, stream) for stream in made.tables}
        written = {stream: Path(folder) / path.name for stream, path in names.items()}
        files, left_out = convert(made.tables, written, source.axes)
        for path in dict.fromkeys(files.values()):
            path.replace(target(out.with_name(path.name)))
    return Exported(made.rows, {stream: out.with_name(path.name) for stream, path in files.items()}, left_out)


def _tables(
    blocks: Iterable[SampleBlock],
    pipeline: Pipeline,
    source: Source,
    out: Path,
    columns: Sequence[str] | None,
    also: Sequence[str] = (),
) -> Exported:
    """Write the tables; `also` are columns that come before those that were chosen, where they are there."""
    main, written, there = TableWriter(out, {}), dict[str, TableWriter](), dict[str, None]()
    with ExitStack() as stack:
        for block in blocks:
            for stream, rows in {**(pipeline.side if columns is None else {}), MAIN: block}.items():
                if not len(rows):
                    continue
                known = source.columns(pipeline) if stream == MAIN else pipeline.stream_columns(stream)
                if stream == MAIN:
                    there |= dict.fromkeys(rows.columns)
                    rows, known = _chosen(rows, known, None if columns is None else [*also, *columns])
                if stream not in written:
                    writer = main if stream == MAIN else TableWriter(side_path(out, stream), {})
                    written[stream] = stack.enter_context(writer)
                written[stream].announce(known)
                written[stream].write(rows)
        absent = [name for name in columns or () if name not in there]
        if absent and there:
            seen = f"no column {', '.join(absent)} in these samples"
            raise ImumonError(Reason.BAD_CONFIG, seen, f"there are: {', '.join(there)}")
        if not written:
            raise ImumonError(Reason.BAD_DATA, "there are no samples, so there is no table to write")
    order = sorted(written, key=lambda stream: stream != MAIN)
    return Exported(main.rows, {stream: written[stream].path for stream in order})


def _chosen(
    rows: SampleBlock, known: list[Column], wanted: Sequence[str] | None
) -> tuple[SampleBlock, list[Column]]:
    """Return the columns of rows that are wanted, and what may come of them, in the order of the table."""
    if wanted is None:
        return rows, known
    of = {column.name: column for column in known}
    names = dict.fromkeys(wanted)
    return SampleBlock({n: rows[n] for n in names if n in rows}), [of[n] for n in names if n in of]
