from __future__ import annotations

import struct
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, SampleBlock
from imumon.errors import ImumonError
from imumon.protocols.decoder import Decoder
from imumon.protocols.device import load_device, parse_device
from imumon.protocols.fixed import FixedDevice
from tests.data_folder import measured
from tests.protocols.fixed.reference import decode

KITCHEN_SINK = """
format: imumon-device/1
name: sink
title: one field of every type
protocol: fixed
rate_hz: 200
axes: FLU
packet:
  length: 64
  byte_order: little
  sync: [0xFA, 0x01]
  length_field: {at: 2, type: u16, byte_order: big, value: 64}
  checksum: {type: CHECKSUM, first: 0, last: 59, at: 60, byte_order: big}
  fields:
    - {at: 4, type: u8, column: packet_counter}
    - {at: 5, type: i8, column: temperature, scale: 0.5, offset: 20, unit: degC}
    - {at: 6, type: u16, column: flags, mask: 0x0F00}
    - {at: 8, type: i16, byte_order: big, column: gyro_x, scale: 0.01, unit: deg/s}
    - {at: 10, type: u24, column: level}
    - {at: 13, type: i24, byte_order: big, column: gyro_y, scale: 0.001, unit: deg/s}
    - {at: 16, type: i24, column: gyro_z, unit: mrad/s}
    - {at: 19, type: u32, column: device_ticks, scale: 1/32768, unit: s}
    - {at: 23, type: i32, byte_order: big, column: accel_x, scale: 1.0e-6, unit: g}
    - {at: 27, type: u64, column: serial}
    - {at: 35, type: i64, byte_order: big, column: far}
    - {at: 43, type: f32, byte_order: big, column: accel_y, unit: m/s^2}
    - {at: 47, type: f64, column: accel_z, unit: mg}
    - {at: 55, type: u8, column: status}
    - {at: 56, type: u8, column: bit_seven, mask: 0x80}
"""


@cache
def sink(checksum: str = "sum16") -> FixedDevice:
    device = parse_device(KITCHEN_SINK.replace("CHECKSUM", checksum), "sink.yaml")
    assert isinstance(device, FixedDevice)
    return device


@cache
def ax1() -> FixedDevice:
    device = load_device("ax1")
    assert isinstance(device, FixedDevice)
    return device


def sink_block(n: int, seed: int = 0) -> SampleBlock:
    random = np.random.default_rng(seed)

    def whole(low: int, high: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        return random.integers(low, high, n)

    return SampleBlock(
        {
            "packet_counter": np.arange(n),
            "temperature": whole(-128, 128) * 0.5 + 20,
            "flags": whole(0, 16),
            "gyro_x": np.deg2rad(whole(-32768, 32768) * 0.01),
            "level": whole(0, 1 << 24),
            "gyro_y": np.deg2rad(whole(-(1 << 23), 1 << 23) * 0.001),
            "gyro_z": whole(-(1 << 23), 1 << 23) * 1e-3,
            "device_ticks": np.arange(n) * 164 + (1 << 32) - 1000,
            "accel_x": whole(-(1 << 31), 1 << 31) * 1e-6 * 9.80665,
            "serial": whole(0, 1 << 62),
            "far": whole(-(1 << 62), 1 << 62),
            "accel_y": random.normal(size=n).astype(np.float32).astype(np.float64),
            "accel_z": random.normal(size=n),
            "status": whole(0, 256),
            "bit_seven": whole(0, 2),
        }
    )


def run(decoder: Decoder, data: bytes, cuts: list[int], finish: bool = True) -> SampleBlock:
    """Feed data in pieces; byte i arrives at 1000 * (index of its piece + 1)."""
    edges = [0, *sorted(cuts), len(data)]
    for number, (start, stop) in enumerate(pairwise(edges)):
        decoder.feed(data[start:stop], 1000 * (number + 1))
    if finish:
        decoder.finish()
    return decoder.take()


def assert_accounted(decoder: Decoder, received: int) -> None:
    counters = decoder.counters()
    assert counters.bytes_received == received
    assert counters.bytes_in_packets + counters.bytes_skipped + counters.bytes_pending == received
    assert counters.bytes_pending >= 0


def damage(packets: list[bytes], seed: int) -> tuple[bytes, list[int]]:
    """Flip a bit in 1 %, cut 0.5 % short, put junk before 0.5 %; return bytes and the places left intact."""
    random = np.random.default_rng(seed)
    out, intact = bytearray(), []
    for packet in packets:
        fate = random.random()
        if fate < 0.01:
            broken = bytearray(packet)
            broken[random.integers(len(broken))] ^= 1 << random.integers(8)
            out += broken
        elif fate < 0.015:
            out += packet[: random.integers(1, len(packet))]
        else:
            if fate < 0.02:
                out += random.integers(0, 256, random.integers(1, 40), dtype=np.uint8).tobytes()
            intact.append(len(out))
            out += packet
    return bytes(out), intact


@pytest.mark.parametrize(
    "checksum", ["sum16", "fletcher16", "fletcher16-256", "crc16-kermit", "crc32", "none"]
)
def test_every_number_type_survives_encoder_and_decoder(checksum: str) -> None:
    device, block = sink(checksum), sink_block(300)
    decoder = device.decoder()
    out = run(decoder, b"".join(device.encoder().encode(block)), [])
    assert len(out) == 300
    for name, values in block.columns.items():
        sent = values & 0xFF if name == "packet_counter" else values
        sent = sent & 0xFFFFFFFF if name == "device_ticks" else sent
        np.testing.assert_allclose(out[name], sent, rtol=1e-15, atol=0, err_msg=name)
    assert decoder.counters().packets_by_type == {"sink": 300}
    assert_accounted(decoder, 300 * 64)


def test_compiled_decoder_equals_its_plain_twin_on_damaged_data() -> None:
    length_errors = 0
    for device, block in ((sink(), sink_block(2000)), (ax1(), ax1_block(2000))):
        data, _ = damage(device.encoder().encode(block), seed=5)
        decoder, reference = device.decoder(), decode(device, data)
        out = run(decoder, data, [])
        assert len(out) == len(reference.rows)
        for name in reference.rows[0]:
            np.testing.assert_array_equal(out[name], [row[name] for row in reference.rows], err_msg=name)
        counters = decoder.counters()
        assert counters.checksum_errors == reference.checksum_errors > 0
        assert counters.length_errors == reference.length_errors
        length_errors += counters.length_errors
        assert counters.bytes_pending == reference.pending
        assert_accounted(decoder, len(data))
    assert length_errors > 0


def ax1_block(n: int, seed: int = 1) -> SampleBlock:
    random = np.random.default_rng(seed)
    columns: dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]] = {
        f"{name}_{axis}": random.normal(size=n) for name in ("gyro", "accel", "mag") for axis in "xyz"
    }
    return SampleBlock({**columns, "packet_counter": np.arange(n), "device_ticks": np.arange(n) * 10_000})


def test_no_intact_packet_is_lost_in_a_damaged_stream() -> None:
    device = ax1()
    for seed in range(3):
        packets = device.encoder().encode(ax1_block(3000, seed))
        data, intact = damage(packets, seed)
        decoder = device.decoder()
        out = run(decoder, data, list(range(4096, len(data), 4096)))
        found = set(decode(device, data).offsets)
        assert found.issuperset(intact)
        assert len(out) == len(found)
        assert_accounted(decoder, len(data))


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_output_and_arrival_times_do_not_depend_on_the_chunking(data: st.DataObject) -> None:
    device = ax1()
    packets = device.encoder().encode(ax1_block(40))
    junk = data.draw(st.lists(st.tuples(st.integers(0, 39), st.binary(max_size=70)), max_size=4))
    for place, extra in junk:
        packets[place] += extra
    stream = b"".join(packets)[: data.draw(st.integers(1, 40 * 58))]
    cuts = data.draw(st.lists(st.integers(0, len(stream)), max_size=30))
    final = data.draw(st.booleans())
    whole, pieces = device.decoder(), device.decoder()
    one, many = run(whole, stream, [], final), run(pieces, stream, cuts, final)
    assert whole.counters() == pieces.counters()
    assert list(one.columns) == list(many.columns)
    for name in one.columns:
        if name != "arrival_time_ns":
            np.testing.assert_array_equal(one[name], many[name], err_msg=name)
    reference = decode(device, stream, final)
    edges = np.array(sorted(cuts))
    last_bytes = np.array(reference.offsets, np.int64) + 57
    expected = 1000 * (np.searchsorted(edges, last_bytes, side="right") + 1)
    np.testing.assert_array_equal(many["arrival_time_ns"], expected)


@given(st.binary(max_size=400))
@settings(max_examples=150, deadline=None)
def test_any_bytes_are_accounted_for(data: bytes) -> None:
    for device in (ax1(), sink("none")):
        decoder = device.decoder()
        run(decoder, data, [])
        assert_accounted(decoder, len(data))


def test_more_rows_than_the_columns_hold_are_all_there() -> None:
    device = parse_device(
        "format: imumon-device/1\nname: tiny\ntitle: t\nprotocol: fixed\naxes: FLU\npacket:\n"
        "  length: 4\n  byte_order: big\n  sync: [0xAA]\n  checksum: {type: xor8, first: 0, last: 2, at: 3}\n"
        "  fields: [{at: 1, type: u16, column: packet_counter}]\n",
        "tiny.yaml",
    )
    n = 12_000
    data = b"".join(device.encoder().encode(SampleBlock({"packet_counter": np.arange(n)})))
    decoder = device.decoder()
    decoder.feed(data[:70_001], 1)
    decoder.feed(data[70_001:], 2)
    out = decoder.take()
    np.testing.assert_array_equal(out["packet_counter"], np.arange(n))
    ends = 4 * np.arange(1, n + 1)
    np.testing.assert_array_equal(out["arrival_time_ns"], np.where(ends <= 70_001, 1, 2))
    assert len(decoder.take()) == 0


def test_a_packet_cut_short_by_the_end_stays_pending() -> None:
    device = ax1()
    data = b"".join(device.encoder().encode(ax1_block(3)))[:-5]
    decoder = device.decoder()
    assert len(run(decoder, data, [])) == 2
    assert decoder.counters().bytes_pending == 53
    assert decoder.counters().bytes_skipped == 0


LARGE = """
format: imumon-device/1
name: large
title: numbers of 64 bits
protocol: fixed
rate_hz: 200
axes: FLU
packet:
  length: 34
  byte_order: little
  sync: [0xFA, 0x01]
  checksum: {type: none, first: 0, last: 1, at: 0}
  fields:
    - {at: 2, type: u64, column: scaled, scale: 1.0e-3}
    - {at: 2, type: u64, column: plain}
    - {at: 10, type: i64, column: far}
    - {at: 18, type: u64, column: device_ticks, unit: ns}
    - {at: 26, type: u64, column: high_bits, mask: 0x7FFF000000000000}
"""


def test_numbers_of_64_bits_are_right_or_missing() -> None:
    device = parse_device(LARGE, "large.yaml")
    rows = [(2**63 - 1, -(2**63) + 1, 5), (2**64 - 1, -(2**63), 2**64 - 5), (2**63, -1, 2**63)]
    packets = [
        b"\xfa\x01" + struct.pack("<QqQQ", wide, far, ticks, 0xFFFE << 48) for wide, far, ticks in rows
    ]
    decoder = device.decoder()
    block = run(decoder, b"".join(packets), [])
    np.testing.assert_allclose(block["scaled"], [2**63 / 1e3, 2**64 / 1e3, 2**63 / 1e3], rtol=1e-15)
    assert block["plain"].tolist() == [2**63 - 1, NO_INT, NO_INT]
    assert block["far"].tolist() == [-(2**63) + 1, NO_INT, -1]
    assert block["device_ticks"].tolist() == [5, -5, NO_INT]  # the low bits of a clock, which wraps
    assert block["high_bits"].tolist() == [0x7FFE] * 3


def test_a_float_clock_becomes_whole_nanoseconds() -> None:
    for kind, values in (("f64", [0.0, 1.25, 86_400.000000001]), ("f32", [0.0, 0.5, 2.25])):
        device = parse_device(
            "format: imumon-device/1\nname: f\ntitle: t\nprotocol: fixed\naxes: FLU\npacket:\n"
            "  length: 12\n  byte_order: big\n  sync: [0xAA]\n"
            "  checksum: {type: xor8, first: 0, last: 10, at: 11}\n"
            f"  fields: [{{at: 2, type: {kind}, column: device_ticks, unit: s}}]\n",
            "f.yaml",
        )
        ticks = np.rint(np.array(values) * 1e9).astype(np.int64)
        block = SampleBlock({"device_ticks": ticks})
        out = run(device.decoder(), b"".join(device.encoder().encode(block)), [])
        np.testing.assert_array_equal(out["device_ticks"], ticks)
        assert isinstance(device, FixedDevice)
        assert device.decoder().timing.tick_ns == 1
        assert device.decoder().timing.tick_bits == 0


def test_measured_openimu_stream() -> None:
    data = measured("aceinna/z1.raw").read_bytes()
    device = load_device("openimu")
    decoder = device.decoder()
    out = run(decoder, data, list(range(0, len(data), 777)))
    counters = decoder.counters()
    assert counters.packets == 2127
    assert (counters.checksum_errors, counters.length_errors, counters.bytes_skipped) == (0, 0, 0)
    assert counters.bytes_pending == 100_000 - 2127 * 47
    assert out.accel is not None
    assert np.median(np.linalg.norm(out.accel, axis=1)) == pytest.approx(9.8, abs=0.1)
    steps = np.diff(out["device_ticks"])
    assert np.all((steps > 9_900) & (steps < 10_100))
    again = b"".join(device.encoder().encode(out))
    assert again == data[: len(again)]


def test_a_range_that_does_not_fit_is_refused() -> None:
    with pytest.raises(ImumonError, match=r"mag_x.*does not fit"):
        ax1().encoder().encode(SampleBlock({"mag_x": np.array([400.0])}))


@pytest.mark.parametrize(("column", "value"), [("high_bits", 0x8000), ("high_bits", -1), ("plain", -1)])
def test_an_integer_that_does_not_fit_its_bits_is_refused(column: str, value: int) -> None:
    encoder = parse_device(LARGE, "large.yaml").encoder()
    assert len(encoder.encode(SampleBlock({column: np.array([0x7FFF])}))) == 1
    with pytest.raises(ImumonError, match=rf"{column}.*{value} does not fit"):
        encoder.encode(SampleBlock({column: np.array([value])}))


def test_device_files_of_the_project_load_and_make_codecs() -> None:
    folder = Path(__file__).resolve().parents[3] / "configs" / "devices"
    for path in folder.glob("*.yaml"):
        device = load_device(str(path))
        assert device.name == path.stem
        assert device.decoder().counters().bytes_received == 0
        assert device.title
