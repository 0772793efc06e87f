"""Tables of a run: the main stream in the file that was asked for, each side stream in one beside it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING

from imumon.blocks import SampleBlock
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import MAIN
from imumon.recordings.table import TableWriter, export_blocks

if TYPE_CHECKING:
    from collections.abc import Callable

    from imumon.pipeline import Pipeline


def side_path(out: Path, stream: str) -> Path:
    """Return where the table of a side stream goes: NAME.gnss.parquet beside NAME.parquet."""
    return out.with_name(f"{out.stem}.{stream}{out.suffix}")


def export_run(
    blocks: Iterable[SampleBlock],
    pipeline: Pipeline,
    out: Path,
    columns: Sequence[str] | None,
    known: Callable[[], Iterable[Column]],
) -> tuple[int, dict[str, Path]]:
    """Write what a run yields; return the rows of the main table, and the table of each stream.

    Parameters
    ----------
    blocks : iterable of SampleBlock
        The run, which goes through `pipeline`.
    columns : sequence of str, or None
        Columns of the main table, and no others are written; None for all, and all side streams.
    known : callable
        As for `imumon.recordings.table.export_blocks`.

    Raises
    ------
    ImumonError
        As `imumon.recordings.table.export_blocks`; a run with rows in side streams only has their tables.
    """
    writers: dict[str, TableWriter] = {}
    with ExitStack() as stack:

        def passing() -> Iterator[SampleBlock]:
            for block in blocks:
                for stream, rows in pipeline.side.items() if columns is None else ():
                    if stream not in writers:
                        writers[stream] = stack.enter_context(TableWriter(side_path(out, stream), {}))
                    writers[stream].announce(pipeline.stream_columns(stream))
                    writers[stream].write(rows)
                yield block

        try:
            rows = export_blocks(passing(), out, columns, known)
        except ImumonError as error:
            if error.reason is not Reason.BAD_DATA or pipeline.counters.samples or not writers:
                raise
            rows = 0
    tables = {stream: writer.path for stream, writer in writers.items()}
    return rows, {MAIN: out, **tables} if rows else tables
