"""Which devices can be configured, by the protocol of their device files."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from imumon.errors import ImumonError, Reason
from imumon.protocols.device import DeviceFile

if TYPE_CHECKING:
    from imumon.protocols.commands.core import Family


def _xsens(device: DeviceFile) -> Family:
    del device
    from imumon.protocols.commands.xsens import Xsens

    return Xsens()


def _mip(device: DeviceFile) -> Family:
    from imumon.protocols.commands.mip import Mip
    from imumon.protocols.mip import MipDevice

    assert isinstance(device, MipDevice)
    return Mip(device.attitude, device.clock)


def _vectornav(device: DeviceFile) -> Family:
    del device
    from imumon.protocols.commands.vectornav import VectorNav

    return VectorNav()


def _witmotion(device: DeviceFile) -> Family:
    del device
    from imumon.protocols.commands.witmotion import WitMotion

    return WitMotion()


FAMILIES: dict[str, Callable[[DeviceFile], Family]] = {
    "xsens-mtdata2": _xsens,
    "mip": _mip,
    "vectornav": _vectornav,
    "witmotion": _witmotion,
}
"""Makes the commands for a device file of each protocol."""


def family_of(device: DeviceFile) -> Family:
    """Return the commands for a device.

    Raises
    ------
    ImumonError
        BAD_CONFIG when imumon has none for it.
    """
    make = FAMILIES.get(device.protocol)
    if make is None:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"imumon does not configure {device.name} devices",
            "those that it does: xsens, microstrain, vectornav, witmotion; use the vendor's software",
        )
    return make(device)
