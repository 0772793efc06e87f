"""Device files: a device is a YAML file that names a protocol and fills in what that protocol leaves open."""

import os
from abc import abstractmethod
from pathlib import Path
from pkgutil import resolve_name
from typing import Literal, Self

from pydantic import Field, PositiveFloat, PositiveInt, PrivateAttr

from imumon.config import StrictModel, parse_yaml
from imumon.errors import bad_config
from imumon.files import bundled, read_text
from imumon.plugins import DEVICES, plugins
from imumon.transport.settings import PortSettings

from .base import Encoder
from .decoder import Decoder
from .ranges import Ranges
from .thermometer import TemperatureRateParameters

FAMILIES = {
    "ximu3": "imumon.protocols.ximu3:XimuDecoder",
    "mavlink": "imumon.protocols.mavlink:MavlinkDecoder",
    "witmotion": "imumon.protocols.witmotion:WitMotionDecoder",
    "sbg": "imumon.protocols.sbg:SbgDecoder",
    "inertialsense": "imumon.protocols.inertialsense:InertialSenseDecoder",
    "hipnuc": "imumon.protocols.hipnuc:HipnucDecoder",
    "vectornav": "imumon.protocols.vectornav:VectorNavDecoder",
}
"""Decoder of each protocol that is a table of messages; imported when a device of it is decoded."""
PROTOCOLS = {
    "fixed": "imumon.protocols.fixed:FixedDevice",
    "fixed-several": "imumon.protocols.fixed:SeveralDevice",
    "text": "imumon.protocols.text:TextDevice",
    "xsens-mtdata2": "imumon.protocols.xsens.mtdata:MTData2Device",
    "xsens-mtdata": "imumon.protocols.xsens.mtdata:MTDataDevice",
    "stim300": "imumon.protocols.stim300:StimDevice",
    "mip": "imumon.protocols.mip:MipDevice",
} | dict.fromkeys(FAMILIES, "imumon.protocols.messages:TableDevice")
"""Class that reads the device files of each protocol; imported when a device of it is loaded."""
FOLDER = "path of a folder of device files"
"""What a plug-in offers in the group `imumon.plugins.DEVICES`, in words."""


class SerialSettings(StrictModel):
    """How the device's port is set; the first baud rate is the one it has when new."""

    baudrates: list[PositiveInt] = Field(default=[115_200], min_length=1)
    bytesize: Literal[7, 8] = 8
    parity: Literal["N", "E", "O"] = "N"
    stopbits: Literal[1, 2] = 1


class DeviceFile(StrictModel):
    """What every device file holds; each protocol adds its own keys and makes the decoder."""

    format: Literal["imumon-device/1"]
    name: str = Field(pattern=r"^[a-z0-9][a-z0-9_-]*$")
    title: str
    verified: str = "not given"
    """Against what the decoder was checked."""
    protocol: str
    serial: SerialSettings = SerialSettings()
    rate_hz: PositiveFloat | None = None
    axes: Literal["FLU", "FRD"]
    range: Ranges = Ranges()
    temperature: TemperatureRateParameters = TemperatureRateParameters()
    _rate_given: bool = PrivateAttr(default=False)

    def at_rate(self, rate_hz: float | None) -> Self:
        """Return the same for a stream whose packet rate a person gives, in Hz; None leaves it."""
        if rate_hz is None:
            return self
        given = self.model_copy(update={"rate_hz": rate_hz})
        given._rate_given = True
        return given

    @property
    def rate_given(self) -> bool:
        """Whether a person gave the rate of this stream."""
        return self._rate_given

    def port_settings(self, url: str, baudrate: int | None) -> PortSettings:
        """Return how a port with this device is opened; at the first of its rates if none is given."""
        serial = self.serial
        rate = baudrate or serial.baudrates[0]
        return PortSettings(url, rate, serial.bytesize, serial.parity, serial.stopbits)

    @abstractmethod
    def decoder(self) -> Decoder:
        """Make a decoder for this device."""

    @abstractmethod
    def encoder(self) -> Encoder:
        """Make an encoder that sends what the device would send."""


class _Header(StrictModel, extra="ignore"):
    """The part of a device file that names the protocol which reads the rest."""

    format: Literal["imumon-device/1"]
    protocol: Literal[tuple(PROTOCOLS)]  # type: ignore[valid-type]  # pydantic reads it when it runs


def device_names() -> list[str]:
    """Return the names that `load_device` knows without a path."""
    return sorted(_files())


def _files() -> dict[str, Path]:
    """Return the device files by name: those of imumon, which come first, and of plug-ins."""
    found = plugins(DEVICES, FOLDER, is_folder)
    paths = [path for plugin in found for path in Path(plugin.offered).glob("*.yaml")]
    return {path.stem: path for path in paths} | bundled("devices")


def is_folder(_: str, offered: object) -> bool:
    """Return whether a plug-in offers a folder."""
    return isinstance(offered, str | os.PathLike) and Path(offered).is_dir()


def device_text(name: str) -> tuple[str, str]:
    """Return the text of a device file and what to call it in errors; `name` is a known name or a path.

    Raises BAD_CONFIG when there is no such device, naming those that there are.
    """
    looks_like_path = name.endswith((".yaml", ".yml")) or "/" in name
    path = Path(name) if looks_like_path else _files().get(name)
    if path is None or ("\0" not in name and not path.exists()):
        raise bad_config(
            f"no device {name!r}" + (": no such file" if looks_like_path else ""),
            f"known devices: {', '.join(device_names())}; or give the path of a device file (NAME.yaml)",
        )
    return read_text(path), str(path)


def parse_device(text: str, source: str) -> DeviceFile:
    """Read the text of a device file; raises BAD_CONFIG as `load_device`."""
    header = parse_yaml(text, _Header, source)
    device = parse_yaml(text, resolve_name(PROTOCOLS[header.protocol]), source)
    assert isinstance(device, DeviceFile)
    return device


def load_device(name: str) -> DeviceFile:
    """Read a device by its known name or the path of its file.

    Raises BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    return parse_device(*device_text(name))
