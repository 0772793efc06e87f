from __future__ import annotations

import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.protocols.framing import CHECKSUM_NAMES, CRCS, Checksum

# Check values of the CRC catalogue (over the ASCII digits 1 to 9), and sums worked out by hand.
CHECK = {
    "crc16-arc": 0xBB3D, "crc16-modbus": 0x4B37, "crc16-xmodem": 0x31C3, "crc16-ccitt-false": 0x29B1,
    "crc16-aug-ccitt": 0xE5CC, "crc16-genibus": 0xD64E, "crc16-kermit": 0x2189, "crc16-x25": 0x906E,
    "crc32": 0xCBF43926, "crc32-mpeg2": 0x0376E6E7, "crc32c": 0xE3069283,
    "sum8": 0xDD, "sum8-negated": 0x23, "xor8": 0x31, "sum16": 0x01DD, "fletcher16": 0x1EDE,
    "fletcher16-256": 0x15DD, "crc16-mcrf4xx": 0x6F91, "sum16-words-le": 0xD509, "sum16-words-be": 0x09D4,
}  # fmt: skip


def compute(name: str, data: bytes) -> int:
    buf = np.frombuffer(b"xx" + data + b"yy", np.uint8)
    return int(Checksum(name).values(buf, np.array([2]), np.array([2 + len(data)]))[0])


def bitwise_crc(name: str, data: bytes) -> int:
    """The definition of a CRC, one bit at a time, in its own width."""
    crc = CRCS[name]
    register, top, mask = crc.initial, 1 << (crc.width - 1), (1 << crc.width) - 1
    for byte in data:
        bits = range(8) if crc.reflected else range(7, -1, -1)
        for bit in bits:
            feedback = bool(register & top) != bool(byte >> bit & 1)
            register = (register << 1) & mask ^ (crc.polynomial if feedback else 0)
    if crc.reflected:
        register = int(f"{register:0{crc.width}b}"[::-1], 2)
    return register ^ crc.final_xor


def test_every_checksum_has_a_check_value() -> None:
    assert set(CHECK) | {"none"} == set(CHECKSUM_NAMES)


@pytest.mark.parametrize("name", CHECK)
def test_check_values(name: str) -> None:
    assert compute(name, b"123456789") == CHECK[name]


def test_the_manual_has_the_parameters_and_check_values_of_all() -> None:
    page = Path(__file__).parents[2] / "docs" / "device-files.md"
    lines = page.read_text(encoding="utf-8").splitlines()
    rows = {
        cells[1].strip("`"): cells[2:-1] for x in lines if len(cells := x.replace(" ", "").split("|")) > 4
    }
    for name, value in CHECK.items():
        assert int(rows[name][-1], 16) == value
    for name, crc in CRCS.items():
        polynomial, initial, reflected, final_xor, _ = rows[name]
        numbers = [int(text, 16) for text in (polynomial, initial, final_xor)]
        assert numbers == [crc.polynomial, crc.initial, crc.final_xor]
        assert reflected == ("yes" if crc.reflected else "no")


@pytest.mark.parametrize("name", CRCS)
@given(data=st.binary(max_size=70))
def test_crc_equals_its_definition(name: str, data: bytes) -> None:
    assert compute(name, data) == bitwise_crc(name, data)


@given(data=st.binary(max_size=3000))
def test_crc32_equals_zlib(data: bytes) -> None:
    assert compute("crc32", data) == zlib.crc32(data)


@given(data=st.binary(max_size=3000), modulus=st.sampled_from([("fletcher16", 255), ("fletcher16-256", 256)]))
def test_fletcher_equals_its_recursion(data: bytes, modulus: tuple[str, int]) -> None:
    name, m = modulus
    low = high = 0
    for byte in data:
        low = (low + byte) % m
        high = (high + low) % m
    assert compute(name, data) == high << 8 | low


@given(data=st.binary(max_size=3000))
def test_sums_equal_their_definition(data: bytes) -> None:
    assert compute("sum8", data) == sum(data) % 256
    assert compute("sum16", data) == sum(data) % 65536
    assert (compute("sum8-negated", data) + sum(data)) % 256 == 0


def test_without_an_end_a_checksum_in_the_middle_covers_what_is_before_it() -> None:
    check = Checksum("sum8", first=1, at=4)
    packet = check.sealed(bytes([9, 1, 2, 3, 0, 50]))
    assert packet == bytes([9, 1, 2, 3, 6, 50])
    assert check(np.frombuffer(packet, np.uint8), np.array([0]), np.array([6])).all()
