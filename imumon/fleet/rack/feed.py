"""What the process of a unit reports to the rack: how the unit is, and items for the view of all units."""

import math
import time
from dataclasses import dataclass, field, replace

import numpy as np
import psutil

from imumon.blocks import SampleBlock
from imumon.run.narration import Progress
from imumon.view.items import (
    Drawing,
    DropOldestQueue,
    Event,
    Instant,
    Samples,
    State,
    Times,
    ViewItem,
    ViewSetup,
    first_of_steps,
    merge,
)

QUEUE_BYTES = 4 << 20
"""A second of samples takes 200 kB at 400 Hz."""
PICTURE_STEP_NS = 20_000_000
"""The shared view gets a sample every 20 ms: what a screen can show of half a minute; the session has all."""
MEMORY_S = 10.0
"""How often the memory is looked up, which takes some milliseconds."""


@dataclass
class Vitals:
    """How a unit is, once a second.

    `session` is the folder of its recording, empty while its port cannot be opened; `lanes` the present state
    of each lane: port, data, motion, model.  Temperature is the mean over its sensors, °C, NaN until there is
    one; bias and its standard deviation are of each gyro, rad/s, empty until there is one.  Lost packets are
    missing by their counter, or damaged.  The process takes a share of a core, since the last time and since
    its port is open, and memory: pages of its own, and its share of those in common with other processes.
    """

    session: str = ""
    lanes: dict[str, str] = field(default_factory=dict)
    temperature_deg: float = math.nan
    bias: tuple[float, ...] = ()
    bias_sd: tuple[float, ...] = ()
    packets_per_s: float = 0.0
    packets_lost: int = 0
    bytes_received: int = 0
    cpu: float = 0.0
    mean_cpu: float = 0.0
    memory_mb: float = math.nan


class Feed:
    """Gathers the view items of a unit; `publish` may be called from any thread, `take` from one.

    `session` is the folder of the recording.
    """

    def __init__(self, session: str) -> None:
        self._queue = DropOldestQueue(QUEUE_BYTES)
        self.publish = self._queue.put
        self._vitals = Vitals(session)
        self._process = psutil.Process()
        self._process.cpu_percent()  # from now on it returns the share since the last call
        self._memory_s = -math.inf
        self._opened_s, self._cpu_s = time.monotonic(), time.process_time()

    def take(self, progress: Progress) -> tuple[Vitals, list[ViewItem]]:
        """Return how the unit is, and what has come for the view since the last time."""
        items = merge(self._queue.take(0.0, 0.0))
        for item in items:
            if isinstance(item, State):
                self._vitals.lanes[item.lane] = item.state
            elif isinstance(item, Samples) and not item.stream:
                self._measure(item.block)
        vitals, now_s = self._vitals, time.monotonic()
        if now_s - self._memory_s > MEMORY_S:
            self._memory_s = now_s
            vitals.memory_mb = self._process.memory_full_info().pss / 1e6
        vitals.packets_per_s = progress.packets_per_s
        vitals.packets_lost = progress.counters.lost
        vitals.bytes_received = progress.counters.bytes_received
        vitals.cpu = self._process.cpu_percent() / 100.0
        vitals.mean_cpu = (time.process_time() - self._cpu_s) / (now_s - self._opened_s)
        return vitals, [item for item in map(picture, items) if item is not None]

    def _measure(self, block: SampleBlock) -> None:
        """Note temperature and bias of the newest samples that have them."""
        temperature, bias, sd = block.temperature, block.vector("gyro_bias"), block.vector("gyro_bias_sd")
        if temperature is not None and np.isfinite(temperature).any():
            self._vitals.temperature_deg = float(np.nanmean(temperature))
        if bias is not None and sd is not None:
            known = np.flatnonzero(np.isfinite(bias).all(axis=1) & np.isfinite(sd).all(axis=1))
            if len(known):
                self._vitals.bias, self._vitals.bias_sd = tuple(bias[known[-1]]), tuple(sd[known[-1]])


@dataclass(frozen=True)
class OfUnit(ViewItem):
    """An item of one unit; the title of the setup is its name."""

    setup: ViewSetup
    item: ViewItem

    @property
    def nbytes(self) -> int:
        """Bytes of the item."""
        return self.item.nbytes

    @property
    def rows(self) -> int:
        """Rows of the item."""
        return self.item.rows

    @property
    def lasting(self) -> str | None:
        """What the item replaces, of this unit."""
        key = self.item.lasting
        return key and f"{self.setup.title}: {key}"


@dataclass(frozen=True)
class Overview(Event):
    """All units at a glance, as Markdown, and their names in order."""

    markdown: str
    units: tuple[str, ...]

    lasting = "overview"


def picture(item: ViewItem) -> Samples | Event | None:
    """Return an item as the shared view shows it: by the host's clock, fifty samples a second, no charts.

    Other units have other device clocks; and a chart that is drawn for each unit takes as long as all else.
    """
    if isinstance(item, Event):
        hidden = isinstance(item, Drawing) or item.at.host_ns is None
        return None if hidden else replace(item, at=Instant(None, None, item.at.host_ns))
    assert isinstance(item, Samples)
    times = item.block["arrival_time_ns"] if item.times.host_ns is None else item.times.host_ns
    keep = first_of_steps(times, PICTURE_STEP_NS)
    columns = {
        name: values[keep]
        for name, values in item.block.columns.items()
        if values.dtype == np.float64 and np.isfinite(values).any()
    }
    shown = Times(None, None, times[keep])
    return Samples(shown, SampleBlock(columns), item.stream) if columns else None
