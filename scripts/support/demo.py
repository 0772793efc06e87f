"""The demo: a virtual AHRS in this process, ``imumon monitor`` on its port in another."""

from __future__ import annotations

import signal

# Ctrl-C before the monitor is ready waits until it is, so that every run ends with a summary.
STOP = {signal.SIGINT, signal.SIGTERM}
signal.pthread_sigmask(signal.SIG_BLOCK, STOP)

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from imumon.simulation.virtual_port import VirtualPort

if TYPE_CHECKING:
    from imumon.simulation.virtual_device import VirtualDevice

DEVICE = "ax1"


def main(options: list[str]) -> int:
    """Run the monitor on a virtual AHRS with these options of ``imumon monitor``; return its exit code."""
    with tempfile.TemporaryDirectory(prefix="imumon-demo-") as folder:
        port = VirtualPort(Path(folder) / "ahrs")
        imumon = str(Path(sys.executable).with_name("imumon"))
        monitor = subprocess.Popen([imumon, "monitor", port.path, "--device", DEVICE, *options])
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


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
