"""Lines of text, as most boards of hobbyists send them, described by a device file.

A line is numbers between separators, pairs of key and number, or JSON; it may begin with a prefix and end
with a checksum as NMEA has it.  A line counts when it has exactly the numbers that are described and all are
finite: there is mostly no checksum, and a torn line must not become a sample.  So the first line of a stream
without prefix, whose beginning is not known, does not count.
"""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache, partial, reduce
from itertools import chain
from math import isfinite
from operator import xor
from typing import Any, Literal, Self

import numpy as np
from pydantic import Field, NonNegativeInt, PositiveInt, model_validator

from imumon.blocks import BoolArray, IntArray, SampleBlock
from imumon.config import StrictModel

from .base import MAIN, ByteArray, Encoder, Groups, Timing, chosen
from .decoder import Decoder
from .device import DeviceFile
from .fixed import NumberField, NumberName, distinct_names, timing_of
from .framing import IMPOSSIBLE, INCOMPLETE, Checksum, Found, Frame
from .numbers import NUMBER_TYPES, WRAPPING, Number, Record, is_missing

LINE_END = 0x0A
MOST_LINES = 1 << 14  # lines of which the numbers are remembered: those of a search of 64 KiB and more
LONGEST_LINE = 1024  # bytes of a line that is believed; more is binary data
HEXADECIMAL = re.compile("[0-9A-Fa-f]{2}|[0-9A-Fa-f]{4}")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


class TextField(NumberField):
    """Numbers at a place of a line: `at` counts from 0; `key` is that of a pair, or a path as ``gyro.0``.

    Of several columns, the first is at `at`, or has the key with ".0" behind it.
    """

    type: NumberName = "f64"
    at: NonNegativeInt | None = None
    key: str | None = None

    @model_validator(mode="after")
    def _one_place(self) -> Self:
        if (self.at is None) == (self.key is None):
            raise ValueError("give either at: PLACE or key: NAME")
        return self

    @property
    def keys(self) -> list[str | int]:
        """Place or key of each column."""
        if self.at is not None:
            return [self.at + k for k in range(len(self.names))]
        if self.column is not None:
            return [self.key or ""]
        return [f"{self.key}.{k}" for k in range(len(self.names))]


class Line(StrictModel):
    """A kind of line.

    `values` is how many numbers or words it has, `separator` what is between them: " " is any white space.
    """

    name: str = Field(pattern=r"^[a-z0-9_]+$")
    prefix: str = ""
    form: Literal["delimited", "pairs", "json"] = "delimited"
    separator: Literal[",", ";", "\t", " ", "|"] = ","
    decimal: Literal[".", ","] = "."
    checksum: Literal["none", "xor8"] = "none"
    values: PositiveInt | None = None
    fields: list[TextField] = Field(min_length=1)
    __hash__ = object.__hash__  # a line is the key of what was read of it

    @model_validator(mode="after")
    def _places_fit_the_form(self) -> Self:
        place = "at" if self.form == "delimited" else "key"
        if any(getattr(field, place) is None for field in self.fields):
            raise ValueError(f"fields of a {self.form} line need {place}")
        if self.form == "delimited" and self.values is None:
            raise ValueError("values: give how many there are in a line")
        last = max((field.at + len(field.names) for field in self.fields if field.at is not None), default=0)
        if self.values is not None and last > self.values:
            raise ValueError(f"a field is behind the {self.values} values")
        if self.checksum == "xor8" and not self.prefix.startswith("$"):
            raise ValueError("a line with checksum begins with $")
        if self.decimal == self.separator:
            raise ValueError("separator and decimal point are the same")
        distinct_names(self.fields)
        return self

    @property
    def wanted(self) -> list[str | int]:
        """Places or keys of all columns."""
        return [key for field in self.fields for key in field.keys]

    @property
    def numbers(self) -> list[Number]:
        """What each number is in a record of the numbers of a line."""
        scaled = [field.scaled(name) for field in self.fields for name in field.names]
        return [
            Number(column, "f64", factor, zero, at=8 * k, group=MAIN)
            for k, (column, factor, zero) in enumerate(scaled)
        ]

    def read(self, text: str) -> list[float] | None:
        """Return the numbers of a line, in the order of the columns; None when it is not one of these."""
        body = text.strip("\r\n")
        checked = sentence_body(body) if self.checksum == "xor8" else body
        if checked is None or not checked.startswith(self.prefix):
            return None
        try:
            words = self._words(checked[len(self.prefix) :])
            numbers = [self._number(words[key]) for key in self.wanted]
        except (ValueError, LookupError, TypeError, RecursionError):
            return None
        fit = (low <= numbers[k] <= high and numbers[k].is_integer() for k, low, high in self._counts)
        return numbers if all(fit) else None

    @cached_property
    def _counts(self) -> list[tuple[int, int, int]]:
        """Which of the columns are counts of so many bits, and their ranges."""
        columns = [(name, NUMBER_TYPES[field.type]) for field in self.fields for name in field.names]
        return [
            (k, *kind.range) for k, (name, kind) in enumerate(columns) if name in WRAPPING and kind.integer
        ]

    def _words(self, body: str) -> Any:
        """Return what stands at each place or key."""
        if self.form == "json":
            tree = json.loads(body)
            return {key: reduce(_step, str(key).split("."), tree) for key in self.wanted}
        separator = None if self.separator == " " else self.separator
        words = body.split(separator)
        if self.values not in (None, len(words)):
            raise ValueError("another number of values")
        if self.form == "delimited":
            return words
        pairs = (re.split("[:=]", word, maxsplit=1) for word in words)
        return {key.strip(): value for key, value in pairs}

    def _number(self, word: Any) -> float:
        text = str(word).strip().replace(self.decimal, ".")
        if not NUMBER.fullmatch(text) or not isfinite(float(text)):
            raise ValueError("not a finite number")
        return float(text)

    def encode(self, block: SampleBlock) -> list[bytes]:
        """Return the line of each row; see `imumon.protocols.base.Encoder`."""
        table = np.zeros((len(block), len(self.numbers)))
        for k, number in enumerate(self.numbers):
            if number.name in block:
                values = block[number.name]
                table[:, k] = np.where(is_missing(values), 0.0, (values - number.offset) / number.factor)
        for k, low, high in self._counts:
            table[:, k] = (table[:, k] - low) % (high + 1 - low) + low
        return [self._written(row) for row in table.tolist()]

    def _written(self, numbers: Sequence[float]) -> bytes:
        point = "." if self.form == "json" else self.decimal
        words = {
            key: (f"{number:.0f}" if number.is_integer() else f"{number:.12g}").replace(".", point)
            for key, number in zip(self.wanted, numbers, strict=True)
        }
        if self.form == "json":
            body = json.dumps(_tree({str(key): float(word) for key, word in words.items()}))
        elif self.form == "pairs":
            body = self.separator.join(f"{key}:{word}" for key, word in words.items())
        else:
            body = self.separator.join(words.get(k, "0") for k in range(self.values or 0))
        line = self.prefix + body
        return (sentence(line) if self.checksum == "xor8" else line.encode()) + b"\r\n"


def sentence(body: str) -> bytes:
    """Return what begins with `$` with its checksum, as NMEA has it."""
    return f"{body}*{_xor(body):02X}".encode()


def sentence_body(text: str, crc: Checksum | None = None) -> str | None:
    """Return what a sentence has before its checksum (four digits: `crc`), or None when that is wrong."""
    body, star, given = text.rpartition("*")
    if not star or not HEXADECIMAL.fullmatch(given):
        return None
    if len(given) == 2:
        return body if int(given, 16) == _xor(body) else None
    bare = body.encode()
    return body if crc is not None and crc.sealed(bare) == bare + bytes.fromhex(given) else None


def _xor(body: str) -> int:
    return reduce(xor, body[1:].encode(), 0)


def _step(tree: Any, key: str) -> Any:
    return tree[int(key)] if isinstance(tree, list) else tree[key]


def _tree(leaves: dict[str, float]) -> Any:
    """Return the JSON value with these leaves by their paths; keys that are all numbers make a list."""
    if "" in leaves:
        return leaves[""]
    heads = dict.fromkeys(path.partition(".")[0] for path in leaves)
    branches = {
        head: _tree({p.partition(".")[2]: v for p, v in leaves.items() if p.partition(".")[0] == head})
        for head in heads
    }
    return list(branches.values()) if all(head.isdigit() for head in heads) else branches


class TextDecoder(Decoder):
    """Decodes lines as records of their numbers."""

    def __init__(self, lines: Sequence[Line], timing: Timing) -> None:
        self._lines = lines
        frames = [
            line_frame({line.prefix.encode() or b"\n": line.name}, partial(read_once, line)) for line in lines
        ]
        layouts = [Record(line.numbers) for line in lines]
        groups = Groups.of([layout.group_of for layout in layouts])
        super().__init__(frames, timing, groups, layouts=layouts)

    def _plain(self, found: Found) -> Found:
        lines = zip(found.kind.tolist(), texts(found.held, found.at, found.length), strict=True)
        records = [read_once(self._lines[kind], text) or () for kind, text in lines]
        sizes = 8 * np.array([len(record) for record in records], np.int64)
        held = np.array([*chain(*records)], np.float64).view(np.uint8)
        return Found(held, np.cumsum(sizes) - sizes, sizes, found.kind)


def texts(held: ByteArray, at: IntArray, length: IntArray) -> list[str]:
    """Return lines as text."""
    spans = zip(at.tolist(), length.tolist(), strict=True)
    return [held[a : a + n].tobytes().decode("utf-8", "replace") for a, n in spans]


def line_lengths(held: ByteArray, at: IntArray, begins_with_end: bool) -> IntArray:
    """Return the lengths of lines with their line feeds; see `Lengths`.

    `begins_with_end`: without a prefix the sync pattern of a line is the line feed of the one before.
    """
    ends = np.flatnonzero(held == LINE_END)
    k = np.searchsorted(ends, at, "right" if begins_with_end else "left")
    there = k < len(ends)
    result = np.full_like(at, INCOMPLETE)
    result[there] = ends[k[there]] - at[there] + (0 if begins_with_end else 1)
    result[~there & (len(held) - at > LONGEST_LINE)] = IMPOSSIBLE
    result[result > LONGEST_LINE] = IMPOSSIBLE
    return result


def lines_right(read: Callable[[str], object], held: ByteArray, at: IntArray, length: IntArray) -> BoolArray:
    """Return which lines can be read; the `Check` of a frame when `read` is given."""
    return np.array([read(text) is not None for text in texts(held, at, length)], np.bool_)


def line_frame(names: Mapping[bytes, str], read: Callable[[str], object]) -> Frame:
    """Return the frame of lines that are right when they can be read."""
    return Frame(names, partial(line_lengths, begins_with_end=b"\n" in names), partial(lines_right, read))


@lru_cache(MOST_LINES)
def read_once(line: Line, text: str) -> list[float] | None:
    """Return the numbers of a line, which is read when it is checked and again for its numbers."""
    return line.read(text)


class TextDevice(DeviceFile):
    """Device file of a device that sends lines of text; `sends` is for its virtual twin alone."""

    protocol: Literal["text"]
    lines: list[Line] = Field(min_length=1)
    sends: list[str] = Field(default=[], max_length=32)

    def decoder(self) -> Decoder:
        """Make a decoder for these lines; of several kinds that fit one the first counts."""
        fields = [field for line in self.lines for field in line.fields]
        return TextDecoder(self.lines, timing_of(fields))

    def encoder(self) -> Encoder:
        """Make an encoder for the lines that are sent: all when `sends` is empty."""
        there = {line.name: line for line in self.lines}
        return Encoder(*(line.encode for line in chosen(self.sends or [*there], there, "line")))
