from __future__ import annotations

import math
import struct
from datetime import UTC, datetime
from typing import Literal

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, ColumnArray, SampleBlock
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import ByteArray, Encoder
from imumon.protocols.device import load_device
from imumon.protocols.tagged import XBUS
from imumon.protocols.xsens.fields import FRAMES, IDENTIFIERS, PRECISIONS, Identifier, message_of
from imumon.protocols.xsens.mtdata import (
    MTDATA,
    MTDATA2,
    MTData2Decoder,
    MTData2Device,
    Precision,
    find_fields,
)
from tests.data_folder import measured
from tests.protocols.sources import date_of, matrix_of
from tests.protocols.streams import check_books, chunkings, damage, feed_in_chunks, xbus_message
from tests.protocols.tagged_twin import LIST, assert_same, decode_plainly
from tests.protocols.wire import xbus
from tests.protocols.xsens.golden import read_golden

DEGREE = math.pi / 180

ROLES = {MTDATA2: LIST}
TYPICAL = [
    "PacketCounter",
    "SampleTimeFine",
    "Quaternion",
    "Acceleration",
    "RateOfTurn",
    "MagneticField",
    "StatusWord",
]
Frame = Literal["ENU", "NED", "NWU"]
PRECISION_NAMES: list[Precision] = ["float32", "fp12.20", "fp16.32", "float64"]


def mtdata2_encoder(names: list[str], precision: Precision = "float32", frame: Frame = "ENU") -> Encoder:
    """Encode data identifiers of one kind of frame."""
    fields = [(code | FRAMES[frame], message) for code, message in find_fields(names, precision)]
    return MTData2Decoder().field_encoder(MTDATA2, fields)


def samples(n: int, seed: int = 0) -> SampleBlock:
    rng = np.random.default_rng(seed)
    names = [f"{what}_{axis}" for what in ("gyro", "accel", "mag") for axis in "xyz"]
    columns: dict[str, npt.NDArray[np.float64] | npt.NDArray[np.int64]] = {
        name: rng.normal(0, 5, n) for name in [*names, "q_w", "q_x", "q_y", "q_z", "temperature"]
    }
    columns["packet_counter"] = np.arange(n, dtype=np.int64) % 65_536
    columns["device_ticks"] = np.arange(n, dtype=np.int64) * 100
    columns["status"] = rng.integers(0, 1 << 32, n)
    return SampleBlock(columns)


def stream(n: int, seed: int = 0, names: list[str] | None = None) -> bytes:
    return b"".join(mtdata2_encoder(names or TYPICAL).encode(samples(n, seed)))


GOLDEN: dict[str, dict[str, tuple[str, float]]] = {
    "PacketCounter": {"": ("packet_counter", 1)},
    "SampleTimeFine": {"": ("device_ticks", 1)},
    "EulerAngles": {
        "X": ("roll", DEGREE),
        "Y": ("pitch", DEGREE),
        "Z": ("yaw", DEGREE),
    },
    "Acceleration": {axis: (f"accel_{axis.lower()}", 1) for axis in "XYZ"},
    "DeltaV": {axis: (f"delta_velocity_{axis.lower()}", 1) for axis in "XYZ"},
    "RateOfTurn": {axis: (f"gyro_{axis.lower()}", 1) for axis in "XYZ"},
    "DeltaQ": {f"Q{i}": (f"delta_q_{axis}", 1) for i, axis in enumerate("wxyz")},
    "LatLon": {"Lat": ("latitude", 1), "Lon": ("longitude", 1)},
    "AltitudeEllipsoid": {"": ("altitude", 1)},
    "VelocityXYZ": {axis: (f"velocity_{axis.lower()}", 1) for axis in "XYZ"},
    "GNSSPVTData": {
        "ITOW": ("gnss_time_of_week", 1e-3),
        "Valid": ("gnss_time_valid", 1),
        "TAcc": ("gnss_time_accuracy", 1e-9),
        "FixType": ("gnss_fix_type", 1),
        "Flags": ("gnss_flags", 1),
        "NumSV": ("gnss_satellites", 1),
        "Lon": ("gnss_longitude", 1e-7),
        "Lat": ("gnss_latitude", 1e-7),
        "Height": ("gnss_altitude", 1e-3),
        "HMSL": ("gnss_altitude_msl", 1e-3),
        "HAcc": ("gnss_horizontal_accuracy", 1e-3),
        "VAcc": ("gnss_vertical_accuracy", 1e-3),
        "VelN": ("gnss_velocity_north", 1e-3),
        "VelE": ("gnss_velocity_east", 1e-3),
        "VelD": ("gnss_velocity_down", 1e-3),
        "GSpeed": ("gnss_ground_speed", 1e-3),
        "HeadMot": ("gnss_course", 1e-5 * DEGREE),
        "SAcc": ("gnss_speed_accuracy", 1e-3),
        "HeadAcc": ("gnss_course_accuracy", 1e-5 * DEGREE),
        "HeadVeh": ("gnss_vehicle_heading", 1e-5 * DEGREE),
        **{f"{x}DOP": (f"gnss_{x.lower()}dop", 0.01) for x in "GPTVHNE"},
    },
}
"""Where the items of the golden text are to be found, and the factor to our unit."""


def seconds_of(text: str) -> int:
    """Unix time in ns of an ISO time with any number of decimals."""
    whole, _, part = text.rstrip("Z").partition(".")
    moment = datetime.fromisoformat(whole).replace(tzinfo=UTC)
    return int(moment.timestamp()) * 1_000_000_000 + int(part.ljust(9, "0") or "0")


@pytest.mark.parametrize("recording", ["mtdata2-1", "mtdata2-3"])
def test_all_values_of_recorded_frames_are_those_of_the_vendor(recording: str) -> None:
    frames = read_golden(measured(f"xsens/{recording}/output.golden"))
    decoder = MTData2Decoder()
    decoder.feed(measured(f"xsens/{recording}/output.bin").read_bytes(), 7)
    block = decoder.take()
    assert len(block) == len(frames) == decoder.counters().packets == 100
    assert decoder.counters().bytes_skipped == decoder.counters().bytes_pending == 0
    compared = 0
    for row, frame in enumerate(frames):
        expected: dict[str, float | int] = {}
        for title, item in frame.items():
            name = title.split("(")[0]
            if name == "UTCTime":
                expected["utc_time_ns"] = seconds_of(item[""])
            elif name in ("StatusWord", "StatusByte"):
                expected["status"] = int(item[""], 2)
            else:
                for key, (column, factor) in GOLDEN[name].items():
                    expected[column] = float(item[key]) * factor
            if name == "GNSSPVTData":
                date = [int(item[part]) for part in ("Year", "Month", "Day", "Hour", "Min", "Sec")]
                moment = datetime(*date, tzinfo=UTC)  # type: ignore[misc,arg-type]  # six integers are a date
                expected["gnss_utc_time_ns"] = int(moment.timestamp()) * 1_000_000_000 + int(item["Nano"])
        for shown in decoder.columns:
            value = block[shown.name][row]
            if shown.name in expected:
                assert value == pytest.approx(expected[shown.name], rel=1e-15), (row, shown.name)
                compared += 1
            elif shown.name not in ("arrival_time_ns", "utc_valid"):
                assert value == NO_INT or np.isnan(value), (row, shown.name)
    assert compared > 1800


@pytest.mark.parametrize("recording", ["mtdata2-1", "mtdata2-3"])
def test_recorded_output_configuration_is_reported_in_words(recording: str) -> None:
    payload = measured(f"xsens/{recording}/outputconfig.bin").read_bytes()
    decoder = MTData2Decoder()
    decoder.feed(xbus_message(0xC1, payload), 0)
    (notice,) = decoder.notices()
    precision = {"mtdata2-1": "float32", "mtdata2-3": "fp16.32"}[recording]
    assert "PacketCounter with every packet" in notice
    assert f"EulerAngles (ENU, {precision}) at 100 Hz" in notice
    assert "GnssPvtData at 4 Hz" in notice
    assert len(decoder.take()) == 0
    assert decoder.notices() == []


@pytest.mark.long
@given(st.integers(0, 9), chunkings, st.lists(st.integers(1, 90), min_size=1, max_size=10))
@settings(max_examples=40, deadline=None)
def test_any_chunking_gives_the_same_rows_times_and_counters(
    seed: int, lengths: list[int], reads: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    packets = mtdata2_encoder(TYPICAL).encode(samples(30, seed))
    packets.insert(5, xbus_message(0x42, b"\x1e"))
    data, _ = damage(packets, rng, 0.1, 0.1, 0.2)
    # The bytes of one read share their time of arrival.
    arrival = np.repeat(np.arange(1000), np.resize(reads, 1000))[: len(data)].tolist()
    data = data[: len(arrival)]
    whole, cut = MTData2Decoder(), MTData2Decoder()
    expected = feed_in_chunks(whole, data, [1 << 16], arrival)
    got = feed_in_chunks(cut, data, lengths, arrival)
    assert whole.counters() == cut.counters()
    assert whole.notices() == cut.notices()
    assert got.columns.keys() == expected.columns.keys()
    for name in expected.columns:
        np.testing.assert_array_equal(got[name], expected[name], err_msg=name)
    twin = decode_plainly(data, arrival, XBUS, ROLES, message_of)
    assert_same(got, twin.rows)
    counters = cut.counters()
    assert (counters.checksum_errors, counters.length_errors) == (twin.checksum_errors, twin.length_errors)
    assert (counters.bytes_in_packets, counters.bytes_skipped) == (twin.in_packets, twin.skipped)


def test_single_bytes_give_the_same_as_one_chunk() -> None:
    data = b"\xfa" + stream(20)
    block = feed_in_chunks(MTData2Decoder(), data, [1])
    expected = feed_in_chunks(MTData2Decoder(), data, [len(data)])
    for name in expected.columns:
        np.testing.assert_array_equal(block[name], expected[name])
    assert len(block) == 20


pieces = st.one_of(
    st.binary(max_size=30),
    st.sampled_from(
        [b"\xfa\xff", b"\xfa\xff\x36", b"\xfa\xff\x36\x06", b"\xfa\x01\x42\xff\x07\xd0", b"\xfa", b"\x75e"]
    ),
    st.sampled_from(mtdata2_encoder(["PacketCounter", "Temperature"]).encode(samples(3))),
    st.binary(max_size=8).map(lambda payload: xbus_message(0x42, payload)),
    st.binary(max_size=12).map(lambda payload: xbus_message(MTDATA2, payload)),
)


@given(st.lists(pieces, max_size=12).map(b"".join), chunkings)
@settings(max_examples=150, deadline=None)
def test_garbage_is_accounted_for_as_by_the_plain_twin(data: bytes, lengths: list[int]) -> None:
    arrival = [0] * len(data)
    decoder = MTData2Decoder()
    block = feed_in_chunks(decoder, data, lengths)
    twin = decode_plainly(data, arrival, XBUS, ROLES, message_of)
    counters = decoder.counters()
    assert counters.packets == len(twin.packets)
    assert (counters.checksum_errors, counters.length_errors) == (twin.checksum_errors, twin.length_errors)
    assert (counters.bytes_in_packets, counters.bytes_skipped) == (twin.in_packets, twin.skipped)
    assert_same(block, twin.rows)


@pytest.mark.parametrize("seed", range(4))
def test_no_whole_packet_is_lost_in_a_damaged_stream(seed: int) -> None:
    block = samples(6000, seed)
    packets = mtdata2_encoder(TYPICAL).encode(block)
    data, whole = damage(packets, np.random.default_rng(seed), 0.01, 0.005, 0.005)
    decoder = MTData2Decoder()
    got = feed_in_chunks(decoder, data, [1000, 77, 4096])
    found = {tuple(row) for row in np.column_stack([got["packet_counter"], got["status"]]).tolist()}
    expected = {(int(block["packet_counter"][i]), int(block["status"][i])) for i in whole}
    assert expected <= found
    # One damaged packet in 256 passes an eight-bit checksum.
    assert len(got) - len(whole) <= 3
    assert decoder.counters().checksum_errors > 50


def test_a_packet_that_swallowed_the_head_of_the_next_does_not_hide_it() -> None:
    """A packet that lost bytes takes them from the next; once in 256 times its checksum agrees."""
    first, second = (xbus_message(0x42, bytes(20)), stream(1))
    for lost in range(1, 8):
        cut = bytearray(first[:-lost])
        # Choose a byte such that the first message ends, with a right checksum, inside the second.
        swallowed = bytes(cut) + second[:lost]
        cut[10] = (cut[10] - sum(swallowed[1:])) & 0xFF
        data = bytes(cut) + second + stream(2, 1)
        for lengths in ([1], [len(data)], [len(first)]):
            decoder = MTData2Decoder()
            block = feed_in_chunks(decoder, data, lengths)
            assert block["packet_counter"].tolist() == [0, 0, 1], lost
            assert decoder.counters().bytes_in_packets == len(data)
            assert decoder.counters().bytes_skipped == 0


def test_messages_between_data_are_counted_and_never_taken_for_data() -> None:
    extended = xbus_message(0x0D, bytes(118) + bytes(1900))
    messages = [
        xbus_message(0x3E),
        xbus_message(0x42, b"\x29"),
        xbus_message(0x31),
        xbus_message(0xC1, b"\x40\x20\x00\x64"),
        extended,
        xbus_message(MTDATA, bytes(54)),
        xbus_message(0xEE, b"\x01", address=0x01),
    ]
    data = stream(3) + b"".join(message + stream(1, 5) for message in messages)
    decoder = MTData2Decoder()
    block = feed_in_chunks(decoder, data, [50])
    assert len(block) == 3 + len(messages)
    assert decoder.counters().packets_by_type == {
        "MTData2": 3 + len(messages),
        "WakeUp": 1,
        "Error": 1,
        "GoToConfigAck": 1,
        "OutputConfiguration": 1,
        "Configuration": 1,
        "MTData": 1,
        "0xEE": 1,
    }
    notices = "\n".join(decoder.notices())
    assert "error 41: more data than the link can carry" in notices
    assert "Acceleration (float32) at 100 Hz" in notices
    assert "xsens-legacy" in notices
    assert decoder.counters().bytes_skipped == 0


def test_a_payload_of_more_than_254_bytes_has_an_extended_length() -> None:
    names = [item.name for item in IDENTIFIERS if not item.raw and item.code not in (0x10A0, 0xE080, 0x7020)]
    names = [name for name in dict.fromkeys(names) if not name.startswith("Trigger")]
    (packet,) = mtdata2_encoder(names, "float64").encode(SampleBlock({"packet_counter": np.array([3])}))
    assert packet[3] == 255
    assert len(packet) == 7 + int.from_bytes(packet[4:6], "big") > 300
    decoder = MTData2Decoder()
    assert len(feed_in_chunks(decoder, packet, [3])) == 1
    assert decoder.counters().bytes_in_packets == len(packet)
    assert not any("not known" in text for text in decoder.notices())


def test_fields_that_overrun_the_payload_are_a_length_error() -> None:
    bad = xbus_message(MTDATA2, b"\x10\x20\x02\x00\x01\x40\x20\x0c\x00")
    decoder = MTData2Decoder()
    block = feed_in_chunks(decoder, bad + stream(2), [9])
    assert len(block) == 2
    assert decoder.counters().length_errors == 1
    assert decoder.counters().bytes_skipped == len(bad)


def test_unknown_fields_are_reported_once_and_the_rest_is_decoded() -> None:
    odd = (
        b"\x10\x20\x02\x00\x07"
        + b"\x77\x70\x03abc"
        + b"\x40\x20\x04\x00\x00\x00\x00"
        + b"\x08\x10\x04\x41\xa0\x00\x00"
    )
    decoder = MTData2Decoder()
    decoder.feed(xbus_message(MTDATA2, odd) * 3, 0)
    block = decoder.take()
    assert block["packet_counter"].tolist() == [7, 7, 7]
    assert block["temperature"].tolist() == [20, 20, 20]
    assert "accel_x" not in block
    assert decoder.notices() == [
        "field 0x7770 of 3 bytes is not known and is passed over",
        "field Acceleration (float32) of 4 bytes is not known and is passed over",
    ]
    assert decoder.notices() == []


def test_finish_finds_packets_behind_a_header_that_promises_too_much() -> None:
    liar, good = b"\xfa\xff\x36\xff\x07\x00", stream(2)
    tail = stream(1)[:-4]
    decoder = MTData2Decoder()
    decoder.feed(liar + good + tail, 5)
    assert len(decoder.take()) == 0
    assert decoder.counters().bytes_pending == len(liar + good + tail)
    decoder.finish()
    assert len(decoder.take()) == 2
    counters = decoder.counters()
    assert (counters.bytes_skipped, counters.bytes_pending) == (len(liar), len(tail))
    assert counters.checksum_errors == 0
    # The packet cut short may still be completed.
    decoder.feed(stream(1)[-4:], 6)
    assert decoder.take()["arrival_time_ns"].tolist() == [6]
    assert decoder.counters().bytes_pending == 0


def test_finish_twice_counts_nothing_twice() -> None:
    bad = bytearray(stream(1))
    bad[20] ^= 1
    data = bytes(bad) + b"\xfa\xff\x36\x30" + bytes(bad)[:40]
    once, twice = MTData2Decoder(), MTData2Decoder()
    once.feed(data, 0)
    once.finish()
    twice.feed(data, 0)
    twice.finish()
    twice.finish()
    assert once.counters() == twice.counters()


def test_columns_appear_when_the_device_begins_to_send_more() -> None:
    decoder = MTData2Decoder()
    decoder.feed(stream(2, names=["PacketCounter"]), 1)
    assert [column.name for column in decoder.columns] == ["arrival_time_ns", "packet_counter"]
    decoder.feed(stream(1, names=["PacketCounter", "Temperature"]), 2)
    block = decoder.take()
    assert [column.name for column in decoder.columns] == ["arrival_time_ns", "packet_counter", "temperature"]
    assert np.isnan(block["temperature"]).tolist() == [True, True, False]
    decoder.feed(stream(1, names=["PacketCounter"]), 3)
    assert np.isnan(decoder.take()["temperature"]).tolist() == [True]


def test_more_rows_than_the_preallocated_columns_hold() -> None:
    n = 8211
    decoder = MTData2Decoder()
    decoder.feed(stream(n, names=["PacketCounter"]), 1)
    assert decoder.take()["packet_counter"].tolist() == list(range(n))


@pytest.mark.parametrize("kind", [bytes, bytearray, memoryview])
def test_any_buffer_can_be_fed(kind: type) -> None:
    decoder = MTData2Decoder()
    decoder.feed(kind(stream(2)), 0)
    buffer: ByteArray = np.frombuffer(stream(2), np.uint8)
    decoder.feed(buffer, 0)
    assert len(decoder.take()) == 4


RESOLUTION = {"float32": 0.0, "fp12.20": 2.0**-21, "fp16.32": 2.0**-33, "float64": 0.0}


@pytest.mark.parametrize("precision", PRECISION_NAMES)
@given(values=st.lists(st.floats(-2000, 2000, width=32), min_size=3, max_size=30))
@settings(max_examples=25, deadline=None)
def test_round_trip_is_exact_to_the_resolution(precision: Precision, values: list[float]) -> None:
    n = len(values) // 3
    accel = np.array(values[: 3 * n], np.float64).reshape(n, 3)
    block = SampleBlock({f"accel_{axis}": accel[:, i] for i, axis in enumerate("xyz")})
    decoder = MTData2Decoder()
    decoder.feed(b"".join(mtdata2_encoder(["Acceleration"], precision).encode(block)), 0)
    back = decoder.take().accel
    assert back is not None
    np.testing.assert_allclose(back, accel, rtol=0, atol=RESOLUTION[precision])


@pytest.mark.parametrize("item", IDENTIFIERS, ids=lambda item: f"{item.code:04X}")
@pytest.mark.parametrize("precision", PRECISION_NAMES)
def test_every_identifier_makes_the_round_trip(item: Identifier, precision: Precision) -> None:
    rng = np.random.default_rng(item.code)
    n = 5
    columns, hidden = dict[str, ColumnArray](), dict[str, ColumnArray]()
    for value in item.numbers:
        if value.column is None or value.column.name.startswith("_"):
            continue
        # Whole numbers that every type can hold, in the unit of the device.
        numbers = rng.integers(0, 100, n)
        columns[value.column.name] = numbers if value.column.dtype == "int64" else numbers * value.factor
    names = [value.column.name for value in item.numbers if value.column is not None]
    if "_utc_year" in names or "_gnss_utc_year" in names:
        prefix = "utc_" if "_utc_year" in names else "gnss_utc_"
        moments = np.array([0, 1_548_000_000_999_999_999, 951_827_696_000_000_001, 1, 10**18])
        columns[f"{prefix}time_ns"], hidden = moments, date_of(prefix, moments)
    if item.name == "RotationMatrix":
        q = rng.normal(size=(4, n))
        q *= np.sign(q[0]) / np.linalg.norm(q, axis=0)
        columns.update(zip(("q_w", "q_x", "q_y", "q_z"), q, strict=True))
        hidden = matrix_of(q)
    decoder, sent = MTData2Decoder(), SampleBlock(columns | hidden)
    decoder.feed(b"".join(mtdata2_encoder([item.name], precision).encode(sent)), 0)
    got = decoder.take()
    assert {*got.columns} == {"arrival_time_ns", *columns}
    for name, values in columns.items():
        tolerance = 1e-5 if item.name == "RotationMatrix" else 2e-6 if item.name == "EulerAngles" else 1e-12
        np.testing.assert_allclose(got[name], values, rtol=1e-12, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("frame", ["ENU", "NED", "NWU"])
def test_the_reference_frame_is_reported_and_values_are_left_as_they_are(frame: Frame) -> None:
    decoder = MTData2Decoder()
    block = samples(1)
    decoder.feed(mtdata2_encoder(["Quaternion"], "float64", frame).encode(block)[0], 0)
    assert any(frame in notice for notice in decoder.notices())
    assert decoder.take()["q_x"].tolist() == block["q_x"].tolist()


def test_a_rotation_matrix_becomes_the_quaternion_that_turns_body_to_reference() -> None:
    # A quarter turn about the vertical: body x points to reference y.  The device sends the matrix column by
    # column, a to i, and R_GS = [a d g; b e h; c f i] turns body vectors to the reference frame.
    sent = np.array([0, 1, 0, -1, 0, 0, 0, 0, 1], ">f4").tobytes()
    decoder = MTData2Decoder()
    decoder.feed(xbus_message(MTDATA2, b"\x20\x20\x24" + sent), 0)
    half = np.sqrt(0.5)
    block = decoder.take()
    np.testing.assert_allclose([block[f"q_{a}"][0] for a in "wxyz"], [half, 0, 0, half], atol=1e-7)


def test_what_is_not_a_date_or_a_rotation_is_missing_and_raises_nothing() -> None:
    no_date = b"\x10\x10\x0c" + bytes(12)
    matrix = b"\x20\x23\x48" + np.array([-5, 1e300, np.nan, 0, -7, np.inf, 0, 0, -9], ">f8").tobytes()
    decoder = MTData2Decoder()
    decoder.feed(xbus_message(MTDATA2, no_date) + xbus_message(MTDATA2, matrix), 0)
    block = decoder.take()
    assert block["utc_time_ns"].tolist() == [NO_INT, NO_INT]
    assert np.isnan(block["q_w"]).all()


def test_a_field_without_values_is_left_out_of_the_row() -> None:
    block = SampleBlock({"packet_counter": np.array([1, 2]), "latitude": np.array([np.nan, 1.0])})
    packets = mtdata2_encoder(["PacketCounter", "LatLon"]).encode(block)
    assert [len(packet) for packet in packets] == [10, 21]
    decoder = MTData2Decoder()
    decoder.feed(b"".join(packets), 0)
    np.testing.assert_array_equal(decoder.take()["latitude"], [np.nan, 1.0])


@pytest.mark.parametrize(
    ("names", "precision", "column", "value"),
    [
        (["Acceleration"], "fp12.20", "accel_x", 2048.0),
        (["Acceleration"], "fp16.32", "accel_x", -32769.0),
        (["Acceleration"], "float32", "accel_x", 1e39),
        (["AnalogIn1"], "float32", "analog_1", 65536.0),
        (["StatusByte"], "float32", "status", 256),
        (["Acceleration"], "fp16.32", "accel_x", np.inf),
        (["BaroPressure"], "float32", "pressure", -1.0),
    ],
)
def test_a_value_that_does_not_fit_is_refused(
    names: list[str], precision: Precision, column: str, value: float
) -> None:
    with pytest.raises(ImumonError, match=column) as caught:
        mtdata2_encoder(names, precision).encode(SampleBlock({column: np.array([0, value])}))
    assert caught.value.reason is Reason.BAD_DATA


def test_counter_and_clock_wrap_as_in_the_device() -> None:
    block = SampleBlock(
        {"packet_counter": np.array([65_535, 65_536]), "device_ticks": np.array([1, (1 << 32) + 2])}
    )
    decoder = MTData2Decoder()
    decoder.feed(b"".join(mtdata2_encoder(["PacketCounter", "SampleTimeFine"]).encode(block)), 0)
    got = decoder.take()
    assert got["packet_counter"].tolist() == [65_535, 0]
    assert got["device_ticks"].tolist() == [1, 2]


def test_a_value_missing_in_a_field_that_is_sent_becomes_nan_or_zero() -> None:
    block = SampleBlock(
        {"accel_x": np.array([1.0]), "accel_y": np.array([np.nan]), "accel_z": np.array([2.0])}
    )
    decoder = MTData2Decoder()
    decoder.feed(mtdata2_encoder(["Acceleration"]).encode(block)[0], 0)
    decoder.feed(mtdata2_encoder(["Acceleration"], "fp16.32").encode(block)[0], 0)
    np.testing.assert_array_equal(decoder.take()["accel_y"], [np.nan, 0])


@pytest.mark.parametrize("name", ["Accelleration", "GnssPvtPulse"])
def test_an_identifier_that_cannot_be_encoded_is_refused(name: str) -> None:
    with pytest.raises(ImumonError, match=name) as caught:
        mtdata2_encoder([name])
    assert caught.value.reason is Reason.BAD_CONFIG


def test_identifiers_are_unique_and_do_not_share_columns_by_mistake() -> None:
    fields = [field for item in IDENTIFIERS if (field := item.message()) is not None]
    keys = [(item.code, field.size) for item, field in zip(IDENTIFIERS, fields, strict=True)]
    assert len(keys) == len(set(keys))
    units: dict[str, str] = {}
    for column in (column for field in fields for column in field.columns):
        assert units.setdefault(column.name, column.unit) == column.unit
    assert tuple(PRECISIONS) == ("float32", "fp12.20", "fp16.32", "float64")


def test_the_device_file_makes_a_decoder_that_reads_its_encoder() -> None:
    device = load_device("xsens")
    assert isinstance(device, MTData2Device)
    decoder = device.decoder()
    assert decoder.timing.counter_bits == 16
    assert decoder.timing.tick_ns == 100_000
    block = samples(10)
    decoder.feed(b"".join(device.encoder().encode(block)), 0)
    got = decoder.take()
    for name in block.columns:
        np.testing.assert_allclose(got[name], block[name], rtol=1e-6)
    check_books(decoder.counters())


@pytest.mark.parametrize("n", [0, 1, 8, 31, 60])
def test_satellites_are_columns_of_a_row_each_epoch(n: int) -> None:
    satellites = b"".join(bytes([k % 7, k + 1, 40 + k % 10, 0x18 | k % 8]) for k in range(n))
    message = xbus((0x7020, struct.pack(">IB3x", 345_600_250, n) + satellites))
    block = feed_in_chunks(MTData2Decoder(), message * 2, [11])
    assert block["gnss_time_of_week"].tolist() == [345_600.25] * 2
    assert block["gnss_satellites_seen"].tolist() == [n] * 2
    for k in range(n):
        assert block[f"gnss_sat{k + 1}_id"].tolist() == [k % 7 << 8 | k + 1] * 2
        assert block[f"gnss_sat{k + 1}_cno"].tolist() == [40 + k % 10] * 2
        assert block[f"gnss_sat{k + 1}_flags"].tolist() == [0x18 | k % 8] * 2
    assert f"gnss_sat{n + 1}_id" not in block


PARTS = ("id", "cno", "flags")


def test_satellites_that_are_sent_come_back() -> None:
    sent = {f"gnss_sat{k}_{what}": np.array([k, k + 1]) for k in range(1, 9) for what in PARTS}
    block = SampleBlock({**sent, "gnss_satellites_seen": np.array([8, 8])})
    back = feed_in_chunks(MTData2Decoder(), b"".join(mtdata2_encoder(["GnssSatInfo"]).encode(block)), [50])
    for name, values in sent.items():
        np.testing.assert_array_equal(back[name], values)
