"""Which virtual devices answer commands, by the protocol of their device files."""

from __future__ import annotations

from collections.abc import Callable
from pkgutil import resolve_name

from imumon.protocols.device import DeviceFile
from imumon.simulation.firmware.core import Firmware

FIRMWARE = {
    "xsens-mtdata2": "imumon.simulation.firmware.xsens:XsensFirmware",
    "mip": "imumon.simulation.firmware.mip:MipFirmware",
    "vectornav": "imumon.simulation.firmware.vectornav:VectorNavFirmware",
    "witmotion": "imumon.simulation.firmware.witmotion:WitMotionFirmware",
}


def firmware_of(device: DeviceFile, rate_hz: float) -> Firmware | None:
    """Return the firmware of a virtual device that sends at this rate; None for one that does not listen."""
    if device.protocol not in FIRMWARE:
        return None
    make: Callable[[DeviceFile, float], Firmware] = resolve_name(FIRMWARE[device.protocol])
    return make(device, rate_hz)
