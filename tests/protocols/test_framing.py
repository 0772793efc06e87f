from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import SampleBlock
from imumon.protocols.checksums import CRCS
from imumon.protocols.device import load_device
from imumon.protocols.framing import CyclicCheck, Sum
from tests.protocols.streams import chunkings, damage, feed_in_chunks

FAMILIES = ("vectornav", "witmotion")
CHECK_VALUES = {
    "crc16-arc": 0xBB3D, "crc16-modbus": 0x4B37, "crc16-xmodem": 0x31C3, "crc16-ccitt-false": 0x29B1,
    "crc16-aug-ccitt": 0xE5CC, "crc16-genibus": 0xD64E, "crc16-kermit": 0x2189, "crc16-x25": 0x906E,
    "crc32": 0xCBF43926, "crc32-mpeg2": 0x0376E6E7, "crc32c": 0xE3069283,
}  # fmt: skip
"""What each CRC makes of "123456789", from the catalogue."""


def samples(n: int, seed: int = 0) -> SampleBlock:
    rng = np.random.default_rng(seed)
    columns = {f"{what}_{axis}": rng.normal(0, 1, n) for what in ("gyro", "accel", "mag") for axis in "xyz"}
    return SampleBlock({**columns, "device_ticks": np.arange(1, n + 1) * 20_000_000})


def packets_of(family: str, n: int = 60, seed: int = 0) -> list[bytes]:
    return load_device(family).encoder().encode(samples(n, seed))


@pytest.mark.parametrize("name", CHECK_VALUES)
@pytest.mark.parametrize("big", [False, True])
def test_crcs_have_the_check_values_of_the_catalogue(name: str, big: bool) -> None:
    crc, order = CRCS[name], "big" if big else "little"
    value = CHECK_VALUES[name].to_bytes(crc.width // 8, "big" if big else "little")
    assert order
    packets = [b"x123456789" + value, b"x12345678" + value, b"y123456789" + value]
    held = np.frombuffer(b"".join(packets), np.uint8)
    length = np.array([len(packet) for packet in packets])
    right = CyclicCheck(crc, first=1, big=big)(held, np.cumsum(length) - length, length)
    assert right.tolist() == [True, False, True]


def test_sums_of_bytes() -> None:
    held = np.frombuffer(bytes([200, 100, 44, 200, 100, 212, 200, 100, 44, 1]), np.uint8)
    assert Sum()(held, np.array([0, 3]), np.array([3, 3])).tolist() == [True, False]
    assert Sum(negated=True)(held, np.array([0, 3]), np.array([3, 3])).tolist() == [False, True]
    assert Sum(size=2)(held, np.array([6]), np.array([4])).tolist() == [True]


@pytest.mark.parametrize("family", FAMILIES)
@given(lengths=chunkings, seed=st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_any_chunking_gives_the_same_packets(family: str, lengths: list[int], seed: int) -> None:
    stream, _ = damage(packets_of(family, seed=seed), np.random.default_rng(seed), 0.1, 0.1, 0.2)
    arrival = [n // 100 * 1_000_000 for n in range(len(stream))]
    device = load_device(family)
    whole, cut = device.decoder(), device.decoder()
    expected = feed_in_chunks(whole, stream, [len(stream)], arrival)
    got = feed_in_chunks(cut, stream, lengths, arrival)
    assert whole.counters() == cut.counters()
    assert list(got.columns) == list(expected.columns)
    for name in expected.columns:
        np.testing.assert_array_equal(got[name], expected[name], err_msg=name)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("lengths", [[1], [13], [997], [65536]])
def test_no_intact_packet_is_lost_on_a_damaged_stream(family: str, lengths: list[int]) -> None:
    packets = packets_of(family, 120 if lengths == [1] else 1500)
    stream, whole = damage(packets, np.random.default_rng(5), 0.1, 0.1, 0.2)
    decoder = load_device(family).decoder()
    block = feed_in_chunks(decoder, stream, lengths)
    x = packets_of(family, len(packets))
    alone = load_device(family).decoder()
    alone.feed(b"".join(x), 0)
    alone.finish()
    every = alone.take()
    sent = {value.tobytes() for value in every["accel_x"][~np.isnan(every["accel_x"])][whole]}
    got = {value.tobytes() for value in block["accel_x"][~np.isnan(block["accel_x"])]}
    assert sent <= got


@pytest.mark.parametrize("family", FAMILIES)
@given(data=st.binary(max_size=600), seed=st.integers(0, 1000))
@settings(max_examples=100, deadline=None)
def test_rubbish_between_packets_is_no_harm(family: str, data: bytes, seed: int) -> None:
    rng = np.random.default_rng(seed)
    packets = packets_of(family, 5)
    mutated = bytearray(b"".join(packets))
    for place in rng.integers(len(mutated), size=8):
        mutated[place] = int(rng.integers(256))
    decoder = load_device(family).decoder()
    block = feed_in_chunks(decoder, bytes(mutated) + data + b"".join(packets) + data, [31])
    assert len(block) >= len(packets) - 1
