"""Rows of columns with their times, as Rerun takes them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
import rerun as rr

from imumon.blocks import BoolArray, ColumnArray, FloatArray, IntArray

from .items import Instant, Times, first_of_steps


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows of columns with their times.

    With `step_ns` they are for a recording or a page, which is a picture (the wire has every byte): of each
    step of time only the extremes are drawn, so that spikes stay.  What began before them, at `before_ns`,
    the clock of the row before, has been drawn.
    """

    columns: Mapping[str, ColumnArray]
    times: Times
    step_ns: int = 0
    before_ns: int | None = None
    stream: str = ""  # name of the side stream that they are of; empty for the main one

    @cached_property
    def indexes(self) -> list[rr.TimeColumn]:
        """The time columns of all rows, as Rerun wants them."""
        columns, (sample, device_ns, host_ns) = [], self.times
        if sample is not None:
            columns.append(rr.TimeColumn("sample", sequence=sample))
        if device_ns is not None:
            columns.append(rr.TimeColumn("device_time", duration=device_ns.view("timedelta64[ns]")))
        if host_ns is not None:
            columns.append(rr.TimeColumn("host_time", timestamp=host_ns.view("datetime64[ns]")))
        return columns

    @property
    def clock(self) -> IntArray | None:
        """Device time, or host time where there is none, ns."""
        return self.times.host_ns if self.times.device_ns is None else self.times.device_ns

    def kept(self, keep: BoolArray | IntArray) -> "Rows":
        """Return the times of the rows to keep, without their columns."""
        return Rows({}, self.times.kept(keep))

    def send(self, rec: rr.RecordingStream, entity: str, values: FloatArray) -> None:
        """Log values at the times of these rows, (n,) or (n, lines)."""
        rec.send_columns(entity, indexes=self.indexes, columns=rr.Scalars.columns(scalars=values))

    def extremes(self, values: FloatArray) -> BoolArray:
        """Return which rows have the least or greatest value of a line in its step, or begin one, (n,)."""
        if not self.step_ns or self.clock is None:
            return np.ones(len(values), np.bool_)
        keep = self.thinned(self.step_ns)
        for start, stop in pairwise([0, *(np.flatnonzero(keep[1:]) + 1).tolist(), len(values)]):
            part = values[start:stop]
            keep[start + np.argmin(np.nan_to_num(part, nan=np.inf), axis=0)] = True
            keep[start + np.argmax(np.nan_to_num(part, nan=-np.inf), axis=0)] = True
        return keep

    def thinned(self, step_ns: int) -> BoolArray:
        """Return which rows are the first in a step of time, shape (n,): all when there is no clock."""
        clock = self.clock
        if clock is None:
            return np.ones(len(next(iter(self.columns.values()))), np.bool_)
        return first_of_steps(clock, max(step_ns, self.step_ns), self.before_ns)

    def matrix(self, names: Sequence[str]) -> FloatArray:
        """Return the named columns side by side, shape (n, len(names))."""
        return np.column_stack([self.columns[name] for name in names]).astype(np.float64, copy=False)


def at_instants(*instants: Instant) -> Rows:
    """Return the times of moments that know the same timelines, a row each, without columns."""
    columns = zip(*instants, strict=True)
    return Rows({}, Times(*(None if part[0] is None else np.array(part, np.int64) for part in columns)))


def log_markdown(rec: rr.RecordingStream, entity: str, texts: Sequence[str], times: Rows) -> None:
    """Log a text as it is from each moment on."""
    text = rr.TextDocument.columns(text=texts, media_type=["text/markdown"] * len(texts))
    rec.send_columns(entity, indexes=times.indexes, columns=text)
