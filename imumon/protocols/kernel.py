"""What all decoders share: the types of numbers, and the bytes that are held from chunk to chunk."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import IntArray
from imumon.compiled import njit
from imumon.protocols.base import DATED, HELD, RECEIVED, ByteArray

U8, I8, U16, I16, U24, I24, U32, I32, U64, I64, F32, F64, FP1632 = range(13)


@dataclass(frozen=True, slots=True)
class NumberType:
    """How a number is laid out: kernel code, bytes, and whether it is an integer."""

    code: int
    size: int
    integer: bool
    signed: bool


NUMBER_TYPES: dict[str, NumberType] = {
    "u8": NumberType(U8, 1, True, False),
    "i8": NumberType(I8, 1, True, True),
    "u16": NumberType(U16, 2, True, False),
    "i16": NumberType(I16, 2, True, True),
    "u24": NumberType(U24, 3, True, False),
    "i24": NumberType(I24, 3, True, True),
    "u32": NumberType(U32, 4, True, False),
    "i32": NumberType(I32, 4, True, True),
    "u64": NumberType(U64, 8, True, False),
    "i64": NumberType(I64, 8, True, True),
    "f32": NumberType(F32, 4, False, True),
    "f64": NumberType(F64, 8, False, True),
    # Xsens: 32 bits of fraction, then 16 bits of integer part, together a 48-bit two's complement number.
    "fp1632": NumberType(FP1632, 6, False, True),
}
"""Number types by the name that device files use.  u64 above 2**63-1 wraps to negative."""


@njit
def append_chunk(chunk: ByteArray, held: ByteArray, state: IntArray) -> int:
    """Put a chunk behind the held bytes; return how many bytes there are to scan."""
    start = np.uint64(state[HELD])
    # A loop becomes a memory copy; an assignment to a slice is done byte by byte, ten times slower.
    for i in range(np.uint64(len(chunk))):
        held[start + i] = chunk[i]
    state[RECEIVED] += len(chunk)
    state[HELD] += len(chunk)
    return int(state[HELD])


@njit(inline="always")
def arrival_of(at: int, arrival_ns: int, held_arrival: IntArray, state: IntArray) -> int:
    """Return when the held byte at this place arrived; `arrival_ns` is that of the chunk being scanned."""
    return int(held_arrival[at]) if at < state[DATED] else arrival_ns


@njit
def keep_rest(
    start: int, arrival_ns: int, held: ByteArray, held_arrival: IntArray, state: IntArray, rows_full: bool
) -> None:
    """Move the bytes from `start` on to the front, with their arrival times.

    When the rows are full the rest may be longer than a packet, and the same chunk is scanned again at once:
    then only the arrival times of earlier chunks are kept, the others are still those of the chunk.
    """
    rest = state[HELD] - start
    dated = max(state[DATED] - start, 0)
    for i in range(dated):
        held_arrival[i] = held_arrival[start + i]
    for i in range(rest):
        held[i] = held[start + i]
    if not rows_full:
        # A loop, as an assignment to a slice takes a second more to compile.
        for i in range(dated, rest):
            held_arrival[i] = arrival_ns
        dated = rest
    state[HELD] = rest
    state[DATED] = dated
