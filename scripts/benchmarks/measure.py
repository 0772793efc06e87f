"""Times of functions that take turns, so that whatever slows the machine slows them all."""

from __future__ import annotations

import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from importlib.metadata import version
from pathlib import Path
from statistics import median
from time import perf_counter_ns

ROUNDS = 40
ROUND_NS = 4_000_000
"""Each function has about this long in each round."""
BUSY = 0.5
"""Load of others from which on the figures are low."""


@dataclass(frozen=True)
class Time:
    """Nanoseconds of one call: the best of all, and the median."""

    best: float
    median: float


@dataclass
class Table:
    """Figures of one section: rows under headings."""

    title: str
    headings: list[str]
    rows: list[list[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


@dataclass
class Bar:
    """What is demanded, what was measured, and whether a miss is an error."""

    name: str
    demanded: float
    measured: float
    at_most: bool = False
    required: bool = False

    @property
    def passed(self) -> bool:
        """Return whether the measured value is good enough."""
        return self.measured <= self.demanded if self.at_most else self.measured >= self.demanded


def measure(functions: Mapping[str, Callable[[], object]], rounds: int = ROUNDS) -> dict[str, Time]:
    """Return the time of each function; all of them take turns, so many rounds long."""
    repeats = {}
    for name, function in functions.items():
        function()  # compiles, and warms the caches
        repeats[name] = max(1, min(2000, ROUND_NS // max(_once(function), 1)))
    times: dict[str, list[int]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            times[name] += [_once(function) for _ in range(repeats[name])]
    return {name: Time(min(values), median(values)) for name, values in times.items()}


def _once(function: Callable[[], object]) -> int:
    start = perf_counter_ns()
    function()
    return perf_counter_ns() - start


@dataclass(frozen=True)
class Machine:
    """What the figures were measured on."""

    cpu: str
    cores: int
    python: str
    numpy: str
    numba: str
    load_before: float

    @property
    def busy(self) -> bool:
        """Return whether others used the machine when the run began."""
        return self.load_before > BUSY

    def facts(self) -> dict[str, object]:
        """Return the facts by name."""
        return asdict(self)


def machine() -> Machine:
    """Return the facts about this machine; the load is that of the last minute, before the run."""
    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":", 1)[1] for line in info.read_text().splitlines() if "model name" in line]
        cpu = names[0].strip() if names else cpu
    return Machine(
        cpu=cpu,
        cores=os.cpu_count() or 1,
        python=platform.python_version(),
        numpy=version("numpy"),
        numba=version("numba"),
        load_before=round(os.getloadavg()[0], 2),
    )


def millions(packets: float, time_ns: float) -> float:
    """Return millions a second."""
    return packets / time_ns * 1e3
