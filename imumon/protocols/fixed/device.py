"""The device file of a device that sends packets of one fixed length."""

from __future__ import annotations

from typing import Literal

from imumon.protocols.base import Decoder, Encoder
from imumon.protocols.device import DeviceFile
from imumon.protocols.fixed.description import Packet


class FixedDevice(DeviceFile):
    """A device that sends packets of one fixed length."""

    protocol: Literal["fixed"]
    packet: Packet

    def decoder(self) -> Decoder:
        """Make a decoder for this packet."""
        from imumon.protocols.fixed.decoder import FixedDecoder

        return FixedDecoder(self.name, self.packet, self.rate_hz)

    def encoder(self) -> Encoder:
        """Make an encoder for this packet."""
        from imumon.protocols.fixed.encoder import FixedEncoder

        return FixedEncoder(self.packet)
