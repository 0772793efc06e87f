"""Compile what has changed since the last time, in parallel processes, so that a start is like any other.

What is left and what is done is told on standard error.  Nothing is deleted: each kernel is renewed when
something that it is made of has changed (imumon/compiled.py).
"""

from __future__ import annotations

import gc
import hashlib
import io
import logging
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from time import process_time

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from imumon.sources import stamp  # noqa: E402  (of this clone, whichever is installed)

DONE = ROOT / "imumon" / "__pycache__" / "kernels"
"""Fingerprint of all kernels when they were last compiled; beside what it tells of, so deleted with it."""


def main() -> int:
    """Compile the kernels, first those that stand on their own, then those that need them."""
    now = fingerprint()
    if DONE.exists() and DONE.read_text() == now:
        return 0
    left = [*FIRST, *THEN]
    for tasks in (FIRST, THEN):
        processes = min(os.cpu_count() or 1, len(tasks))
        # What a task leaves in memory goes with its process: collecting it would cost a twentieth.
        with get_context("spawn").Pool(processes, gc.disable, maxtasksperchild=1) as pool:
            for name, modules, seconds in pool.imap_unordered(run, tasks):
                left.remove(name)
                if modules:
                    print(f"compiled {name} ({seconds:.0f} s: {', '.join(modules)})", file=sys.stderr)
                    print(f"   left: {', '.join(left) or 'nothing'}", file=sys.stderr)
    DONE.parent.mkdir(exist_ok=True)
    DONE.write_text(now)
    return 0


def fingerprint() -> str:
    """Return the fingerprint of everything that decides what compiled code is like."""
    modules = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in sorted((ROOT / "imumon").rglob("*.py"))
        if "import njit" in path.read_text(encoding="utf-8")
    ]
    parts = [version("numba"), platform.python_version(), platform.node(), *map(stamp, modules)]
    parts.append(Path(__file__).read_text(encoding="utf-8"))
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def run(name: str) -> tuple[str, list[str], float]:
    """Do a task in a process of its own; return its name, what it had to compile, and its CPU seconds."""
    seen = _Compiled()
    log = logging.getLogger("imumon.compiled")
    log.setLevel(logging.INFO)
    log.addHandler(seen)
    {**FIRST, **THEN}[name]()
    return name, seen.modules, process_time()


class _Compiled(logging.Handler):
    """Collects the modules that are compiled."""

    def __init__(self) -> None:
        super().__init__()
        self.modules: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        self.modules.append(str(record.args[0] if isinstance(record.args, tuple) else record.args))


def packets(device_name: str) -> None:
    """Decode packets of a device, and put those of one time together."""
    import numpy as np

    from imumon.blocks import SampleBlock
    from imumon.columns import KNOWN
    from imumon.protocols.device import load_device
    from imumon.protocols.epochs import EpochAssembler

    device = load_device(device_name)
    sent = SampleBlock({column.name: np.zeros(3, column.dtype) for column in KNOWN.values()})
    decoder = device.decoder()
    for number, packet in enumerate(device.encoder().encode(sent)):
        decoder.feed(packet, number)
    decoder.finish()
    if decoder.groups is not None:
        EpochAssembler(decoder.groups).process(decoder.take_packets(), end=True)


def clocks() -> None:
    """Put packets of one time together, and date samples by the clocks of device and host."""
    import numpy as np

    from imumon.clock.device import DeviceClock
    from imumon.clock.host import HostClock
    from imumon.protocols.device import load_device

    packets("xsens")
    numbers = np.arange(3)
    time_ns, segment = DeviceClock(load_device("ax1").decoder().timing).process(numbers, numbers, numbers, 3)
    HostClock().process(time_ns, segment, numbers)


def temperature() -> None:
    """Follow a temperature; apart from the other stages, so that they are compiled side by side."""
    from imumon.estimation.temperature_rate.stage import TemperatureRate
    from imumon.run.live import rest_and_turn

    TemperatureRate().process(rest_and_turn())


def rest() -> None:
    """Tell rest from motion."""
    from imumon.estimation.gyro_bias.stage import RestDetector
    from imumon.run.live import rest_and_turn

    RestDetector().process(rest_and_turn())


def estimators() -> None:
    """Run every stage behind a device; with a latitude the heading is sought, too."""
    from imumon.protocols.device import load_device
    from imumon.run.live import warm_up
    from imumon.run.setup import Setup

    warm_up(load_device("ax1"), Setup(latitude_deg=45.0))


def recordings() -> None:
    """Simulate a minute at rest and take the Allan deviation of it."""
    from imumon.cli import cli

    unread = io.StringIO()
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(unread), redirect_stderr(unread):
        table = f"{folder}/bench.parquet"
        cli.main(
            ["simulate", "crs05-ramp-hysteresis", "--duration", "60", "--rate", "100", "--out", table],
            standalone_mode=False,
        )
        cli.main(["allan", table], standalone_mode=False)


FIRST: dict[str, Callable[[], None]] = {
    "epochs and clocks": clocks,
    "temperature rate": temperature,
    "rest": rest,
}
THEN: dict[str, Callable[[], None]] = {"estimators": estimators, "simulation and Allan deviation": recordings}

if __name__ == "__main__":
    sys.exit(main())
