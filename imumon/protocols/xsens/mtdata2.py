"""Xsens MTData2: messages that say themselves what they carry."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from functools import cache
from typing import Literal

from imumon.protocols.base import Timing, chosen
from imumon.protocols.device import DeviceFile
from imumon.protocols.tagged import XBUS, Field, FieldTable, TaggedDecoder, TaggedEncoder
from imumon.protocols.xsens.fields import DERIVED, FRAMES, IDENTIFIERS, MTDATA2_FIELDS, PRECISIONS
from imumon.protocols.xsens.messages import MTDATA, MTDATA2, NAMES, describe, identifier_name

Precision = Literal["float32", "fp12.20", "fp16.32", "float64"]
Frame = Literal["ENU", "NED", "NWU"]

TICK_NS = Fraction(100_000)
"""SampleTimeFine counts in 10 kHz."""


@cache
def _table() -> FieldTable:
    """Return the fields, put together once for all decoders: it takes 9 ms."""
    return FieldTable(MTDATA2_FIELDS, DERIVED, apart=("gnss",))


class MTData2Decoder(TaggedDecoder):
    """Decodes MTData2; one row per message, with the columns that the device has sent so far.

    Parameters
    ----------
    rate_hz : float or None
        Nominal rate of the messages.
    """

    def __init__(self, rate_hz: float | None = None) -> None:
        timing = Timing(counter_bits=16, tick_ns=TICK_NS, tick_bits=32, rate_hz=rate_hz)
        super().__init__(_table(), XBUS, [MTDATA2], NAMES, timing)

    @property
    def reference_frame(self) -> Frame | None:
        """Frame of orientation, velocity and free acceleration; None before one of them has come."""
        framed = {item.code for item in IDENTIFIERS if item.framed}
        self._search(final=False)
        codes = [field.key & 0xC for field in self._known if field.key & 0xFFF0 in framed]
        frames: tuple[Frame, ...] = ("ENU", "NED", "NWU")
        return next((frame for frame in frames if FRAMES[frame] in codes), None)

    def notices(self) -> list[str]:
        """Return, once each, what the device said that is not data, its frame, and what is not understood."""
        if self.reference_frame is not None:
            self._say(f"orientation and velocity are given in the frame {self.reference_frame}")
        return super().notices()

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        if kind == MTDATA:
            return ["the device sends legacy MTData, which needs the device xsens-legacy with its profile"]
        return describe(kind, payload)

    def _field_name(self, key: int) -> str:
        return identifier_name(key)


def find_fields(names: Sequence[str], precision: Precision = "float32", frame: Frame = "ENU") -> list[Field]:
    """Return the fields of these data identifiers in a precision; raises as `MTData2Encoder`."""
    found = []
    code_of_precision = tuple(PRECISIONS).index(precision)
    there = {item.name: item for item in reversed(IDENTIFIERS) if item.values}
    for item in chosen(names, there, "data identifier"):
        code = item.code | (FRAMES[frame] if item.framed else 0)
        if not item.raw and not item.values[0].type:
            code |= code_of_precision
        found.append(next(field for field in MTDATA2_FIELDS if field.key == code))
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
        super().__init__(find_fields(names, precision, frame), DERIVED, XBUS, MTDATA2)


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
