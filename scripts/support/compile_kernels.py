"""Compile the kernels of the device of the demo, so that its first start is like any other."""

from __future__ import annotations

from imumon.protocols.device import load_device
from imumon.run.live import warm_up

if __name__ == "__main__":
    warm_up(load_device("ax1"))
