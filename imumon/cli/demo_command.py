"""``imumon demo``: a virtual AHRS in this process, ``imumon monitor`` on its port in another."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from imumon.simulation.virtual_device import VirtualDevice
    from imumon.simulation.virtual_port import VirtualPort

DEVICE = "ax1"
STOP = {signal.SIGINT, signal.SIGTERM}


@click.command("demo", context_settings={"ignore_unknown_options": True})
@click.argument("options", nargs=-1, type=click.UNPROCESSED, metavar="[OPTIONS OF MONITOR]...")
def command(options: tuple[str, ...]) -> int:
    """Watch a virtual AHRS that is turned by hand: to see imumon at work, without hardware.

    \b
    imumon demo                                  # until Ctrl-C
    imumon demo --seconds 20 --view terminal     # without a display

    The options are those of `imumon monitor`.
    """
    from imumon.simulation.virtual_port import VirtualPort

    # Ctrl-C before the monitor is ready waits until it is, so that every run ends with a summary.
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    with tempfile.TemporaryDirectory(prefix="imumon-demo-") as folder:
        port = VirtualPort(Path(folder) / "ahrs")
        arguments = ["monitor", port.path, "--device", DEVICE, *options]
        monitor = subprocess.Popen([sys.executable, "-m", "imumon", *arguments])
        for number in STOP:  # Ctrl-C in a terminal reaches the monitor anyway, and twice does no harm
            signal.signal(number, lambda *_: monitor.send_signal(signal.SIGINT))
        with _switched_on(port):
            signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP)
            return monitor.wait()


def _switched_on(port: VirtualPort) -> VirtualDevice:
    """Return the device on the port, imported only now: the monitor starts meanwhile."""
    from imumon.protocols.device import load_device
    from imumon.simulation.virtual_device import VirtualDevice

    return VirtualDevice(load_device(DEVICE), port=port)
