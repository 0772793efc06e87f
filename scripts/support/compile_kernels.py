"""Compile the kernels of every known device, so that a first start is like any other."""

from __future__ import annotations

from imumon.protocols.device import device_names, load_device
from imumon.run.live import warm_up
from imumon.run.setup import Setup

if __name__ == "__main__":
    for name in device_names():
        warm_up(load_device(name), Setup(latitude_deg=45.0))  # with a latitude the heading is sought, too
