"""Sessions, raw captures and tables, read whole or block by block."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, InstanceOf, SkipValidation

from imumon.blocks import NO_INT, BoolArray, SampleBlock, missing
from imumon.columns import KNOWN, TIME_COLUMNS, Column
from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.heap import trim_heap
from imumon.pipeline import Estimator, Pipeline
from imumon.protocols.base import MAIN
from imumon.recordings.exports import CONVERTED, read_npz
from imumon.recordings.source import Source, no_samples, open_source, run_over
from imumon.recordings.table import SUFFIXES, iterate_table, read_columns, units_path
from imumon.run.setup import Setup, recorded_setup
from imumon.run.stages import pipeline_of

from . import checked
from .samples import TIMES, Samples

_log = logging.getLogger("imumon")
LARGE_BYTES = 1 << 20
"""Of a column, from which on memory is worth the time that it takes to give it back."""
Seconds = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Stages = Sequence[SkipValidation[Estimator]]


@checked
def read(
    path: str | Path,
    device: str | Path | None = None,
    *,
    setup: InstanceOf[Setup] | None = None,
    estimates: bool = True,
    stages: Stages = (),
    columns: Sequence[str] | None = None,
    begin_s: Seconds | None = None,
    end_s: Seconds | None = None,
) -> Samples:
    """Read a session, a raw capture or a table into memory.

    Raises NOT_FOUND when there is no such file; BAD_DATA when it cannot be read, or holds nothing that can be
    decoded; BAD_CONFIG for a wrong argument, or a column that is not there.

    Parameters
    ----------
    path : path
        Session folder, capture, or table (``.parquet``, ``.csv``, ``.npz``) with the columns of imumon.
    device : str or path, optional
        What sent a raw capture: a known device, or a device file.
    setup : Setup, optional
        Place, model and parameters of the estimators; as the session was recorded when not given.  Refused
        for a table.
    estimates : bool
        Whether the estimators run over a session or capture; they never run over a table.
    stages : sequence of Estimator, optional
        Stages of one's own, behind the others.
    columns : sequence of str, optional
        Only these columns, in this order, and no side streams.  The estimators run only if one is theirs.
    begin_s, end_s : float, optional
        Only rows from `begin_s` on and before `end_s`, in seconds since the first row, by host time, or by
        device time where no host time is known.
    """
    run = _Run(path, device, setup, estimates, stages, columns, begin_s, end_s)
    blocks, aside = list[SampleBlock](), dict[str, list[SampleBlock]]()
    for block, side in run.blocks():
        blocks.append(block)
        for stream, rows in side.items():
            aside.setdefault(stream, []).append(rows)
    whole = _joined(blocks)
    if columns is not None and (absent := [name for name in columns if name not in whole]) and len(whole):
        raise run.absent(absent, whole.columns)
    return run.samples(whole, {stream: _joined(rows) for stream, rows in aside.items()})


@checked
def read_blocks(
    path: str | Path,
    device: str | Path | None = None,
    *,
    setup: InstanceOf[Setup] | None = None,
    estimates: bool = True,
    stages: Stages = (),
    columns: Sequence[str] | None = None,
    begin_s: Seconds | None = None,
    end_s: Seconds | None = None,
) -> Iterator[Samples]:
    """Yield what `read` would return block by block, for recordings larger than memory.

    Blocks have some thousands of rows.  A column that begins late is absent from the blocks before, unless
    `columns` names it.  Parameters and errors are those of `read`.
    """
    run = _Run(path, device, setup, estimates, stages, columns, begin_s, end_s)
    return (run.samples(block, side) for block, side in run.blocks() if len(block) or side)


class _Run:
    """A recording on its way through a pipeline; parameters as those of `read`."""

    def __init__(
        self,
        path: str | Path,
        device: str | Path | None,
        setup: Setup | None,
        estimates: bool,
        stages: Sequence[Estimator],
        columns: Sequence[str] | None,
        begin_s: float | None,
        end_s: float | None,
    ) -> None:
        if begin_s is not None and end_s is not None and end_s <= begin_s:
            raise bad_config(f"end_s={end_s!r}: expected more than begin_s={begin_s!r}")
        where = Path(path)
        self._columns = columns
        self._begin_s, self._end_s = begin_s or 0.0, np.inf if end_s is None else end_s
        self._clock, self._first_ns, self._segment = "", 0, 0
        """Column of the times since the first row; it goes on when the device starts anew."""
        self._over = False  # whether what comes is later than the span
        if not where.exists():
            raise ImumonError(Reason.NOT_FOUND, f"{where}: there is no such file", "check path and folder")
        if device is None and where.is_file() and where.suffix in (*SUFFIXES, *CONVERTED):
            self._source = _table(where, setup, None if stages else columns)
            self._pipeline = Pipeline(None, stages)
            return
        self._source = source = open_source(where, None if device is None else str(device))
        if setup is None and source.session is not None:
            setup = recorded_setup(source.session)
        possible = () if source.device is None else source.device.decoder().possible_columns
        sent = {*TIME_COLUMNS, *source.imported, *(column.name for column in possible)}
        needed = estimates and (bool(stages) or columns is None or not sent.issuperset(columns))
        self._pipeline = pipeline_of(source, setup, stages, (object,) if needed else ())

    def blocks(self) -> Iterator[tuple[SampleBlock, Mapping[str, SampleBlock]]]:
        """Yield the rows that are wanted, and those of side streams; log what is missing at the end."""
        for block in run_over(self._source.items, self._pipeline):
            block = self._within(block)
            side = {name: self._within(rows, side=True) for name, rows in self._pipeline.side.items()}
            yield self._chosen(block), {} if self._columns is not None else side
            if self._over:
                break
        else:  # what is missing from a recording is known at its end
            for text in self._source.warnings():
                _log.warning(text)
        for text in self._pipeline.warnings():
            _log.warning(text)
        if self._source.device is not None and not self._pipeline.counters.streams:
            raise no_samples(self._source, self._pipeline)

    def _within(self, block: SampleBlock, *, side: bool = False) -> SampleBlock:
        """Return the rows within the span of time, by host time where the first row has one."""
        whole = self._begin_s == 0.0 and self._end_s == np.inf
        if whole or not len(block) or (side and not self._clock):
            return block
        if not self._clock:
            self._clock = next((name for name in TIMES if name in block and block[name][0] != NO_INT), "")
            if not self._clock:
                raise bad_data(
                    "begin_s, end_s: the first row has neither host_time_ns nor device_time_ns",
                    "read it whole",
                )
            self._first_ns = int(block[self._clock][0])
            self._segment = int(block["segment"][0]) if "segment" in block else 0
        restarted = "segment" in block and (block["segment"] != self._segment).any()
        if restarted and self._clock == "device_time_ns":
            raise bad_data(
                "begin_s, end_s: the device restarted, and the recording has no times of arrival",
                "read the recording whole, and select by the columns segment and device_time_ns",
            )
        since_s = (block[self._clock] - self._first_ns) * 1e-9
        self._over = self._over or (not side and bool(since_s.min() >= self._end_s))
        wanted: BoolArray = (since_s >= self._begin_s) & (since_s < self._end_s)
        return block.kept(wanted)

    def _chosen(self, block: SampleBlock) -> SampleBlock:
        """Return the columns that are wanted.

        Raises BAD_CONFIG for one that can never come.
        """
        if self._columns is None:
            return block
        if not len(block):
            return SampleBlock({})
        known = {column.name: column for column in self._source.columns(self._pipeline)}
        possible = {*block.columns, *known, *self._pipeline.units}
        if unknown := [name for name in self._columns if name not in possible]:
            raise self.absent(unknown, known)
        return SampleBlock({name: block[name] for name in self._columns if name in block})

    def absent(self, names: Sequence[str], there: Mapping[str, object]) -> ImumonError:
        """Return the error for columns that the samples do not have."""
        return bad_config(
            f"columns: there is no {', '.join(names)} in {self._source.path}",
            f"there are: {', '.join(there)}",
        )

    def samples(self, block: SampleBlock, side: Mapping[str, SampleBlock], stream: str = MAIN) -> Samples:
        """Return a block with unit and meaning of its columns, in the order of a table."""
        known = {column.name: column for column in self._source.columns(self._pipeline, stream)}
        names = self._columns
        if names is None:
            came = (name for name in known if name in block or name in self._source.imported)
            names = [*came, *block.columns]
        columns = {name: known.get(name) or KNOWN.get(name) or Column(name, "") for name in names}
        complete = {
            name: block[name] if name in block else missing(len(block), column.dtype)
            for name, column in columns.items()
        }
        of_side = {name: self.samples(rows, {}, name) for name, rows in side.items()}
        return Samples(SampleBlock(complete), columns, of_side)


def _table(path: Path, setup: Setup | None, columns: Sequence[str] | None) -> Source:
    """Open a table, which needs no decoder.

    Raises BAD_DATA for a table that imumon cannot read; BAD_CONFIG when a setup is given.
    """
    if setup is not None:
        raise bad_config(
            f"setup: {path} is a table, and the estimators, which a setup is for, do not run over one",
            "leave setup out; imumon import makes a session of a table, and estimators run over that",
        )
    if path.suffix in SUFFIXES:
        there = read_columns(path)
        chosen = there if columns is None else [name for name in (*columns, *TIME_COLUMNS) if name in there]
        items = iterate_table(path, columns=list(dict.fromkeys(chosen)))
    elif path.suffix == ".npz":
        block, there = read_npz(path)
        items = iter([block])
    else:
        raise bad_data(
            f"{path}: of tables read takes {', '.join(SUFFIXES)} and .npz, not {path.suffix}",
            "export the session to one of these, or read the session; a raw capture needs device=",
        )
    if path.suffix == ".csv" and not units_path(path).is_file():
        _log.warning("%s: without %s known names have the units of imumon", path, units_path(path).name)
    if unknown := [name for name, column in there.items() if not column.unit]:
        _log.warning(
            "%s: the unit of %s is not stated; imumon import takes tables from elsewhere",
            path,
            ", ".join(unknown),
        )
    return Source(path, items, imported=there)


def _joined(blocks: list[SampleBlock]) -> SampleBlock:
    """Join blocks column by column, and give the parts of each back at once: else all is there twice.

    The list is emptied.
    """
    parts = [(len(block), dict(block.columns)) for block in blocks]
    blocks.clear()
    types = {name: values.dtype for _, part in parts for name, values in part.items()}
    columns = {}
    for name, dtype in types.items():
        columns[name] = np.concatenate(
            [part.pop(name) if name in part else missing(n, dtype) for n, part in parts]
        )
        if columns[name].nbytes > LARGE_BYTES:
            trim_heap()
    return SampleBlock(columns)
