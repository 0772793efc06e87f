"""Xsens MTData2: messages that say themselves what they carry."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from typing import Literal

from imumon.protocols.base import Timing, chosen
from imumon.protocols.device import DeviceFile
from imumon.protocols.messages import Message
from imumon.protocols.tagged import XBUS, TaggedDecoder, TaggedEncoder
from imumon.protocols.xsens.fields import DERIVED, FRAMES, IDENTIFIERS, PRECISIONS, message_of
from imumon.protocols.xsens.messages import MTDATA, MTDATA2, NAMES, describe, identifier_name

Precision = Literal["float32", "fp12.20", "fp16.32", "float64"]
Frame = Literal["ENU", "NED", "NWU"]

TICK_NS = Fraction(100_000)
"""SampleTimeFine counts in 10 kHz."""
_FRAMED = {item.code for item in IDENTIFIERS if item.framed}


class MTData2Decoder(TaggedDecoder):
    """Decodes MTData2; one row per message, with the columns that the device has sent so far.

    `rate_hz` is the nominal rate of the messages.
    """

    _type_names = NAMES

    def __init__(self, rate_hz: float | None = None) -> None:
        timing = Timing(counter_bits=16, tick_ns=TICK_NS, tick_bits=32, rate_hz=rate_hz)
        fields = [field for item in IDENTIFIERS if (field := item.message()) is not None]
        super().__init__(XBUS, timing, fields, [MTDATA2], DERIVED, apart=("gnss",))

    def _field(self, key: int, size: int) -> Message | None:
        found = message_of(key, size)
        if found is not None and key & 0xFFF0 in _FRAMED:
            frame = next(name for name, bits in FRAMES.items() if bits == key & 0xC)
            self._say(f"orientation and velocity are given in the frame {frame}")
        return found

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        if kind == MTDATA:
            return ["the device sends legacy MTData, which needs the device xsens-legacy with its profile"]
        return describe(kind, payload)

    def _field_name(self, key: int) -> str:
        return identifier_name(key)


def find_fields(
    names: Sequence[str], precision: Precision = "float32", frame: Frame = "ENU"
) -> list[tuple[int, Message]]:
    """Return codes and fields of these data identifiers in a precision; raises as `MTData2Encoder`."""
    found = []
    there = {item.name: item for item in reversed(IDENTIFIERS) if item.numbers}
    for item in chosen(names, there, "data identifier"):
        form = FRAMES[frame] if item.framed else 0
        form |= [*PRECISIONS].index(precision) if item.is_real else 0
        field = item.message(form)
        assert field is not None
        found.append((item.code | form, field))
    return found


class MTData2Encoder(TaggedEncoder):
    """Makes MTData2 messages.

    Raises BAD_CONFIG when a name is not that of a data identifier that carries values.

    Parameters
    ----------
    names : sequence of str
        Data identifiers as in `fields.IDENTIFIERS`, in the order in which they are sent.
    precision : str
        float32, fp12.20, fp16.32 or float64.
    frame : str
        ENU, NED or NWU, for the bits in the identifiers; values are sent as they are.
    """

    def __init__(self, names: Sequence[str], precision: Precision = "float32", frame: Frame = "ENU") -> None:
        super().__init__(XBUS, MTDATA2, find_fields(names, precision, frame), DERIVED)


class MTData2Device(DeviceFile):
    """Device file of an MTi that sends MTData2; `sends` and `precision` are for its virtual twin alone."""

    protocol: Literal["xsens-mtdata2"]
    sends: list[str]
    precision: Precision = "float32"

    def decoder(self) -> MTData2Decoder:
        """Make a decoder for this device."""
        return MTData2Decoder(self.rate_hz)

    def encoder(self) -> MTData2Encoder:
        """Make an encoder that sends what the device would send."""
        return MTData2Encoder(self.sends, self.precision)
