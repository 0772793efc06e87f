from __future__ import annotations

import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.protocols.tagged import XBUS
from imumon.protocols.xsens.mtdata import (
    MTDATA,
    MTDataDecoder,
    MTDataDevice,
    OutputSettings,
    Profile,
    mtdata_field,
)
from tests.protocols.sources import date_of, matrix_of
from tests.protocols.streams import chunkings, damage, feed_in_chunks, xbus_message
from tests.protocols.tagged_twin import FIXED, assert_same, decode_plainly

PARTS = ["temperature", "calibrated", "orientation", "auxiliary", "position", "velocity", "status", "raw_gps"]
USUAL = Profile(output_mode=["temperature", "calibrated", "orientation"])
RESOLUTION = {"float32": 1e-5, "fp12.20": 2.0**-20, "fp16.32": 2.0**-32, "float64": 1e-12}

profiles = st.builds(
    Profile,
    output_mode=st.one_of(
        st.lists(st.sampled_from(PARTS), min_size=1, unique=True),
        st.sampled_from([["raw_inertial"], ["raw_gps", "raw_inertial"]]),
    ),
    output_settings=st.builds(
        OutputSettings,
        timestamp=st.sampled_from(["none", "sample_counter", "utc", "sample_counter_and_utc"]),
        orientation=st.sampled_from(["quaternion", "euler", "matrix"]),
        calibrated=st.lists(st.sampled_from(["accel", "gyro", "mag"]), min_size=1, unique=True).map(sorted),
        number_format=st.sampled_from(["float32", "fp12.20", "fp16.32", "float64"]),
        analog=st.sampled_from([[1], [2], [1, 2]]),
        status=st.sampled_from(["compact", "detailed"]),
        frame=st.sampled_from(["NWU", "NED"]),
    ),
)


def samples(profile: Profile, n: int, seed: int = 0) -> SampleBlock:
    rng = np.random.default_rng(seed)
    columns = {
        column.name: rng.integers(0, 50, n) if column.dtype == "int64" else rng.integers(0, 50, n) * 0.25
        for column in MTDataDecoder(profile).possible_columns
        if column.name not in ("arrival_time_ns", "device_ticks")  # the latter made of the UTC time
    }
    for name in columns.keys() & {"packet_counter"}:
        columns[name] = np.arange(n)
    for name in columns:
        if name.startswith(("gnss_", "raw_", "analog_")):
            columns[name] = np.trunc(columns[name]).astype(columns[name].dtype)
    if "pressure" in columns:
        columns["pressure"] = rng.integers(40_000, 60_000, n) * 2.0
    if profile.output_settings.orientation == "matrix" and "orientation" in profile.output_mode:
        q = rng.normal(size=(4, n))
        q *= np.sign(q[0]) / np.linalg.norm(q, axis=0)
        columns.update(zip(("q_w", "q_x", "q_y", "q_z"), q, strict=True))
        columns |= matrix_of(q)
    if "utc" in profile.output_settings.timestamp:
        time_ns = 1_600_000_000_000_000_000 + np.arange(n) * 10_000_000
        columns |= {"utc_time_ns": time_ns, **date_of("utc_", time_ns)}
    return SampleBlock(columns)


@given(profiles)
@settings(max_examples=80, deadline=None)
def test_every_profile_makes_the_round_trip(profile: Profile) -> None:
    block = samples(profile, 4)
    decoder = MTDataDecoder(profile)
    decoder.feed(b"".join(MTDataDecoder(profile).encoder().encode(block)), 0)
    got = decoder.take()
    assert len(got) == 4
    assert decoder.counters().bytes_skipped == decoder.counters().bytes_pending == 0
    tolerance = 1e-5 if "q_w" in block else RESOLUTION[profile.output_settings.number_format]
    for name in (name for name in block.columns if not name.startswith("_")):
        np.testing.assert_allclose(got[name], block[name], rtol=1e-6, atol=tolerance, err_msg=name)
    has_utc = "utc" in profile.output_settings.timestamp
    assert (decoder.timing.tick_ns is not None) == has_utc == ("device_ticks" in got)
    assert (decoder.timing.counter_bits == 16) == ("packet_counter" in got)


def test_the_parts_come_in_the_documented_order_and_units() -> None:
    profile = Profile(
        output_mode=[
            "status",
            "velocity",
            "position",
            "auxiliary",
            "orientation",
            "calibrated",
            "temperature",
        ],
        output_settings=OutputSettings(orientation="euler", frame="NED"),
    )
    numbers = [21.5, *(0.5, -1.0, 9.75), *(0.1, 0.2, 0.3), *(0.4, 0.5, 0.6), 90.0, -45.0, 180.0]
    payload = struct.pack(">13f2H6fBH", *numbers, 100, 200, 52.25, 6.75, 40.5, 1.5, 2.5, 3.5, 0x07, 65_535)
    assert mtdata_field(profile).size == len(payload)
    decoder = MTDataDecoder(profile)
    decoder.feed(xbus_message(MTDATA, payload), 9)
    block = decoder.take()
    row = {name: block[name][0] for name in block.columns}
    expected = {
        "arrival_time_ns": 9, "temperature": 21.5, "accel_x": 0.5, "accel_y": -1, "accel_z": 9.75,
        "gyro_x": np.float32(0.1), "gyro_y": np.float32(0.2), "gyro_z": np.float32(0.3),
        "mag_x": np.float32(0.4), "mag_y": np.float32(0.5), "mag_z": np.float32(0.6),
        "roll": np.pi / 2, "pitch": -np.pi / 4, "yaw": np.pi, "analog_1": 100, "analog_2": 200,
        "latitude": 52.25, "longitude": 6.75, "altitude": 40.5,
        "velocity_x": 1.5, "velocity_y": 2.5, "velocity_z": 3.5, "status": 7, "packet_counter": 65_535,
    }  # fmt: skip
    assert row == pytest.approx(expected, rel=1e-15)


def test_raw_gps_comes_in_si_units() -> None:
    profile = Profile(output_mode=["raw_inertial", "raw_gps"])
    raw = struct.pack(">10H", *range(10))
    gps = struct.pack(
        ">HBI6i3IB", 50_000, 3, 1500, 522_500_000, 67_500_000, 40_500, 150, -250, 20, 2500, 3500, 45, 7
    )
    decoder = MTDataDecoder(profile)
    decoder.feed(xbus_message(MTDATA, raw + gps + b"\x00\x05"), 0)
    block = decoder.take()
    row = {name: float(block[name][0]) for name in block.columns}
    assert row["raw_accel_x"] == 0
    assert row["raw_mag_z"] == 8
    assert row["raw_temperature"] == 9
    assert row["pressure"] == 100_000
    assert row["gnss_time_of_week"] == 1.5
    assert (row["gnss_latitude"], row["gnss_longitude"], row["gnss_altitude"]) == pytest.approx(
        (52.25, 6.75, 40.5)
    )
    assert row["gnss_velocity_east"] == -2.5
    assert row["gnss_speed_accuracy"] == pytest.approx(0.45)
    assert row["packet_counter"] == 5


def test_a_length_that_does_not_fit_is_an_error_that_states_what_to_change() -> None:
    other = Profile(output_mode=["calibrated", "orientation"])
    wrong = MTDataDecoder(other).encoder().encode(samples(other, 3))
    right = MTDataDecoder(USUAL).encoder().encode(samples(USUAL, 2))
    decoder = MTDataDecoder(USUAL)
    block = feed_in_chunks(decoder, b"".join([*wrong, *right]), [40])
    assert len(block) == 2
    assert decoder.counters().length_errors == 3
    assert decoder.counters().bytes_skipped == len(b"".join(wrong))
    (notice,) = decoder.notices()
    assert "MTData of 54 bytes came where the profile makes 58" in notice
    assert "change output_mode or output_settings" in notice
    assert decoder.notices() == []


def configuration(mode: int, settings: int, length: int) -> bytes:
    head = struct.pack(
        ">IHHHHI8s8s32s32sH", 0x00500123, 1152, 0, 0, 0, 0, b"20260101", b"12:00:00", b"", b"", 1
    )
    return xbus_message(0x0D, head + struct.pack(">IHHI8x", 0x00500123, length, mode, settings))


def test_the_device_tells_its_profile() -> None:
    decoder = MTDataDecoder(USUAL)
    message = configuration(0x0006, 0x80000245, 44)
    assert len(message) == 118 + 5
    decoder.feed(message, 0)
    assert decoder.notices() == ["the device sends 44 bytes: output mode 0006, output settings 80000245"]


@given(st.integers(0, 9), chunkings)
@settings(max_examples=30, deadline=None)
def test_any_chunking_gives_the_same_as_the_plain_twin(seed: int, lengths: list[int]) -> None:
    packets = MTDataDecoder(USUAL).encoder().encode(samples(USUAL, 25, seed))
    packets.insert(7, xbus_message(0x42, b"\x03"))
    packets.insert(9, configuration(0x0007, 0x1, 58))
    data, _ = damage(packets, np.random.default_rng(seed), 0.1, 0.1, 0.2)
    arrival = [i // 33 for i in range(len(data))]
    decoder = MTDataDecoder(USUAL)
    block = feed_in_chunks(decoder, data, lengths, arrival)
    twin = decode_plainly(data, arrival, XBUS, {MTDATA: FIXED}, decoder._field)
    assert_same(block, twin.rows)
    counters = decoder.counters()
    assert counters.packets == len(twin.packets)
    assert (counters.checksum_errors, counters.length_errors) == (twin.checksum_errors, twin.length_errors)
    assert (counters.bytes_in_packets, counters.bytes_skipped) == (twin.in_packets, twin.skipped)


@pytest.mark.parametrize("seed", range(4))
def test_no_whole_packet_is_lost_in_a_damaged_stream(seed: int) -> None:
    block = samples(USUAL, 6000, seed)
    packets = MTDataDecoder(USUAL).encoder().encode(block)
    data, whole = damage(packets, np.random.default_rng(seed), 0.01, 0.005, 0.005)
    decoder = MTDataDecoder(USUAL)
    got = feed_in_chunks(decoder, data, [1000, 77, 4096])
    found = set(got["packet_counter"].tolist())
    assert set(whole) <= found
    assert len(got) - len(whole) <= 4


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ("output_mode: []", "output_mode"),
        ("output_mode: [gyro]", "output_mode"),
        ("output_mode: [calibrated]\noutput_setting: {}", "output_setting"),
        ("output_mode: [calibrated]\noutput_settings: {orientation: matrices}", "orientation"),
    ],
)
def test_a_wrong_profile_is_refused_with_its_line(change: str, message: str) -> None:
    text = device_text("xsens-legacy")[0]
    with pytest.raises(ImumonError, match=message) as caught:
        parse_device(text[: text.index("output_mode:")] + change, "copy.yaml")
    assert caught.value.reason is Reason.BAD_CONFIG
    assert "copy.yaml:" in caught.value.seen


def test_the_device_file_makes_a_decoder_that_reads_its_encoder() -> None:
    device = load_device("xsens-legacy")
    assert isinstance(device, MTDataDevice)
    decoder = device.decoder()
    assert decoder.timing.counter_bits == 16
    decoder.feed(b"".join(device.encoder().encode(samples(USUAL, 5))), 0)
    assert decoder.take()["packet_counter"].tolist() == [0, 1, 2, 3, 4]
    decoder.feed(xbus_message(0x36, b"\x10\x20\x02\x00\x01"), 0)
    assert decoder.notices() == ["the device sends MTData2, which needs the device xsens"]
    assert len(decoder.take()) == 0
