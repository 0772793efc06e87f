"""imumon as a library: live samples of a port, recordings as tables, stages of one's own.

Everything here is what the command line is made of; the names that `import imumon` offers stay.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from queue import Empty, SimpleQueue
from types import TracebackType
from typing import Any, Self

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock, join, missing
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.pipeline import Estimator, Pipeline, PipelineCounters
from imumon.protocols.device import DeviceFile, device_text, parse_device
from imumon.recordings.conversions import CONVERTED, read_npz
from imumon.recordings.source import feed, open_source, run_over
from imumon.recordings.table import SUFFIXES, arrow_table, read_table, units_path
from imumon.run.live import BATCH_S, LiveRun, arrived, reader_of, warm_up
from imumon.run.setup import Setup, recorded_setup
from imumon.run.stages import pipeline_of
from imumon.transport.reader import Event, EventKind, Item
from imumon.transport.settings import PortSettings

_log = logging.getLogger("imumon")
LEVELS = {"WARN": logging.WARNING, "ERROR": logging.ERROR}


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples in memory, with the unit of every column.

    Parameters
    ----------
    block : SampleBlock
        The samples, n of them.
    columns : mapping of str to Column
        Unit, type and meaning of each column, in the order of a table.
    side : mapping of str to Samples
        The side streams of the device, such as a receiver, by name.
    """

    block: SampleBlock
    columns: Mapping[str, Column]
    side: Mapping[str, Samples] = field(default_factory=dict)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.block)

    def __getitem__(self, name: str) -> ColumnArray:
        """Return a column, shape (n,)."""
        return self.block[name]

    def __contains__(self, name: object) -> bool:
        """Tell whether there is a column of this name."""
        return name in self.block

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column."""
        return {name: column.unit for name, column in self.columns.items()}

    def to_arrow(self) -> Any:
        """Return a pyarrow table; missing values are null, unit and meaning stand in the fields' metadata."""
        return arrow_table(self.block, self.columns.values())

    def to_pandas(self) -> Any:
        """Return a pandas data frame; ``attrs["units"]`` has the units.  Needs pandas."""
        frame = self.to_arrow().to_pandas()
        frame.attrs["units"] = self.units
        return frame

    def to_polars(self) -> Any:
        """Return a polars data frame.  Needs polars."""
        import polars

        return polars.from_arrow(self.to_arrow())

    def to_xarray(self) -> Any:
        """Return an xarray dataset over the dimension ``sample``, units as attributes.  Needs xarray."""
        import xarray

        return xarray.Dataset(
            {
                name: ("sample", self.block[name], {"units": column.unit})
                for name, column in self.columns.items()
            }
        )


class Live:
    """Samples of a port with the estimates, as they come: iterate over it in a ``with`` statement.

    Iterating ends when `close` is called, from this thread or another; a lost port is reopened meanwhile.
    """

    def __init__(self, pipeline: Pipeline) -> None:
        self.pipeline = pipeline
        self.side: Mapping[str, SampleBlock] = {}
        """The rows of the side streams that belong to the latest block."""

    @property
    def counters(self) -> PipelineCounters:
        """What became of every byte and packet so far."""
        return self.pipeline.counters

    @property
    def units(self) -> dict[str, str]:
        """Unit of every column that may come."""
        return self.pipeline.units

    def close(self) -> None:
        """Close the port; what has come can still be iterated over."""
        raise NotImplementedError

    def __iter__(self) -> Iterator[SampleBlock]:
        """Yield the samples, a block about every 0.08 s while some come."""
        raise NotImplementedError

    def __enter__(self) -> Self:
        """Return itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, where: TracebackType | None
    ) -> None:
        """Close the port."""
        self.close()


class _Unrecorded(Live):
    """Reads in a thread, and decodes and estimates in the caller's."""

    def __init__(self, device: DeviceFile, settings: PortSettings, pipeline: Pipeline) -> None:
        super().__init__(pipeline)
        self._items: SimpleQueue[Item] = SimpleQueue()
        self._reader = reader_of(device, settings, lambda _: None, self._items.put)
        self._reader.start()

    def close(self) -> None:
        """Close the port; what has come can still be iterated over."""
        self._reader.stop()

    def __iter__(self) -> Iterator[SampleBlock]:
        """Yield the samples, a block about every 0.08 s while some come."""
        closed = False
        while not closed:
            closed = self._feed_batch()
            if closed:
                self.pipeline.finish()
            block = self.pipeline.take()
            self.side = self.pipeline.side
            for text in self.pipeline.warnings():
                _log.warning(text)
            if len(block) or self.side:
                yield block

    def _feed_batch(self) -> bool:
        """Feed what comes within the time of a batch; return True after the last item."""
        for item in arrived(self._items):
            feed(item, self.pipeline)
            if isinstance(item, Event):
                _log.info("%s: %s", item.kind.value, item.detail)
                if item.kind is EventKind.CLOSED:
                    self._items.put(item)  # whoever iterates again gets the end, too
                    return True
        return False


class _Recorded(Live):
    """Records, decodes and estimates in threads of its own, and hands the samples on."""

    def __init__(self, run: LiveRun) -> None:
        super().__init__(run.pipeline)
        self._run, self._stopped = run, False
        self._ready: SimpleQueue[tuple[SampleBlock, Mapping[str, SampleBlock]]] = SimpleQueue()
        run.taken = lambda block, side: self._ready.put((block, side))
        run.open()
        run.begin([])

    @property
    def session(self) -> Path:
        """Where the recording is."""
        return self._run.session.path

    def close(self) -> None:
        """Close port and recording; what has come can still be iterated over."""
        if not self._stopped:
            self._stopped = True
            self._run.stop()

    def __iter__(self) -> Iterator[SampleBlock]:
        """Yield the samples, a block about every 0.08 s while some come."""
        while not self._ready.empty() or self._run.processing:
            try:
                block, self.side = self._ready.get(timeout=BATCH_S)
            except Empty:
                continue
            if len(block) or self.side:
                yield block
        if self._run.failure is not None:
            raise self._run.failure


def open(
    port: str,
    device: str,
    *,
    baudrate: int | None = None,
    record: str | Path | None = None,
    setup: Setup | None = None,
    stages: Sequence[Estimator] = (),
) -> Live:
    """Open a port and return its samples with the estimates, as they come.

    Parameters
    ----------
    port : str
        Anything that pyserial opens: a device, ``socket://host:port``, ``rfc2217://host:port``.
    device : str
        Name of a known device, or path of a device file.
    baudrate : int, optional
        The first of the device file when not given.
    record : path, optional
        Session folder to make; nothing is recorded without.
    setup : Setup, optional
        Place, model and parameters of the estimators.
    stages : sequence of Estimator, optional
        Stages of one's own, behind the others, in their order.

    Raises
    ------
    ImumonError
        When the device file is wrong, the port cannot be opened, or the folder holds a session.
    """
    text, source = device_text(device)
    known, setup = parse_device(text, source), setup or Setup()
    settings = known.port_settings(port, baudrate)
    warm_up(known, setup)
    if record is None:
        return _Unrecorded(known, settings, pipeline_of(known, setup, stages))
    run = LiveRun(known, text, settings, setup, Path(record), _logged, stages)
    return _Recorded(run)


def read(
    path: str | Path,
    device: str | None = None,
    *,
    setup: Setup | None = None,
    estimates: bool = True,
    stages: Sequence[Estimator] = (),
) -> Samples:
    """Read a session, a raw capture or a table into memory.

    Parameters
    ----------
    path : path
        Session folder, capture, or table (``.parquet``, ``.csv``, ``.npz``) with the columns of imumon.
    device : str, optional
        What sent a raw capture.
    setup : Setup, optional
        Place, model and parameters of the estimators; as the session was recorded when not given.
    estimates : bool
        Whether the estimators run over a session or capture; a table is read as it is.
    stages : sequence of Estimator, optional
        Stages of one's own, behind the others.

    Raises
    ------
    ImumonError
        When it cannot be read, or holds nothing that can be decoded.
    """
    path = Path(path)
    if device is None and path.is_file() and path.suffix in (*SUFFIXES, *CONVERTED):
        return _table(path)
    source = open_source(path, device)
    if setup is None and source.session is not None:
        setup = recorded_setup(source.session)
    pipeline = pipeline_of(source, setup, stages, (object,) if estimates else ())
    blocks, aside = [], dict[str, list[SampleBlock]]()
    for block in run_over(source.items, pipeline):
        blocks.append(block)
        for stream, rows in pipeline.side.items():
            aside.setdefault(stream, []).append(rows)
    for text in [*source.warnings(), *pipeline.warnings()]:
        _log.warning(text)
    side = {stream: _samples(rows, pipeline.stream_columns(stream)) for stream, rows in aside.items()}
    return _samples(blocks, source.columns(pipeline), side)


def _table(path: Path) -> Samples:
    if path.suffix in SUFFIXES:
        block, columns = read_table(path)
    elif path.suffix == ".npz":
        block, columns = read_npz(path)
    else:
        raise ImumonError(
            Reason.BAD_DATA,
            f"{path}: of tables read takes {', '.join(SUFFIXES)} and .npz, not {path.suffix}",
            "export the session to one of these, or read the session; a raw capture needs device=",
        )
    if path.suffix == ".csv" and not units_path(path).is_file():
        _log.warning("%s: without %s known names have the units of imumon", path, units_path(path).name)
    if unknown := [name for name, column in columns.items() if not column.unit]:
        _log.warning(
            "%s: nothing says the unit of %s; imumon import takes tables from elsewhere",
            path,
            ", ".join(unknown),
        )
    return Samples(block, columns)


def _samples(
    blocks: Sequence[SampleBlock], columns: Sequence[Column], side: Mapping[str, Samples] | None = None
) -> Samples:
    whole = join(blocks) if blocks else SampleBlock({})
    there = {column.name: column for column in columns}
    for name in whole.columns:
        there.setdefault(name, Column(name, ""))
    complete = {
        name: whole[name] if name in whole else missing(len(whole), np.dtype(column.dtype))
        for name, column in there.items()
    }
    return Samples(SampleBlock(complete), there, side or {})


def _logged(level: str, text: str) -> None:
    _log.log(LEVELS.get(level, logging.INFO), text)
