"""Tables of a run: the main stream in the file that was asked for, each side stream in one beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.files import check_output, naming, target
from imumon.protocols.base import MAIN
from imumon.recordings.conversions import CONVERTED, convert
from imumon.recordings.table import CLOCKS, TableWriter, export_blocks

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

    Raises ImumonError as `imumon.recordings.table.export_blocks`; a run with rows in side streams only has
    their tables. BAD_CONFIG when the format has no place for any of it; OSError when the disk is full or
    fails; a file that was there before is untouched.

    Parameters
    ----------
    blocks : iterable of SampleBlock
        The run over `source`, which goes through `pipeline`.
    columns : sequence of str, or None
        Columns of the main table, and no others are written; None for all, and all side streams.
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
    writers: dict[str, TableWriter] = {}
    with ExitStack() as stack:
        if columns is None:
            blocks = _with_side_rows(blocks, pipeline, out, writers, stack)
        try:
            rows = export_blocks(blocks, out, columns, lambda: source.columns(pipeline), also)
        except ImumonError as error:
            if error.reason is not Reason.BAD_DATA or pipeline.counters.samples or not writers:
                raise
            rows = 0
    tables = {stream: writer.path for stream, writer in writers.items()}
    return Exported(rows, {MAIN: out, **tables} if rows else tables)


def _with_side_rows(
    blocks: Iterable[SampleBlock],
    pipeline: Pipeline,
    out: Path,
    writers: dict[str, TableWriter],
    stack: ExitStack,
) -> Iterator[SampleBlock]:
    """Yield the blocks of a run; write the rows of the side streams that came with each."""
    for block in blocks:
        for stream, rows in pipeline.side.items():
            if stream not in writers:
                writers[stream] = stack.enter_context(TableWriter(side_path(out, stream), {}))
            writers[stream].announce(pipeline.stream_columns(stream))
            writers[stream].write(rows)
        yield block
