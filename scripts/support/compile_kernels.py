"""Compile what has changed since the last time, so that a start is like any other.

What is done goes to standard error.  Nothing is deleted: numba renews each kernel (imumon/compiled.py).
"""

from __future__ import annotations

import io
import platform
import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from importlib.metadata import version
from pathlib import Path
from time import monotonic

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from imumon.compiled import package_stamp  # noqa: E402  (of this clone, whichever is installed)

DONE = ROOT / "imumon" / "__pycache__" / "kernels"
"""State of the package when the kernels were last compiled; beside the kernels, so deleted with them."""


def main() -> None:
    """Compile the kernels, where anything has changed."""
    now = f"{package_stamp('imumon')} numba {version('numba')} Python {platform.python_version()}"
    now += f" on {platform.node()}"
    if DONE.exists() and DONE.read_text() == now:
        return
    for name, task in TASKS.items():
        began = monotonic()
        task()
        print(f"compiled {name} ({monotonic() - began:.0f} s)", file=sys.stderr)
    DONE.parent.mkdir(exist_ok=True)
    DONE.write_text(now)


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


TASKS: dict[str, Callable[[], None]] = {
    "epochs and clocks": clocks,
    "estimators": estimators,
    "simulation and Allan deviation": recordings,
}

if __name__ == "__main__":
    main()
