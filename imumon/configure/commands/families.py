"""Which devices can be configured, by the protocol of their device files."""

from __future__ import annotations

from pkgutil import resolve_name
from typing import TYPE_CHECKING

from imumon.errors import ImumonError, Reason
from imumon.protocols.device import DeviceFile

if TYPE_CHECKING:
    from imumon.configure.commands.core import Family

FAMILIES = {
    "xsens-mtdata2": "imumon.configure.commands.xsens:Xsens",
    "mip": "imumon.configure.commands.mip:Mip",
    "vectornav": "imumon.configure.commands.vectornav:VectorNav",
    "witmotion": "imumon.configure.commands.witmotion:WitMotion",
}
"""Class of the commands of each protocol; imported when a device of it is asked for."""


def family_of(device: DeviceFile) -> Family:
    """Return the commands for a device.

    Raises BAD_CONFIG when imumon has none for it.
    """
    if device.protocol not in FAMILIES:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"imumon does not configure {device.name} devices",
            "those that it does: xsens, microstrain, vectornav, witmotion; use the vendor's software",
        )
    family: type[Family] = resolve_name(FAMILIES[device.protocol])
    return family.of(device)
