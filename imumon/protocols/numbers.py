"""The types of numbers in packets."""

from __future__ import annotations

from dataclasses import dataclass

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
