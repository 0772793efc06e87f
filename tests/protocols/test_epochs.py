"""Streams of devices that spread one moment over packets and send other times between them."""

from __future__ import annotations

import struct
from dataclasses import asdict
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import FloatArray, SampleBlock, join
from imumon.clock.side import HeldReadings
from imumon.pipeline import UNDATED, Digest, Pipeline
from imumon.protocols.base import Groups, Packets
from imumon.protocols.device import load_device
from imumon.protocols.epochs import EpochAssembler, Epochs
from imumon.protocols.inertialsense import InertialSenseDecoder
from imumon.protocols.mavlink import MavlinkDecoder
from tests.data_folder import measured
from tests.protocols.wire import mip, mip_time, mip_vector, mtdata2_gnss, mtdata2_inertial, xbus

START = 1_700_000_000_000_000_000
MS = 1_000_000
MAVLINK, INERTIAL_SENSE = MavlinkDecoder(), InertialSenseDecoder()


def run(
    device: str, data: bytes, chunk: int | None = None
) -> tuple[SampleBlock, dict[str, SampleBlock], Pipeline]:
    """Feed a stream in chunks; return the main rows, those of each side stream, and the pipeline."""
    pipeline = Pipeline(load_device(device))
    main: list[SampleBlock] = []
    side: dict[str, list[SampleBlock]] = {}
    size = chunk or max(len(data), 1)
    for at in range(0, len(data), size):
        pipeline.feed(data[at : at + size], UNDATED)
        main.append(pipeline.take())
        for name, rows in pipeline.side.items():
            side.setdefault(name, []).append(rows)
    pipeline.finish()
    main.append(pipeline.take())
    for name, rows in pipeline.side.items():
        side.setdefault(name, []).append(rows)
    return join(main), {name: join(parts) for name, parts in side.items()}, pipeline


def _mti(n: int, counted: str, lost: tuple[int, ...] = ()) -> list[bytes]:
    """Inertial messages at 170 Hz and a receiver's at 7 Hz, dated back by 42 ms."""
    packets, counter, own = [], 65500, 100
    for k in range(n):
        ticks = 4_294_960_000 + k * 59
        packets.append(mtdata2_inertial(None if counted == "not" else counter, ticks, k / n))
        counter += 1
        if k % 25 == 24:
            number = {"shared": counter, "own": own, "not": None}[counted]
            packets.append(mtdata2_gnss(number, ticks - 420, 40 * k))
            counter += counted == "shared"
            own += 1
    return [packet for i, packet in enumerate(packets) if i not in lost]


def test_a_receiver_with_many_satellites_stays_apart_from_the_inertial_rows() -> None:
    sats = b"\0\0\0\0" + bytes([40, 0, 0, 0]) + bytes(4 * 40)
    packets = [
        xbus(
            (0x1060, struct.pack(">I", 100 * k)),
            (0x4020, bytes(12)),
            (0x8020, bytes(12)),
            *((code, bytes(size)) for code, size in ((0x2010, 16), (0xE020, 4), (0x0810, 4), (0xC020, 12))),
            *([(0x7010, bytes(94)), (0x7020, sats)] if k % 10 == 0 else []),
        )
        for k in range(200)
    ]
    main, side, _ = run("xsens", b"".join(packets))
    assert len(main) == 200
    assert not [name for name in main.columns if name.startswith("gnss_")]
    assert len(side["gnss"]) == 20
    assert {"gnss_fix_type", "gnss_sat40_cno"} <= side["gnss"].columns.keys()


@pytest.mark.parametrize("counted", ["shared", "own", "not"])
def test_a_receiver_that_dates_back_is_a_stream_of_its_own(counted: str) -> None:
    packets = _mti(4746, counted)
    main, side, pipeline = run("xsens", b"".join(packets))
    counters = pipeline.counters
    assert counters.clock_restarts == counters.packets_missing == counters.counter_gaps == 0
    assert np.isfinite(main["gyro_x"]).all()
    assert len(main) == 4746
    assert not (main["segment"] != 0).any()
    np.testing.assert_array_equal(np.diff(main["device_time_ns"]), 59 * 100_000)
    gnss = side["gnss"]
    assert len(gnss) == 4746 // 25
    np.testing.assert_allclose(gnss["gnss_time_of_week"], 0.04 * np.arange(24, 4746, 25))
    # The receiver's time is on the main clock, across its wrap.
    behind = main["device_time_ns"][24::25] - gnss["device_time_ns"]
    np.testing.assert_array_equal(behind, 42 * MS)
    assert "gnss_latitude" not in main
    assert "gyro_x" not in gnss
    assert asdict(counters.streams["gnss"])["rows"] == 189


@pytest.mark.parametrize("counted", ["shared", "own"])
def test_losses_beside_a_receiver_are_counted(counted: str) -> None:
    # Two inertial messages in a row, one right before a receiver's message, one right behind.
    packets = _mti(500, counted, lost=(10, 11, 24, 52))
    _, _, pipeline = run("xsens", b"".join(packets))
    assert pipeline.counters.packets_missing == 4
    assert pipeline.counters.clock_restarts == 0


def test_a_lost_receiver_message_of_a_shared_counter_is_a_loss() -> None:
    packets = _mti(500, "shared", lost=(25,))
    _, side, pipeline = run("xsens", b"".join(packets))
    assert pipeline.counters.packets_missing == 1
    assert len(side["gnss"]) == 19


def test_a_restart_of_the_main_stream_is_still_detected() -> None:
    packets = _mti(300, "shared") + _mti(300, "shared")
    pipeline = Pipeline(load_device("xsens"))
    for number, packet in enumerate(packets):
        pipeline.feed(packet, START + number * 6 * MS)
    pipeline.finish()
    main = pipeline.take()
    assert pipeline.counters.clock_restarts == 1
    assert len(main) == 600
    assert set(main["segment"].tolist()) == {0, 1}


def _mip_epochs(n: int, split: bool) -> list[bytes]:
    """Sensor data at 125 Hz in one or three packets, magnetometer in every second; filter at 20 Hz."""
    packets = []
    for k in range(n):
        time = 282_809_000_000 + k * 8 * MS
        gyro, accel = mip_vector(0x05, (k, 0.1, 0.2)), mip_vector(0x04, (0.0, 0.0, 1.0))
        mag = mip_vector(0x06, (k, 0.0, 0.0))
        if split:
            packets += [mip(0x80, mip_time(time), gyro), mip(0x80, mip_time(time), accel)]
            if k % 2 == 0:
                packets.append(mip(0x80, mag))
        else:
            packets.append(mip(0x80, mip_time(time), gyro, accel, *([mag] if k % 2 == 0 else [])))
        if k % 6 == 5:
            euler = struct.pack(">3fH", k, 0.0, 0.0, 1)
            packets.append(mip(0x82, mip_time(time + 3 * MS), (0x05, euler)))
    return packets


def test_packets_of_one_moment_are_one_row() -> None:
    main, side, pipeline = run("microstrain", b"".join(_mip_epochs(600, split=True)))
    whole, whole_side, _ = run("microstrain", b"".join(_mip_epochs(600, split=False)))
    assert main.columns.keys() == whole.columns.keys()
    for name in whole.columns:
        np.testing.assert_array_equal(main[name], whole[name], err_msg=name)
    np.testing.assert_array_equal(side["filter"]["roll"], whole_side["filter"]["roll"])
    assert len(main) == 600
    assert np.isfinite(main["gyro_x"]).all()
    assert np.isfinite(main["accel_x"]).all()
    assert np.isfinite(main["mag_x"]).sum() == 300
    assert pipeline.counters.clock_restarts == 0
    assert pipeline.counters.streams["imu"].incomplete == 0
    assert pipeline.counters.streams["imu"].packets == 1500


def test_an_epoch_that_lost_a_packet_comes_out_as_it_is_and_is_counted() -> None:
    packets = _mip_epochs(600, split=True)
    accel = [i for i, packet in enumerate(packets) if packet[2] == 0x80 and 0x04 in packet[14:16]]
    del packets[accel[400]]
    main, _, pipeline = run("microstrain", b"".join(packets))
    assert len(main) == 600
    assert np.isfinite(main["gyro_x"]).all()
    assert np.isnan(main["accel_x"]).sum() == 1
    assert pipeline.counters.streams["imu"].incomplete == 1


@pytest.mark.parametrize("first", ["filter", "sensor"])
def test_a_filter_with_the_times_of_the_sensors_joins_their_rows(first: str) -> None:
    packets = []
    for k in range(200):
        time = mip_time(k * 10 * MS)
        sensor = mip(0x80, time, mip_vector(0x05, (k, 0, 0)), mip_vector(0x04, (0, 0, 1)))
        euler = mip(0x82, time, (0x05, struct.pack(">3fH", k, 0.0, 0.0, 1)))
        packets += [euler, sensor] if first == "filter" else [sensor, euler]
    main, side, _ = run("microstrain", b"".join(packets))
    assert not side
    assert len(main) == 200
    np.testing.assert_array_equal(main["roll"], np.arange(200.0))
    np.testing.assert_array_equal(main["gyro_x"], np.arange(200.0))


def test_a_slow_magnetometer_with_a_time_of_its_own_is_a_stream_of_its_own() -> None:
    packets = []
    for k in range(400):
        time = k * 8 * MS
        packets.append(mip(0x80, mip_time(time), mip_vector(0x05, (0, 0, 0)), mip_vector(0x04, (0, 0, 1))))
        if k % 6 == 2:
            packets.append(mip(0x80, mip_time(time + 5 * MS), mip_vector(0x06, (k, 0, 0))))
    main, side, pipeline = run("microstrain", b"".join(packets))
    assert len(main) == 400
    assert "mag_x" not in main
    assert len(side["mag"]) == 67
    assert pipeline.counters.streams["mag"].rate_hz == pytest.approx(1 / 0.048)
    np.testing.assert_array_equal(side["mag"]["device_time_ns"][1:4], np.array([69, 117, 165]) * MS)


@pytest.mark.parametrize("chunk", [None, 700])
def test_a_thermometer_with_a_time_of_its_own_is_held_in_the_main_rows(chunk: int | None) -> None:
    packets = []
    for k in range(400):
        time = k * 8 * MS
        packets.append(mip(0x80, mip_time(time), mip_vector(0x05, (0, 0, 0)), mip_vector(0x04, (0, 0, 1))))
        if k % 100 == 50:
            packets.append(mip(0x80, mip_time(time + 3 * MS), mip_vector(0x14, (k, k, k))))
    main, side, pipeline = run("microstrain", b"".join(packets), chunk)
    np.testing.assert_array_equal(side["temperature"]["temperature"], [50, 150, 250, 350])
    assert "temperature" in {column.name for column in pipeline.columns}
    held = main["temperature"]
    assert np.isnan(held[:51]).all()
    # Until it is known what the stream sends, a reading is complete when the next one comes.
    np.testing.assert_array_equal(held[[155, 255, 355]], [50, 150, 250])


def test_messages_split_by_the_device_count_as_one_row_and_lose_nothing() -> None:
    packets = []
    for k in range(300):
        time = (0x1060, struct.pack(">I", 100 * k))
        for part, code in enumerate((0x4020, 0x8020)):
            counter = (0x1020, struct.pack(">H", 2 * k + part))
            packets.append(xbus(counter, time, (code, struct.pack(">3f", k, 0, 0))))
    main, _, pipeline = run("xsens", b"".join(packets))
    assert len(main) == 300
    assert np.isfinite(main["gyro_x"]).all()
    assert np.isfinite(main["accel_x"]).all()
    assert pipeline.counters.packets_missing == 0
    del packets[401]
    main, _, pipeline = run("xsens", b"".join(packets))
    assert len(main) == 300
    assert pipeline.counters.packets_missing == 1
    assert pipeline.counters.streams["imu"].incomplete == 1


def test_once_learned_a_row_comes_out_with_its_last_packet() -> None:
    packets = _mti(200, "not")
    pipeline = Pipeline(load_device("xsens"))
    pipeline.feed(b"".join(packets[:150]))
    before = len(pipeline.take())
    pipeline.feed(packets[150])
    assert len(pipeline.take()) == 1
    assert before == 150 - 150 // 26


def test_a_silent_port_lets_out_what_waits() -> None:
    packets = _mti(3, "not")
    pipeline = Pipeline(load_device("xsens"))
    pipeline.feed(b"".join(packets))
    assert len(pipeline.take()) == 2
    pipeline.pause()
    assert len(pipeline.take()) == 1


@pytest.mark.parametrize(
    ("file", "device", "streams"),
    [
        ("microstrain/stream.bin", "microstrain", {"imu": (2265, 125.0), "filter": (361, 20.0)}),
        ("xsens/mtdata2-1/output.bin", "xsens", {"imu": (96, 100.0), "gnss": (4, 4.0)}),
        ("xsens/mtdata2-3/output.bin", "xsens", {"imu": (96, 100.0), "gnss": (4, 4.0)}),
    ],
)
def test_captures_are_streams_without_holes(
    file: str, device: str, streams: dict[str, tuple[int, float]]
) -> None:
    main, _, pipeline = run(device, measured(file).read_bytes(), 997)
    counters = pipeline.counters
    assert counters.clock_restarts == counters.packets_missing == 0
    assert {name: (s.rows, round(s.rate_hz or 0, 6)) for name, s in counters.streams.items()} == streams
    assert all(s.gaps == s.incomplete == s.restarts == 0 for s in counters.streams.values())
    for name in ("gyro_x", "accel_z"):
        assert np.isfinite(main[name]).all()


def _digest(main: SampleBlock, side: dict[str, SampleBlock]) -> str:
    digest = Digest()
    digest.update(main, side)
    return digest.hexdigest()


@cache
def _xsens_stream() -> tuple[str, list[bytes]]:
    return "xsens", _mti(60, "shared")


@cache
def _microstrain_stream() -> tuple[str, list[bytes]]:
    return "microstrain", _mip_epochs(60, split=True)


@pytest.mark.long
@given(chunk=st.integers(1, 3000), seed=st.integers(0, 50))
@settings(max_examples=30, deadline=None)
def test_any_chunking_gives_the_same_rows(chunk: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    device, packets = (_xsens_stream, _microstrain_stream)[seed % 2]()
    data = b"".join(packet for packet in packets if rng.random() > 0.05)
    main, side, pipeline = run(device, data)
    again, again_side, other = run(device, data, chunk)
    assert _digest(main, side) == _digest(again, again_side)
    assert pipeline.counters == other.counters


def _with_value(key: int, time: int, value: float) -> bytes:
    """Return a message of MAVLink (29, 105) or Inertial Sense (11, 58) that has this in one column."""
    if key == 29:
        return MAVLINK.wrap(key, struct.pack("<Iffhh", time, value, 0.0, 0, 0))
    if key == 105:
        numbers = [*[0.0] * 9, value, 0.0, 0.0, 20.0]
        return MAVLINK.wrap(key, struct.pack("<Q13fH", time * 1000, *numbers, 0))
    size = INERTIAL_SENSE.messages[key].size
    return INERTIAL_SENSE.wrap(key, struct.pack("<dIf", time / 1000, 0, value).ljust(size, b"\0"))


@given(st.lists(st.tuples(st.booleans(), st.integers(0, 6)), max_size=80), st.integers(1, 300))
@pytest.mark.parametrize(
    ("device", "keys", "column", "scale"),
    [("mavlink", (105, 29), "pressure", 100.0), ("inertialsense", (58, 11), "gyro_x", 1.0)],
)
@settings(max_examples=40, deadline=None)
def test_messages_with_the_same_quantity_lose_none_of_it(
    device: str, keys: tuple[int, int], column: str, scale: float, parts: list[tuple[bool, int]], chunk: int
) -> None:
    """Every value is in exactly one row of one stream, whichever came first, and whatever the reads."""
    data = b"".join(
        _with_value(keys[second], 1000 + time, number + 1.0) for number, (second, time) in enumerate(parts)
    )
    main, side, _ = run(device, data)
    found = [block[column] / scale for block in (main, *side.values()) if column in block]
    values = np.concatenate([np.zeros(0), *found])
    np.testing.assert_allclose(
        np.sort(values[np.isfinite(values)]), np.arange(1.0, len(parts) + 1), rtol=1e-6
    )
    assert _digest(main, side) == _digest(*run(device, data, chunk)[:2])


@pytest.mark.parametrize("cuts", [[0, 4], [0, 1, 2, 3, 4]])
def test_a_packet_of_two_groups_stays_in_the_main_row_that_took_one(cuts: list[int]) -> None:
    groups = Groups.of([{"gyro": "imu", "mag": "mag"}, {"gyro": "imu"}, {"mag": "mag"}, {"temperature": "t"}])
    nan = np.nan
    columns = {
        "device_ticks": np.array([5, 5, 5, 6]),  # mag and temperature; a row that has a mag; again; the next
        "gyro": np.array([nan, 1.0, 2.0, 3.0]),
        "mag": np.array([7.0, 8.0, nan, nan]),
        "temperature": np.array([9.0, nan, nan, nan]),
    }
    belongs = np.array([0b110, 0b011, 0b001, 0b001])
    assembler, main, mag = EpochAssembler(groups), list[SampleBlock](), list[SampleBlock]()
    for a, b in pairwise(cuts):
        block = SampleBlock({name: values[a:b] for name, values in columns.items()})
        streams = assembler.process(Packets(block, belongs[a:b]), end=b == 4)
        main.append(streams["imu"].block)
        mag += [streams[name].block for name in ("mag",) if name in streams]
    np.testing.assert_array_equal(join(main)["gyro"], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(join(main)["mag"], [8.0, nan, nan])
    np.testing.assert_array_equal(join(main)["temperature"], [9.0, nan, nan])
    np.testing.assert_array_equal(join(mag)["mag"], [7.0])


def test_a_barometer_beside_one_of_the_inertial_message_is_a_stream() -> None:
    """HIGHRES_IMU at 50 Hz has a pressure; SCALED_PRESSURE at 1 Hz, 1 ms off, too."""
    packets = []
    for k in range(1000):
        packets.append(_with_value(105, 5000 + 20 * k, 1000.0 + k))
        packets += [_with_value(29, 5001 + 20 * k, 5.0)] if k % 50 == 0 else []
    main, side, _ = run("mavlink", b"".join(packets), 4096)
    np.testing.assert_array_equal(main["pressure"], 100 * (1000.0 + np.arange(1000)))
    np.testing.assert_array_equal(side["pressure"]["pressure"], np.full(20, 500.0))


def test_a_reading_of_its_own_counts_before_a_held_one() -> None:
    """A slow thermometer came before the rows that have a temperature of theirs: these are not replaced."""
    held = HeldReadings()
    one = np.zeros(1, np.int64)
    side = [
        Epochs(SampleBlock({"temperature": np.array([value])}), one, one + until, one)
        for value, until in ((20.0, 3), (21.0, 1))
    ]
    empty = SampleBlock({"gyro_x": np.zeros(4)})
    first = held.process(empty, dict(zip("ab", side, strict=True)))
    np.testing.assert_array_equal(first["temperature"], [np.nan, 21.0, 21.0, 20.0])
    rows = empty.with_columns({"temperature": np.array([30.0, np.nan, 31.0, np.nan])})
    np.testing.assert_array_equal(held.process(rows, {})["temperature"], [30.0, 20.0, 31.0, 20.0])


@given(st.lists(st.tuples(st.integers(0, 5), st.integers(0, 6), st.booleans()), max_size=80))
@settings(max_examples=60, deadline=None)
def test_no_field_is_lost_whatever_comes(parts: list[tuple[int, int, bool]]) -> None:
    """Every value sent is in exactly one row of one stream."""
    packets, sent = [], []
    for number, (what, time, timed) in enumerate(parts):
        value = float(number + 1)
        stamp = [mip_time(time * MS)] if timed else []
        if what < 3:
            packets.append(mip(0x80, *stamp, mip_vector((0x05, 0x04, 0x06)[what], (value, 0, 0))))
        else:
            packets.append(mip(0x82, *stamp, (0x05, struct.pack(">3fH", value, 0.0, 0.0, 1))))
        sent.append(value)
    main, side, _ = run("microstrain", b"".join(packets))
    found: list[FloatArray] = []
    for block in (main, *side.values()):
        scales = {"gyro_x": 1.0, "accel_x": 9.80665, "mag_x": 100.0, "roll": 1.0}
        found += [block[name] / scale for name, scale in scales.items() if name in block]
    values = np.concatenate(found) if found else np.zeros(0)
    np.testing.assert_allclose(np.sort(values[np.isfinite(values)]), sorted(sent), rtol=1e-6)
