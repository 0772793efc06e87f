"""Devices that send packets of fixed lengths, which their files describe alone: decoder and encoder."""

import re
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from itertools import pairwise
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, NonNegativeInt, PlainValidator, PositiveInt, StringConstraints, model_validator

from imumon.blocks import IntArray, SampleBlock
from imumon.columns import KNOWN, NAME, TIME_COLUMNS, Column
from imumon.config import LARGEST_NUMBER, StrictModel
from imumon.units import exact_conversion

from .base import LONGEST_PACKET, MAIN, ByteArray, Encoder, Groups, Timing
from .decoder import Decoder
from .device import DeviceFile
from .framing import CHECKSUM_NAMES, IMPOSSIBLE, Checksum, Frame
from .numbers import NUMBER_TYPES, Number, Record, write

ByteOrder = Literal["big", "little"]
Byte = Annotated[int, Field(ge=0, le=255)]
ColumnName = Annotated[str, StringConstraints(pattern=NAME)]
NumberName = Literal["u8", "i8", "u16", "i16", "u24", "i24", "u32", "i32", "u64", "i64", "f32", "f64"]

ARBITRARY = "a.u."
"""Unit of a magnetometer that is not calibrated to a field strength."""


class LengthField(StrictModel):
    """A field that always holds the same length; another value marks a false sync or a damaged packet."""

    at: NonNegativeInt
    type: Literal["u8", "u16", "u32"] = "u8"
    byte_order: ByteOrder | None = None
    value: NonNegativeInt


class ChecksumField(StrictModel):
    """A checksum of the bytes `first` <= k <= `last` and of `zeros` bytes behind, which are not sent."""

    type: Literal[CHECKSUM_NAMES]  # type: ignore[valid-type]  # pydantic reads it when it runs
    first: NonNegativeInt
    last: NonNegativeInt
    at: NonNegativeInt
    byte_order: ByteOrder | None = None
    zeros: NonNegativeInt = 0

    @model_validator(mode="before")
    @classmethod
    def _without(cls, given: object) -> object:
        # "checksum: none" needs no other keys.
        return {"type": given, "first": 0, "last": 0, "at": 0} if given == "none" else given


class When(StrictModel):
    """In which packets a field is there: those where a counter, divided by `modulo`, leaves `equals`."""

    column: ColumnName
    modulo: PositiveInt
    equals: NonNegativeInt


def _fraction(number: float | str) -> Fraction:
    """Take a decimal as it is written, 0.1 is a tenth, and a fraction of such."""
    above, _, below = str(number).partition("/")
    return Fraction(above) / Fraction(below or 1)


def _scale(given: object) -> Fraction:
    fraction = r"[+-]?\d{1,19}/[1-9]\d{0,18}(\.\d{1,9})?"
    if type(given) in (int, float) or (isinstance(given, str) and re.fullmatch(fraction, given)):
        scale = _fraction(str(given))
        if 0 < abs(scale) < LARGEST_NUMBER:
            return scale
    raise ValueError(f"expected a number or a fraction such as 1/16.4, got {given!r:.60}")


class NumberField(StrictModel):
    """One number, or several of the same type in a row: value = (raw * scale + offset) in the unit."""

    type: NumberName
    column: ColumnName | None = None
    columns: list[ColumnName] | None = Field(default=None, min_length=1)
    scale: Annotated[Fraction, PlainValidator(_scale)] = Fraction(1)
    offset: float | int = 0
    unit: str = "1"
    description: str = ""

    @property
    def names(self) -> list[str]:
        """The columns that this field fills, in their order."""
        return self.columns or [self.column or ""]

    @property
    def bits(self) -> int:
        """Bits of the number, at which a counter wraps."""
        return 8 * NUMBER_TYPES[self.type].size

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.column is None) == (self.columns is None):
            raise ValueError("give either column: NAME or columns: [NAME, ...]")
        if "packet_counter" in self.names and self.bits > 32:
            raise ValueError("packet_counter has 32 bits at most: a mask picks the lowest")
        for name in self.names:
            try:
                self.scaled(name)  # for its errors
            except ValueError as error:
                raise ValueError(f"{name}: {error}") from error
        return self

    def scaled(self, name: str) -> tuple[Column, float, float]:
        """Return a column, and scale and offset that give it in its unit."""
        integer, scale, known = NUMBER_TYPES[self.type].integer, self.scale, KNOWN.get(name)
        plain = integer and self.unit == "1" and scale == 1 and self.offset == 0
        if name in {*TIME_COLUMNS} - {"packet_counter"}:
            raise ValueError("imumon sets this itself; the clock of a device is device_ticks")
        if name == "device_ticks":
            # A clock that counts in floating point is made whole nanoseconds; an integer one stays as sent.
            # Where it begins is of no interest: an offset is passed over.
            to_ns = exact_conversion(self.unit, "ns")[0]
            return KNOWN[name], 1.0 if integer else float(scale * to_ns), 0.0
        if known is None or (self.unit == ARBITRARY and name.startswith("mag_")):
            description = self.description or (known.description if known else "")
            column = Column(name, self.unit, "int64" if plain else "float64", description)
            return column, float(scale), float(self.offset)
        if known.dtype == "int64":
            if not plain:
                raise ValueError(f"{name} is a plain integer: no scale, offset or unit, and an integer type")
            return known, 1.0, 0.0
        factor, zero = exact_conversion(self.unit, known.unit)
        return known, float(factor * scale), float(factor * _fraction(self.offset) + zero)


class PacketField(NumberField):
    """A number at a place of a packet; a mask picks bits of an unsigned one and shifts them down to bit 0."""

    at: NonNegativeInt
    byte_order: ByteOrder | None = None
    mask: PositiveInt | None = None
    when: When | None = None

    @property
    def end(self) -> int:
        """First byte behind the field."""
        return self.at + NUMBER_TYPES[self.type].size * len(self.names)

    @property
    def bits(self) -> int:
        """Bits of the number that count."""
        return super().bits if self.mask is None else self.mask.bit_count()

    @model_validator(mode="after")
    def _mask_fits(self) -> Self:
        if self.mask is not None:
            if NUMBER_TYPES[self.type].signed:
                raise ValueError(f"a mask needs an unsigned type, not {self.type}")
            if self.mask >= 1 << super().bits:
                raise ValueError(f"mask {self.mask:#x} is wider than {self.type}")
        return self


def distinct_names(fields: Sequence[NumberField]) -> list[str]:
    """Return the columns of the fields; raises ValueError where one is there twice."""
    names = [name for field in fields for name in field.names]
    for number, field in enumerate(fields):
        if twice := [name for name in field.names if names.count(name) > 1]:
            raise ValueError(f"fields[{number}]: column {twice[0]} is there twice")
    return names


def timing_of(fields: Sequence[NumberField]) -> Timing:
    """Return how a device counts time; of several counters or clocks the last counts."""
    by_name = {name: field for field in fields for name in field.names}
    counter, ticks = by_name.get("packet_counter"), by_name.get("device_ticks")
    counter_bits = counter.bits if counter else None
    if ticks is None:
        return Timing(counter_bits)
    if NUMBER_TYPES[ticks.type].integer:
        return Timing(counter_bits, ticks.scale * exact_conversion(ticks.unit, "ns")[0], ticks.bits)
    return Timing(counter_bits, Fraction(1))


class Packet(StrictModel):
    """Layout of a packet; `tail` may follow it, and belongs to it when it does."""

    name: str = Field(default="", pattern=r"^[a-z0-9_]*$")
    length: PositiveInt = Field(le=LONGEST_PACKET)
    byte_order: ByteOrder
    sync: list[Byte] = Field(min_length=1, max_length=8)
    length_field: LengthField | None = None
    checksum: ChecksumField
    tail: list[Byte] = Field(default=[], max_length=8)
    fields: list[PacketField] = Field(min_length=1)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if len(self.sync) >= self.length:
            raise ValueError(f"{len(self.sync)} sync bytes do not fit into {self.length} bytes")
        length, check = self.length_field, self.checksum
        spans = [(f"fields[{k}] ({', '.join(f.names)})", f.at, f.end) for k, f in enumerate(self.fields)]
        if length is not None:
            size = NUMBER_TYPES[length.type].size
            spans.append(("length_field", length.at, length.at + size))
            if length.value >= 1 << (8 * size):
                raise ValueError(f"length_field: {length.value} does not fit {length.type}")
        if check.type != "none":
            spans.append(("checksum", check.at, check.at + Checksum(check.type).size))
            spans.append(("checksum", check.first, check.last + 1))
            if check.first <= check.at <= check.last:
                raise ValueError(
                    f"checksum: covers itself (bytes {check.first} to {check.last}, at {check.at})"
                )
        for what, start, stop in spans:
            if start >= stop or stop > self.length:
                raise ValueError(
                    f"{what}: bytes {start} to {stop - 1} are outside the packet of {self.length} bytes"
                )
        names = distinct_names(self.fields)
        for number, field in enumerate(self.fields):
            if field.when is not None and field.when.column not in names:
                raise ValueError(f"fields[{number}]: when: there is no column {field.when.column}")
        return self

    @property
    def numbers(self) -> list[Number]:
        """All numbers of the packet in the order of the file."""
        return [
            Number(
                column,
                field.type,
                scale,
                offset,
                field.mask or 0,
                at=field.at + k * NUMBER_TYPES[field.type].size,
                group=MAIN,
                big=(field.byte_order or self.byte_order) == "big",
                when=(w.column, w.modulo, w.equals) if (w := field.when) else None,
            )
            for field in self.fields
            for k, (column, scale, offset) in enumerate(map(field.scaled, field.names))
        ]

    @property
    def length_bytes(self) -> list[tuple[int, int]]:
        """Places and values of the bytes of the length."""
        field = self.length_field
        if field is None:
            return []
        size = NUMBER_TYPES[field.type].size
        return [*enumerate(field.value.to_bytes(size, field.byte_order or self.byte_order), field.at)]

    @property
    def check(self) -> Checksum | None:
        """The checksum, if there is one."""
        field = self.checksum
        if field.type == "none":
            return None
        big = (field.byte_order or self.byte_order) == "big"
        return Checksum(field.type, field.first, big, field.zeros, end=field.last + 1, at=field.at)


def fixed_decoder(name: str, packets: Sequence[Packet]) -> Decoder:
    """Return a decoder of packets; `name` is what one without a name is called in the counters."""
    frames = [
        Frame({bytes(x.sync): x.name or name}, partial(_length, x), x.check, bytes(x.tail)) for x in packets
    ]
    timing = timing_of([field for packet in packets[::-1] for field in packet.fields])  # the first one's
    layouts = [Record(packet.numbers) for packet in packets]
    groups = Groups.of([layout.group_of for layout in layouts]) if len(packets) > 1 else None
    return Decoder(frames, timing, groups, layouts=layouts, remarks=[*_overlaps(packets)])


def _overlaps(packets: Sequence[Packet]) -> Iterator[str]:
    """Yield a warning for fields that share bytes; bits, and what is only in some packets, may do so."""
    for packet in packets:
        whole = sorted((f for f in packet.fields if not (f.mask or f.when)), key=lambda f: f.at)
        for a, b in pairwise(whole):
            if b.at < a.end:
                both = f"{', '.join(a.names)} and {', '.join(b.names)} share byte {b.at} of a packet"
                yield f"{both}: is `at` right in the device file?"


def _length(packet: Packet, held: ByteArray, at: IntArray) -> IntArray:
    result = np.full_like(at, packet.length)
    for place, byte in packet.length_bytes:
        agrees = held[np.minimum(at + place, len(held) - 1)] == byte
        result[(at + place < len(held)) & ~agrees] = IMPOSSIBLE
    return result


def _encoded(packet: Packet, block: SampleBlock) -> list[bytes]:
    blank = bytearray(packet.length)
    for at, byte in (*enumerate(packet.sync), *packet.length_bytes):
        blank[at] = byte
    sent = write(packet.name or "packet", packet.numbers, bytes(blank), block.columns, len(block))
    sealed = sent if packet.check is None else packet.check.sealed_rows(sent)
    return [row.tobytes() + bytes(packet.tail) for row in sealed]


class FixedDevice(DeviceFile):
    """A device that sends packets of one fixed length."""

    protocol: Literal["fixed"]
    packet: Packet

    def decoder(self) -> Decoder:
        """Make a decoder for this packet."""
        return fixed_decoder(self.name, [self.packet])

    def encoder(self) -> Encoder:
        """Make an encoder for this packet."""
        return Encoder(partial(_encoded, self.packet))


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
        return fixed_decoder(self.name, self.packets)

    def encoder(self) -> Encoder:
        """Make an encoder for those that are sent."""
        return Encoder(*(partial(_encoded, one) for one in self.packets if one.name in self.sends))
