"""Numbers in packets: how they are read and written, their columns, and what is computed of them."""

from collections.abc import Callable, Collection, Sequence
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, Columns, FloatArray, IntArray, missing
from imumon.columns import KNOWN, Column
from imumon.errors import bad_data

from .base import COMMON, NO_GROUP, ByteArray
from .framing import Found, integers, windows


class NumberType(NamedTuple):
    """How a number is laid out: its bytes, whether it is an integer, and whether it has a sign."""

    size: int
    integer: bool
    signed: bool

    @property
    def range(self) -> tuple[int, int]:
        """The least and the largest integer."""
        bits = 8 * self.size
        return (-(1 << (bits - 1)), (1 << (bits - 1)) - 1) if self.signed else (0, (1 << bits) - 1)


NUMBER_TYPES = {
    f"{letter}{bits}": NumberType(bits // 8, integer=letter != "f", signed=letter != "u")
    for letter, widths in {"u": (8, 16, 24, 32, 64), "i": (8, 16, 24, 32, 64), "f": (32, 64)}.items()
    for bits in widths
}
"""Number types by the name that device files use."""
# Xsens, most significant byte first: 32 bits of fraction, then 16 of integer part; 48 in two's complement.
NUMBER_TYPES["fp1632"] = NumberType(6, integer=False, signed=True)

WRAPPING = ("packet_counter", "device_ticks")  # columns of which only the low bits are sent


class Derived(NamedTuple):
    """Columns computed from others (a time from a date, a quaternion from a matrix)."""

    sources: tuple[str, ...]
    results: tuple[Column, ...]
    decode: Callable[[Columns], list[ColumnArray]]
    encode: Callable[[Columns], list[ColumnArray]] | None = None
    """Returns the others, for virtual devices; without it they are sent as zero."""

    @property
    def names(self) -> list[str]:
        """Names of the results."""
        return [column.name for column in self.results]


class Number(NamedTuple):
    """A number of a packet: its column (None: passed over) is number * factor + offset."""

    column: Column | None
    type: str
    factor: float = 1.0
    offset: float = 0.0
    mask: int = 0  # bits that count, of which the lowest becomes bit 0; 0: all
    at: int = 0  # first byte
    group: str = NO_GROUP
    big: bool = False  # whether the most significant byte comes first
    when: tuple[str, int, int] | None = None
    """Counter, divisor, remainder: it is there only where the counter, divided, leaves this; None: always."""

    @property
    def name(self) -> str:
        """Name of the column."""
        return "" if self.column is None else self.column.name

    @property
    def end(self) -> int:
        """First byte behind the number."""
        return self.at + NUMBER_TYPES[self.type].size

    def read(self, raw: ColumnArray) -> ColumnArray:
        """Return the column of what the field of a record has."""
        kind = NUMBER_TYPES[self.type]
        assert self.column is not None
        if kind.size == 3:
            raw = _of_bytes(raw, self.big, kind.signed)
        elif self.type == "fp1632":
            raw = _of_bytes(raw[:, [4, 5, 0, 1, 2, 3]], big=True, signed=True) / 2.0**32
        if self.mask:
            raw = (raw.astype(np.uint64) & np.uint64(self.mask)) // np.uint64(self.mask & -self.mask)
        if self.column.dtype == "int64" and kind.integer:
            whole = raw.astype(np.int64) * int(self.factor) + int(self.offset)
            if kind.signed or self.name in WRAPPING:
                return whole
            return np.where(whole < 0, NO_INT, whole)  # more than a column of integers holds
        with np.errstate(invalid="ignore"):  # a signalling NaN becomes a quiet one
            numbers: FloatArray = raw.astype(np.float64)
            if self.factor != 1.0:
                numbers *= self.factor
            if self.offset:
                numbers += self.offset
            # A clock that is not a number becomes the least integer.
            return numbers if self.column.dtype == "float64" else np.rint(numbers).astype(np.int64)


def _of_bytes(raw: ColumnArray, big: bool, signed: bool) -> IntArray:
    """Return integers of bytes, (n, size)."""
    n, size = raw.shape
    whole = integers(raw.reshape(-1), np.arange(n) * size, size, big)
    is_negative = whole >> (8 * size - 1)
    return whole - (is_negative << 8 * size) if signed else whole


def is_missing(values: ColumnArray) -> BoolArray:
    """Return which values are missing."""
    return np.isnan(values) if values.dtype.kind == "f" else values == NO_INT


def write(what: str, numbers: Sequence[Number], blank: bytes, columns: Columns, n: int) -> ByteArray:
    """Return n packets with these numbers, (n, size); what no column gives is as in `blank`.

    Raises BAD_DATA when a value does not fit; `what` is what the packets are called in it.
    """
    packets = np.tile(np.frombuffer(blank, np.uint8), (n, 1))
    for item in numbers:
        if item.name in columns:
            values = columns[item.name]
            if item.when is not None and item.when[0] in columns:
                counter, divisor, remainder = item.when
                there = columns[counter] % divisor == remainder
                values = np.where(there, values, item.offset)  # sent as zero
            most_first = _packed(f"{what}, column {item.name}", item, values)
            # Added bit by bit: the masks of several numbers may share bytes.
            packets[:, item.at : item.end] |= most_first if item.big else most_first[:, ::-1]
    return packets


def _packed(where: str, item: Number, values: ColumnArray) -> ByteArray:
    """Return the bytes of a number, most significant first, (n, size)."""
    size = NUMBER_TYPES[item.type].size
    if item.type in ("f32", "f64"):
        real = (values - item.offset) / item.factor
        if size == 4:
            _refuse(np.isfinite(real) & (np.abs(real) > np.finfo(np.float32).max), real, where)
        return real.astype(f">f{size}").view(np.uint8).reshape(-1, size)
    most_first = _raw(where, item, values).astype(">i8").view(np.uint8).reshape(-1, 8)[:, 8 - size :]
    # The fraction of fp16.32 goes before the integer part.
    return most_first[:, [2, 3, 4, 5, 0, 1]] if item.type == "fp1632" else most_first


def _raw(where: str, item: Number, values: ColumnArray) -> IntArray:
    """Return the integers that are sent for these values, in the bits of the mask; zero for missing ones."""
    raw = np.where(is_missing(values), item.offset if values.dtype.kind == "f" else 0, values)
    if raw.dtype.kind == "f" or (item.factor, item.offset) != (1.0, 0.0):
        scaled = (raw - item.offset) / item.factor * (2.0**32 if item.type == "fp1632" else 1.0)
        _refuse(~np.isfinite(scaled) | (np.abs(scaled) > 2.0**62), raw, where)  # int64 ends at 2**63
        raw = np.rint(scaled).astype(np.int64)
    lowest_bit = item.mask & -item.mask if item.mask else 1
    if item.name not in WRAPPING:
        low, high = (0, item.mask // lowest_bit) if item.mask else NUMBER_TYPES[item.type].range
        _refuse((raw < low) | (raw > high), raw, where)
    return (raw * lowest_bit) & item.mask if item.mask else raw


def _refuse(bad: BoolArray, numbers: ColumnArray, where: str) -> None:
    if np.any(bad):
        raise bad_data(
            f"{where}: {numbers[np.argmax(bad)]} does not fit ({np.sum(bad)} of {len(bad)} values)",
            "choose a wider number format or a larger scale, or leave the column out",
        )


def with_sources(
    columns: Columns, derived: Sequence[Derived], sent: Collection[str]
) -> dict[str, ColumnArray]:
    """Return the columns, and those from which others are computed, as far as they are sent."""
    found = dict(columns)
    for made in derived:
        if made.encode is not None and {*made.sources} <= {*sent} and {*made.names} <= columns.keys():
            found |= dict(zip(made.sources, made.encode(columns), strict=True))
    return found


class Record:
    """A layout of numbers that stand at the same places in every packet.

    `numbers`: of several for one column the last counts.
    `derived`: columns that are computed from others, which have names that begin with "_".
    """

    def __init__(self, numbers: Sequence[Number], derived: Sequence[Derived] = ()) -> None:
        last = {item.name: item for item in numbers if item.column is not None}
        self._numbers = [*last.values()]
        self._derived = [made for made in derived if last.keys() >= {*made.sources}]
        grouped = [item for item in self._numbers if item.group and item.name not in COMMON]
        self.group_of = {item.name: item.group for item in grouped}
        sent = [item.column for item in self._numbers if item.column is not None]
        for made in self._derived:
            sent += made.results
            if made.sources[0] in self.group_of:  # the first decides for all
                self.group_of |= dict.fromkeys(made.names, self.group_of[made.sources[0]])
        self.columns = tuple(column for column in sent if not column.name.startswith("_"))

    @cached_property
    def _type(self) -> np.dtype[np.void]:
        """The packet, up to its last number, as a structured type; numbers that NumPy lacks as bytes."""
        formats: list[tuple[str, int] | str] = []
        for item in self._numbers:
            kind = NUMBER_TYPES[item.type]
            plain = f"{'>' if item.big else '<'}{item.type[0]}{kind.size}"
            formats.append(("u1", kind.size) if kind.size in (3, 6) else plain)
        names, offsets = [item.name for item in self._numbers], [item.at for item in self._numbers]
        size = max((item.end for item in self._numbers), default=1)
        return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})

    def read(self, found: Found) -> dict[str, ColumnArray]:
        """Return a value a packet for each column."""
        records = windows(found.held, found.at, self._type.itemsize).view(self._type)[:, 0]
        columns = {item.name: item.read(records[item.name]) for item in self._numbers}
        for item in self._numbers:
            if item.when is not None:
                counter, divisor, remainder = item.when
                absent = columns[counter] % divisor != remainder
                columns[item.name][absent] = missing(1, columns[item.name].dtype)
        for made in self._derived:
            for name, values in zip(made.names, made.decode(columns), strict=True):
                sent = columns.get(name)
                columns[name] = values if sent is None else np.where(is_missing(sent), values, sent)
        return columns


DATE_PARTS = ("of_second", "year", "month", "day", "hour", "minute", "second")

_VECTORS = {base: tuple(f"{base}_{axis}" for axis in "xyz") for base in ("accel", "gyro", "mag")} | {
    "q": ("q_w", "q_x", "q_y", "q_z"),
    "angles": ("roll", "pitch", "yaw"),
    "place": ("latitude", "longitude", "altitude"),
}
"""Canonical columns that come together."""


def known(*names: str) -> tuple[Column, ...]:
    """Look up canonical columns; accel, gyro, mag, q, angles and place are several."""
    return tuple(KNOWN[column] for name in names for column in _VECTORS.get(name, (name,)))


MATRIX = tuple(f"_matrix_{i}{j}" for i in "123" for j in "123")
"""Columns of a rotation matrix, reference to body."""


def _parts_to_time(prefix: str, per_s: int, columns: Columns) -> list[ColumnArray]:
    """Make a Unix time of a date; missing when it cannot be (zeros before a fix) or int64 ends, in 2262."""
    rest, year, month, day, hour, minute, second = (columns[f"_{prefix}{part}"] for part in DATE_PARTS)
    good = (year > 1900) & (year < 2262) & (month >= 1) & (month <= 12) & (day >= 1) & (day <= 31)
    months = np.where(good, (year - 1970) * 12 + month - 1, 0).astype("datetime64[M]")
    days = months.astype("datetime64[D]").astype(np.int64) + day - 1
    seconds = days * 86_400 + hour * 3600 + minute * 60 + second
    return [np.where(good, seconds * per_s + rest, NO_INT)]


def utc_time(prefix: str, result: Column, per_s: int = 1_000_000_000) -> Derived:
    """Derive a time, so many counts a second, from the hidden columns of a calendar date."""
    sources = tuple(f"_{prefix}{part}" for part in DATE_PARTS)
    return Derived(sources, (result,), partial(_parts_to_time, prefix, per_s))


def _matrix_to_quaternion(columns: Columns) -> list[ColumnArray]:
    """Convert the matrix reference to body, row by row, to the quaternion body to reference (Shepperd)."""
    m11, m12, m13, m21, m22, m23, m31, m32, m33 = (columns[name] for name in MATRIX)
    squares = np.stack([1 + m11 + m22 + m33, 1 + m11 - m22 - m33, 1 - m11 + m22 - m33, 1 - m11 - m22 + m33])
    # Element i, j is 4 q_i q_j: the row of the largest q_i, divided by 4 q_i = 2 sqrt(4 q_i q_i), is q.
    products = np.array([
        [squares[0], m23 - m32, m31 - m13, m12 - m21], [m23 - m32, squares[1], m12 + m21, m13 + m31],
        [m31 - m13, m12 + m21, squares[2], m23 + m32], [m12 - m21, m13 + m31, m23 + m32, squares[3]],
    ])  # fmt: skip
    largest = np.argmax(np.nan_to_num(squares), axis=0)
    row = products[largest, :, np.arange(len(m11))].T
    with np.errstate(all="ignore"):  # what is not a rotation becomes NaN
        quaternion = row / (2 * np.sqrt(np.max(squares, axis=0)))
    quaternion = np.where(np.isfinite(quaternion).all(axis=0), quaternion, np.nan)
    quaternion = np.where(quaternion[0] < 0, -quaternion, quaternion)
    return list(quaternion)


FROM_MATRIX = Derived(MATRIX, known("q"), _matrix_to_quaternion)
