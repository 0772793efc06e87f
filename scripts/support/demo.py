"""The demo: a virtual AHRS in this process, ``imumon monitor`` on its port in another."""

from __future__ import annotations

import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice


def main(options: list[str]) -> int:
    """Run the monitor on a virtual AHRS with these options of ``imumon monitor``; return its exit code."""
    # Ctrl-C in the terminal reaches the monitor as well, which ends in order; this process waits for it.
    # A handler, unlike SIG_IGN, is not inherited.
    signal.signal(signal.SIGINT, lambda *_: None)
    with (
        tempfile.TemporaryDirectory(prefix="imumon-demo-") as folder,
        VirtualDevice(load_device("ax1"), Path(folder) / "ahrs") as ahrs,
    ):
        imumon = str(Path(sys.executable).with_name("imumon"))
        monitor = subprocess.Popen([imumon, "monitor", ahrs.port.path, "--device", "ax1", *options])
        signal.signal(signal.SIGTERM, lambda *_: monitor.terminate())
        return monitor.wait()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
