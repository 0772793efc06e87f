"""A synthetic AHRS at 100 Hz, and the pieces that the view's tests share."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa
from rerun.chunk import RrdReader

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.view.items import Log, Numbers, State, Status, Timebase, ViewItem, merge
from imumon.view.logger import StreamLogger
from imumon.view.publisher import WEB_BATCH_S
from tests.waiting import LIMIT_S

RATE_HZ = 100
HOST_NS = 1_790_000_000_000_000_000
DEVICE_NS = 5_000_000_000

GYRO = ("gyro_x", "gyro_y", "gyro_z")
ACCEL = ("accel_x", "accel_y", "accel_z")
MAG = ("mag_x", "mag_y", "mag_z")
QUATERNION = ("q_w", "q_x", "q_y", "q_z")


def block(first: int, n: int, *, leave_out: tuple[str, ...] = ()) -> SampleBlock:
    """Samples first .. first + n of a body that sways and turns."""
    index = np.arange(first, first + n)
    t = index / RATE_HZ
    noise = np.random.default_rng(first).standard_normal((9, n))
    time_ns = (index * (1_000_000_000 // RATE_HZ)).astype(np.int64)
    half = 0.3 * np.sin(0.7 * t)
    columns: dict[str, ColumnArray] = {
        "device_time_ns": DEVICE_NS + time_ns,
        "host_time_ns": HOST_NS + time_ns,
        "segment": np.zeros(n, np.int64),
        "packet_counter": index.astype(np.int64),
    }
    for k, name in enumerate(GYRO):
        columns[name] = 0.3 * np.sin(0.9 * t + 2 * k) + 0.002 * noise[k]
    for k, name in enumerate(ACCEL):
        columns[name] = 9.81 * (k == 2) + 2.0 * np.sin(0.5 * t + k) + 0.02 * noise[3 + k]
    for k, name in enumerate(MAG):
        columns[name] = 20.0 * np.cos(0.4 * t + 2 * k) + 0.2 * noise[6 + k]
    columns["temperature"] = 31.0 + 0.01 * t
    for name, values in zip(QUATERNION, (np.cos(half), np.sin(half), 0 * t, 0 * t), strict=True):
        columns[name] = values
    return SampleBlock({name: values for name, values in columns.items() if not name.startswith(leave_out)})


class Stream:
    """What a running monitor publishes, as fast as asked."""

    def __init__(self, publish: Callable[[ViewItem], None], leave_out: tuple[str, ...] = ()) -> None:
        self._publish = publish
        self._leave_out = leave_out
        self._timebase = Timebase()
        self.sent = 0
        self.blocks: list[SampleBlock] = []
        at = self._timebase.at(HOST_NS - 100_000_000)
        publish(State(at, "port", "open"))
        publish(Log(at, "port opened"))

    def send(self, n: int) -> None:
        """Publish n samples, and once a second what goes with them."""
        samples = block(self.sent, n, leave_out=self._leave_out or ("nothing",))
        self.blocks.append(samples)
        self._publish(self._timebase.samples(samples))
        seconds = self.sent // RATE_HZ
        self.sent += n
        if self.sent // RATE_HZ > seconds or seconds == 0:
            at = self._timebase.at()
            numbers = {"packet_rate": 100.0, "link_load": 0.12, "packets_lost": 0.0, "packets_damaged": 0.0}
            self._publish(Numbers(at, numbers))
            self._publish(Status(at, {"Packets": str(self.sent), "Lost": "0"}))

    def run(self, seconds: float) -> None:
        """Publish in real time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.send(RATE_HZ // 20)
            time.sleep(0.05)

    def run_until(self, condition: Callable[[], bool], what: str) -> None:
        """Publish in real time until the condition holds; fail when it never does."""
        end = time.monotonic() + LIMIT_S
        while not condition():
            assert time.monotonic() < end, f"not within {LIMIT_S} s: {what}"
            self.run(0.1)

    def column(self, names: tuple[str, ...]) -> FloatArray:
        """Return what was sent, side by side, (sent, len(names))."""
        return np.concatenate([np.column_stack([part[name] for name in names]) for part in self.blocks])


def log_as_page(logger: StreamLogger, items: Sequence[ViewItem], seconds: float) -> None:
    """Log the items of so many seconds in the batches of a page."""
    size = round(len(items) * WEB_BATCH_S / seconds)
    for first in range(0, len(items), size):
        logger.log(merge(items[first : first + size]))


def record_batches(path: Path, entity: str) -> Iterator[pa.RecordBatch]:
    """Yield the rows of an entity in a recording."""
    for chunk in RrdReader(str(path)).stream().filter(content=[entity], has_timeline="sample"):
        yield chunk.to_record_batch()


def scalars(paths: list[Path], entity: str) -> tuple[IntArray, IntArray, IntArray, FloatArray]:
    """Return sample index, device time, host time and values of an entity, in order of the index."""
    parts = []
    for path in paths:
        for batch in record_batches(path, entity):
            times = [
                batch.column(name).cast(pa.int64()).to_numpy(zero_copy_only=False)
                for name in ("sample", "device_time", "host_time")
            ]
            values = batch.column("Scalars:scalars").flatten().to_numpy()
            parts.append((*times, values.reshape(batch.num_rows, -1)))
    sample, device, host, values = (np.concatenate(column) for column in zip(*parts, strict=True))
    order = np.argsort(sample, kind="stable")
    return sample[order], device[order], host[order], values[order]


def entities(path: Path) -> set[str]:
    """Return the entity paths of a recording."""
    return {str(chunk.entity_path) for chunk in RrdReader(str(path)).stream()}
