from __future__ import annotations

import subprocess
import sys
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import ColumnArray, SampleBlock
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_names, load_device
from imumon.protocols.framing import Checksum
from tests.protocols.streams import chunkings, damage, feed_in_chunks
from tests.protocols.test_checksums import CHECK

DEVICES = device_names()
"""Every device, so every family: a new one is tested here by its device file alone."""
device_of = cache(load_device)


def samples(n: int, seed: int = 0) -> SampleBlock:
    rng = np.random.default_rng(seed)
    columns = {f"{what}_{axis}": rng.normal(0, 1, n) for what in ("gyro", "accel", "mag") for axis in "xyz"}
    return SampleBlock({**columns, "device_ticks": np.arange(1, n + 1) * 20_000_000})


def packets_of(family: str, n: int = 60, seed: int = 0) -> list[bytes]:
    return device_of(family).encoder().encode(samples(n, seed))


@pytest.mark.parametrize("name", CHECK)
@pytest.mark.parametrize("big", [False, True])
def test_checks_of_many_packets_agree_with_the_catalogue(name: str, big: bool) -> None:
    size = Checksum(name).size
    value = CHECK[name].to_bytes(size, "big" if big else "little")
    packets = [b"x123456789" + value, b"x12345678" + value, b"y123456789" + value]
    held = np.frombuffer(b"".join(packets), np.uint8)
    length = np.array([len(packet) for packet in packets])
    right = Checksum(name, first=1, big=big)(held, np.cumsum(length) - length, length)
    assert right.tolist() == [True, False, True]


def test_zeros_that_are_not_sent_count() -> None:
    data = b"\x01\x02\x03"
    padded = np.frombuffer(data + bytes(5), np.uint8)
    crc = int(Checksum("crc32-mpeg2").values(padded, np.array([0]), np.array([8]))[0]).to_bytes(4, "big")
    held = np.frombuffer(data + crc, np.uint8)
    one, size = np.array([0]), np.array([7])
    assert Checksum("crc32-mpeg2", big=True, zeros=5)(held, one, size).tolist() == [True]
    assert Checksum("crc32-mpeg2", big=True, zeros=4)(held, one, size).tolist() == [False]


@pytest.mark.parametrize("family", DEVICES)
@given(lengths=chunkings, seed=st.integers(0, 1000))
@settings(max_examples=8, deadline=None)
def test_any_chunking_gives_the_same_packets(family: str, lengths: list[int], seed: int) -> None:
    stream, _ = damage(packets_of(family, seed=seed), np.random.default_rng(seed), 0.1, 0.1, 0.2)
    arrival = [n // 100 * 1_000_000 for n in range(len(stream))]
    device = device_of(family)
    whole, cut = device.decoder(), device.decoder()
    expected = feed_in_chunks(whole, stream, [len(stream)], arrival)
    got = feed_in_chunks(cut, stream, lengths, arrival)
    assert whole.counters() == cut.counters()
    assert list(got.columns) == list(expected.columns)
    for name in expected.columns:
        np.testing.assert_array_equal(got[name], expected[name], err_msg=name)


@pytest.mark.parametrize("family", DEVICES)
@pytest.mark.parametrize("lengths", [[1], [13], [65536]])
def test_no_intact_packet_is_lost_on_a_damaged_stream(family: str, lengths: list[int]) -> None:
    packets = packets_of(family, 40 if lengths == [1] else 400)
    stream, whole = damage(packets, np.random.default_rng(5), 0.1, 0.1, 0.2)
    device = device_of(family)
    block = feed_in_chunks(device.decoder(), stream, lengths)
    every = feed_in_chunks(device.decoder(), BEFORE + b"".join(packets), [1 << 20])
    name = next(name for name in (*TOLD_BY, *every.columns) if name in every)
    sent = {value.tobytes() for value in there(every[name])[whole]}
    assert sent <= {value.tobytes() for value in there(block[name])}


BEFORE = b"\r\n"
"""Of text without prefix the line counts only that begins behind a line end."""
TOLD_BY = ("accel_x", "gyro_x", "yaw", "heading")
"""Columns that tell the samples apart."""


def there(values: ColumnArray) -> ColumnArray:
    """Return the values that are not missing."""
    return values[~np.isnan(values)]


@pytest.mark.parametrize("name", DEVICES)
def test_every_sample_is_a_row_of_the_pipeline(name: str) -> None:
    device = device_of(name)
    pipeline = Pipeline(device, [])
    for k, packet in enumerate(device.encoder().encode(samples(60))):
        pipeline.feed(packet, (k + 1) * 10_000_000)
    pipeline.finish()
    # Of text without prefix the first line does not count; WitMotion and others complete a row by the next.
    assert 59 <= len(pipeline.take()) <= 60


@pytest.mark.parametrize("family", DEVICES)
@given(data=st.binary(max_size=600), seed=st.integers(0, 1000))
@settings(max_examples=12, deadline=None)
def test_rubbish_between_packets_is_no_harm(family: str, data: bytes, seed: int) -> None:
    rng = np.random.default_rng(seed)
    packets = packets_of(family, 5)
    mutated = bytearray(b"".join(packets))
    for place in rng.integers(len(mutated), size=8):
        mutated[place] = int(rng.integers(256))
    decoder = device_of(family).decoder()
    block = feed_in_chunks(decoder, bytes(mutated) + data + b"".join(packets) + data, [31])
    assert len(block) >= len(packets) - 1


FRAMED = """
import sys
import numpy as np
import imumon.protocols.epochs  # has kernels
from imumon.blocks import SampleBlock
from imumon.protocols.device import device_names, load_device
from imumon.protocols.decoder import Decoder
for name in device_names():
    device = load_device(name)
    decoder = device.decoder()
    if isinstance(decoder, Decoder):
        decoder.feed(b"".join(device.encoder().encode(SampleBlock({"gyro_x": np.ones(3)}))), 0)
        decoder.take_packets(), decoder.counters()
        print(name)
modules = [module for name, module in sys.modules.items() if name.startswith("imumon")]
kernels = {k for module in modules for k in vars(module).values() if hasattr(k, "nopython_signatures")}
assert kernels
sys.exit(", ".join(sorted(k.__name__ for k in kernels if k.signatures)))
"""


def test_what_is_framed_by_numpy_compiles_nothing() -> None:
    done = subprocess.run([sys.executable, "-c", FRAMED], capture_output=True, text=True, check=False)
    assert done.stderr.strip() == ""
    assert {"vectornav", "witmotion", "sbg", "stim300", "ximu3"} <= set(done.stdout.split())
