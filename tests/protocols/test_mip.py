from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, ColumnArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.device import load_device
from imumon.protocols.mip import FILTER, GNSS, SENSOR, Attitude, MipDecoder, MipDevice, mip_fields
from imumon.protocols.tagged import MIP
from tests.data_folder import measured
from tests.protocols.sources import matrix_of
from tests.protocols.streams import chunkings, damage, feed_in_chunks
from tests.protocols.tagged_twin import COUNTED, LIST, assert_same, decode_plainly

ROLES = dict.fromkeys(range(0x80, 0x100), COUNTED) | dict.fromkeys((SENSOR, FILTER, *GNSS), LIST)
NAMES = ["ReferenceTime", "ScaledAccel", "ScaledGyro", "ScaledMag", "Temperature"]


def mip_packet(descriptor_set: int, *fields: bytes) -> bytes:
    body = bytes([0x75, 0x65, descriptor_set, sum(map(len, fields))]) + b"".join(fields)
    first = second = 0
    for byte in body:
        first = (first + byte) & 0xFF
        second = (second + first) & 0xFF
    return body + bytes([first, second])


def samples(n: int, seed: int = 0) -> SampleBlock:
    rng = np.random.default_rng(seed)
    names = [f"{what}_{axis}" for what in ("gyro", "accel", "mag") for axis in "xyz"]
    columns = {name: rng.normal(0, 5, n) for name in [*names, "temperature"]}
    return SampleBlock({**columns, "device_ticks": np.arange(n) * 8_000_000})


def test_recorded_stream_is_decoded_whole_and_plausibly() -> None:
    data = measured("microstrain/stream.bin").read_bytes()
    decoder = MipDecoder()
    block = feed_in_chunks(decoder, data, [997])
    counters = decoder.counters()
    assert counters.packets == 4156
    assert counters.bytes_in_packets == len(data)
    assert counters.checksum_errors == counters.length_errors == 0
    assert counters.packets_by_type == {
        "set 0x01": 1, "sensor data": 3624, "filter data": 361, "system data": 170
    }  # fmt: skip
    assert decoder.notices() == []
    assert decoder.notices() == []
    assert len(block) == 3624 + 361
    sensor = ~np.isnan(block["gyro_x"])
    assert np.sum(sensor) == 2265
    assert np.median(np.diff(block["device_ticks"][sensor])) == 8_000_000
    accel, mag = block.accel, block.mag
    assert accel is not None
    assert mag is not None
    assert np.median(np.linalg.norm(accel[sensor], axis=1)) == pytest.approx(9.8, abs=0.2)
    assert np.nanmedian(np.linalg.norm(mag, axis=1)) == pytest.approx(40, abs=10)
    # The filter's attitude is in the canonical columns, that of the other filter in its own.
    assert np.sum(~np.isnan(block["roll"])) == 361
    assert np.sum(~np.isnan(block["imu_roll"])) == 905
    level = np.nanmedian(block["roll"]), np.nanmedian(block["pitch"])
    assert np.abs(level).max() < 0.2
    twin = decode_plainly(data, [0] * len(data), MIP, ROLES, MipDecoder()._field)
    assert_same(block, twin.rows)


def test_the_bias_of_the_filter_is_no_estimate_of_imumon() -> None:
    sent = SampleBlock({f"filter_gyro_bias_{axis}": np.array([1e-3, 2e-3]) for axis in "xyz"})
    block = feed_in_chunks(
        MipDecoder(), b"".join(MipDecoder().encoder(["GyroBias"], FILTER).encode(sent)), [5]
    )
    np.testing.assert_allclose(block["filter_gyro_bias_z"], [1e-3, 2e-3], rtol=1e-6)


def test_the_attitude_of_the_imu_can_be_the_canonical_one() -> None:
    decoder = MipDecoder(attitude="imu")
    block = feed_in_chunks(decoder, measured("microstrain/stream.bin").read_bytes(), [4096])
    assert np.sum(~np.isnan(block["roll"])) == 905
    assert np.sum(~np.isnan(block["filter_roll"])) == 361


@given(st.integers(0, 9), chunkings)
@settings(max_examples=30, deadline=None)
def test_any_chunking_gives_the_same_as_the_plain_twin(seed: int, lengths: list[int]) -> None:
    packets = MipDecoder().encoder(NAMES).encode(samples(25, seed))
    packets[3:3] = MipDecoder().encoder(["Euler", "FilterStatus"], FILTER).encode(samples(2))
    packets.insert(8, mip_packet(0x0C, b"\x04\xf1\x08\x00"))
    data, _ = damage(packets, np.random.default_rng(seed), 0.1, 0.1, 0.2)
    arrival = [i // 41 for i in range(len(data))]
    decoder = MipDecoder()
    block = feed_in_chunks(decoder, data, lengths, arrival)
    twin = decode_plainly(data, arrival, MIP, ROLES, MipDecoder()._field)
    assert_same(block, twin.rows)
    counters = decoder.counters()
    assert counters.packets == len(twin.packets)
    assert (counters.checksum_errors, counters.length_errors) == (twin.checksum_errors, twin.length_errors)
    assert (counters.bytes_in_packets, counters.bytes_skipped) == (twin.in_packets, twin.skipped)


pieces = st.one_of(
    st.binary(max_size=30),
    st.sampled_from([b"ue", b"ue\x80", b"ue\x80\xff", b"u"]),
    st.sampled_from(MipDecoder().encoder(["ScaledGyro"]).encode(samples(3))),
    st.binary(max_size=20).map(lambda fields: mip_packet(SENSOR, fields)),
)


@given(st.lists(pieces, max_size=12).map(b"".join), chunkings)
@settings(max_examples=100, deadline=None)
def test_garbage_is_accounted_for_as_by_the_plain_twin(data: bytes, lengths: list[int]) -> None:
    decoder = MipDecoder()
    block = feed_in_chunks(decoder, data, lengths)
    twin = decode_plainly(data, [0] * len(data), MIP, ROLES, MipDecoder()._field)
    counters = decoder.counters()
    assert counters.packets == len(twin.packets)
    assert (counters.checksum_errors, counters.length_errors) == (twin.checksum_errors, twin.length_errors)
    assert (counters.bytes_in_packets, counters.bytes_skipped) == (twin.in_packets, twin.skipped)
    assert_same(block, twin.rows)


def test_no_whole_packet_is_lost_in_a_damaged_recording() -> None:
    data = measured("microstrain/stream.bin").read_bytes()
    packets = []
    while data:
        packets.append(data[: data[3] + 6])
        data = data[len(packets[-1]) :]
    stream, whole = damage(packets, np.random.default_rng(1), 0.01, 0.005, 0.005)
    decoder = MipDecoder()
    feed_in_chunks(decoder, stream, [1024])
    # 16 bits of checksum let nothing damaged pass here, so the counts agree.
    assert decoder.counters().packets == len(whole)
    assert decoder.counters().checksum_errors > 20


def test_units_are_si() -> None:
    one = np.array([1.0], ">f4").tobytes()
    data = mip_packet(
        SENSOR,
        b"\x0e\x04" + 3 * one,
        b"\x0e\x06" + 3 * one,
        b"\x0e\x08" + 3 * one,
        b"\x06\x17" + one,
    )
    decoder = MipDecoder()
    decoder.feed(data, 3)
    block = decoder.take()
    assert block["accel_x"].tolist() == [STANDARD_GRAVITY]
    assert block["mag_y"].tolist() == [100]
    assert block["delta_velocity_z"].tolist() == [STANDARD_GRAVITY]
    assert block["pressure"].tolist() == [100]


def test_corrected_rates_alone_are_reported() -> None:
    corrected = MipDecoder().encoder(["CompensatedRate"], FILTER).encode(samples(40))
    raw = MipDecoder().encoder(["ScaledGyro"]).encode(samples(1))
    decoder = MipDecoder()
    block = feed_in_chunks(decoder, b"".join(corrected), [100])
    assert "gyro_x" not in block
    assert any("ScaledGyro" in text for text in decoder.warnings())
    assert decoder.warnings() == []
    decoder = MipDecoder()
    feed_in_chunks(decoder, b"".join(raw + corrected), [100])
    assert decoder.warnings() == []


@pytest.mark.parametrize(
    ("code", "size"),
    [(0x12, 18), (0x14, 12), (0x15, 22), (0x20, 22), (0x32, 11), (0x34, 15), (0x40, 26), (0x43, 15),
     (0x45, 13), (0x46, 7), (0x49, 17)],
)  # fmt: skip
def test_fields_of_the_filter_have_the_vendors_sizes(code: int, size: int) -> None:
    assert mip_fields()[FILTER << 8 | code].size == size


def test_gps_time_can_be_the_clock_of_devices_without_reference_time() -> None:
    time = np.array([100.25], ">f8").tobytes() + np.array([2100, 31], ">u2").tobytes()
    data = mip_packet(SENSOR, b"\x0e\x12" + time)
    reference, gps = MipDecoder(), MipDecoder(clock="gps")
    reference.feed(data, 0)
    gps.feed(data, 0)
    assert "device_ticks" not in reference.take()
    assert gps.take()["device_ticks"].tolist() == [2100 * 604_800 * 10**9 + 100_250_000_000]
    ticks = np.array([5, NO_INT, 10**18])
    again = MipDecoder(clock="gps")
    encoder = MipDecoder(clock="gps").encoder(["SensorGpsTime", "ScaledGyro"])
    again.feed(b"".join(encoder.encode(SampleBlock({"device_ticks": ticks, "gyro_x": np.ones(3)}))), 0)
    np.testing.assert_allclose(again.take()["device_ticks"], ticks, atol=100)


@pytest.mark.parametrize("attitude", ["filter", "imu"])
@pytest.mark.parametrize("descriptor_set", [SENSOR, FILTER, *GNSS])
def test_every_field_makes_the_round_trip(descriptor_set: int, attitude: Attitude) -> None:
    rng = np.random.default_rng(descriptor_set)
    for key, field in mip_fields(attitude).items():
        if key >> 8 != descriptor_set or not field.columns:
            continue
        columns, hidden = dict[str, ColumnArray](), dict[str, ColumnArray]()
        for value in field.numbers:
            if value.column is not None and not value.column.name.startswith("_"):
                numbers = rng.integers(0, 100, 4)
                integer = value.column.dtype == "int64"
                columns[value.column.name] = numbers if integer else numbers * value.factor
        if "Matrix" in field.name:
            q = rng.normal(size=(4, 4))
            q *= np.sign(q[0]) / np.linalg.norm(q, axis=0)
            columns.update(zip(("q_w", "q_x", "q_y", "q_z"), q, strict=True))
            hidden = matrix_of(q)
        decoder, sent = MipDecoder(attitude), SampleBlock(columns | hidden)
        packets = MipDecoder(attitude).encoder([field.name], descriptor_set).encode(sent)
        decoder.feed(b"".join(packets), 0)
        got = decoder.take()
        assert set(got.columns) == {"arrival_time_ns", *columns}, field.name
        for name, values in columns.items():
            np.testing.assert_allclose(got[name], values, rtol=1e-6, atol=1e-6, err_msg=name)


def test_commands_and_replies_are_counted_by_their_set() -> None:
    decoder = MipDecoder()
    decoder.feed(mip_packet(0x01, b"\x04\xf1\x02\x00") + mip_packet(0x0C, b"\x04\xf1\x08\x03"), 0)
    assert decoder.notices() == []
    assert decoder.counters().packets_by_type == {"set 0x01": 1, "set 0x0C": 1}
    assert len(decoder.take()) == 0


def test_unknown_fields_are_named_by_their_set() -> None:
    decoder = MipDecoder()
    decoder.feed(mip_packet(SENSOR, b"\x03\x7e\x00", b"\x05\x05\x00\x00\x00"), 0)
    assert decoder.notices() == [
        "field 0x7E of sensor data of 1 bytes is not known and is passed over",
        "field ScaledGyro of sensor data of 3 bytes is not known and is passed over",
    ]
    assert len(decoder.take()) == 0


def test_a_field_list_that_overruns_is_a_length_error() -> None:
    decoder = MipDecoder()
    bad = mip_packet(SENSOR, b"\x0e\x05\x00\x00")
    block = feed_in_chunks(decoder, bad + MipDecoder().encoder(["ScaledGyro"]).encode(samples(1))[0], [5])
    assert len(block) == 1
    assert decoder.counters().length_errors == 1
    assert decoder.counters().bytes_skipped == len(bad)


def test_an_unknown_field_name_is_refused() -> None:
    with pytest.raises(ImumonError, match="ScaledGyroscope") as caught:
        MipDecoder().encoder(["ScaledGyroscope"])
    assert caught.value.reason is Reason.BAD_CONFIG


def test_the_device_file_makes_a_decoder_that_reads_its_encoder() -> None:
    device = load_device("microstrain")
    assert isinstance(device, MipDevice)
    decoder = device.decoder()
    assert decoder.timing.tick_ns == 1
    block = samples(6)
    decoder.feed(b"".join(device.encoder().encode(block)), 0)
    got = decoder.take()
    assert got["device_ticks"].tolist() == block["device_ticks"].tolist()
    np.testing.assert_allclose(got["accel_z"], block["accel_z"], rtol=1e-6)
