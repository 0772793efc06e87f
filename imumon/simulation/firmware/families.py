"""Which virtual devices answer commands, by the protocol of their device files."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module

from imumon.protocols.device import DeviceFile
from imumon.simulation.firmware.core import Firmware

FIRMWARE = {
    "xsens-mtdata2": "xsens:XsensFirmware",
    "mip": "mip:MipFirmware",
    "vectornav": "vectornav:VectorNavFirmware",
    "witmotion": "witmotion:WitMotionFirmware",
}


def firmware_of(device: DeviceFile, rate_hz: float) -> Firmware | None:
    """Return the firmware of a virtual device that sends at this rate; None for one that does not listen."""
    if device.protocol not in FIRMWARE:
        return None
    module, name = FIRMWARE[device.protocol].split(":")
    make: Callable[[DeviceFile, float], Firmware] = getattr(
        import_module(f"imumon.simulation.firmware.{module}"), name
    )
    return make(device, rate_hz)
