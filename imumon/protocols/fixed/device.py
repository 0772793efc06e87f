"""The device files of devices that send packets of fixed lengths."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from imumon.protocols.base import Encoder
from imumon.protocols.device import DeviceFile
from imumon.protocols.fixed.description import Packet
from imumon.protocols.framing import Decoder


class FixedDevice(DeviceFile):
    """A device that sends packets of one fixed length."""

    protocol: Literal["fixed"]
    packet: Packet

    def decoder(self) -> Decoder:
        """Make a decoder for this packet."""
        from imumon.protocols.fixed.decoder import FixedDecoder

        return FixedDecoder(self.name, [self.packet], self.rate_hz)

    def encoder(self) -> Encoder:
        """Make an encoder for this packet."""
        from imumon.protocols.fixed.encoder import FixedEncoder

        return FixedEncoder([self.packet])


class SeveralDevice(DeviceFile):
    """A device that sends several kinds of packets of fixed lengths; `sends` is for its virtual twin."""

    protocol: Literal["fixed-several"]
    packets: list[Packet] = Field(min_length=1)
    sends: list[str] = Field(min_length=1)

    @model_validator(mode="after")
    def _named(self) -> Self:
        names = [packet.name for packet in self.packets]
        if "" in names or len({*names}) < len(names):
            raise ValueError("packets: each needs a name of its own")
        unknown = sorted({*self.sends} - {*names})
        if unknown:
            raise ValueError(f"sends: no packet {', '.join(unknown)}; there are: {', '.join(names)}")
        return self

    def decoder(self) -> Decoder:
        """Make a decoder for these packets."""
        from imumon.protocols.fixed.decoder import FixedDecoder

        return FixedDecoder(self.name, self.packets, self.rate_hz)

    def encoder(self) -> Encoder:
        """Make an encoder for those that are sent."""
        from imumon.protocols.fixed.encoder import FixedEncoder

        return FixedEncoder([packet for packet in self.packets if packet.name in self.sends])
