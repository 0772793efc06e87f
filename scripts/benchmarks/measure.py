"""Times of functions that take turns, so that whatever slows the machine slows them all."""

import math
import os
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from time import perf_counter_ns

from study import Table

ROUNDS = 40
ROUND_NS = 4_000_000
"""Each function has about this long in each round."""
BUSY = 0.5
"""Load of others from which on the figures are low."""


@dataclass
class Bar:
    """What is demanded, and what was measured."""

    name: str
    demanded: float
    measured: float
    at_most: bool = False

    @property
    def passed(self) -> bool:
        """Return whether the measured value is good enough."""
        return self.measured <= self.demanded if self.at_most else self.measured >= self.demanded


Result = tuple[list[Table], list[Bar]]
"""What a section gives."""


def measure(functions: Mapping[str, Callable[[], object]], rounds: int = ROUNDS) -> dict[str, float]:
    """Return the best time of each function, ns; all of them take turns, so many rounds long."""
    repeats = {}
    for name, function in functions.items():
        function()  # compiles, and warms the caches
        repeats[name] = max(1, min(2000, ROUND_NS // max(_once(function), 1)))
    best = dict.fromkeys(functions, math.inf)
    for _ in range(rounds):
        for name, function in functions.items():
            best[name] = min(best[name], *(_once(function) for _ in range(repeats[name])))
    return best


def _once(function: Callable[[], object]) -> int:
    start = perf_counter_ns()
    function()
    return perf_counter_ns() - start


def machine() -> str:
    """Return the facts about this machine, with a warning when others used it in the last minute."""
    cpu, info = platform.processor() or platform.machine(), Path("/proc/cpuinfo")
    if info.exists():
        names = [line.split(":", 1)[1] for line in info.read_text().splitlines() if "model name" in line]
        cpu = names[0].strip() if names else cpu
    load = os.getloadavg()[0]
    facts = f"{cpu}, {os.cpu_count()} cores, one used; Python {platform.python_version()}"
    facts += f", NumPy {version('numpy')}, numba {version('numba')}; load before the run {load:.2f}."
    if load > BUSY:
        facts += f"\nWarning: the load was above {BUSY}: others used the machine, so the figures are low."
    return facts
