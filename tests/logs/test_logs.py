"""Logs of autopilots and ROS bags become sessions."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import FloatArray, IntArray
from imumon.errors import ImumonError, Reason
from imumon.logs import ardupilot
from imumon.logs.importing import import_log
from imumon.logs.log import Series, _beside
from imumon.recordings.folder import open_session
from imumon.recordings.table import read_table
from tests.logs.made import DATAFLASH, dataflash, ulog

TIMES = "uint64_t timestamp;uint64_t timestamp_sample;uint32_t device_id;"
SENSOR, BARO = f"{TIMES}float x;float y;float z;float temperature;", f"{TIMES}float pressure;"


def imu(time_us: int, number: int, rate: float, temperature: float = 30.0) -> tuple[str, list[Any]]:
    values = [time_us, number, rate, -rate, 0.5, 0.1, 0.2, -9.8, 0, 0, temperature, 1, 1, 1000, 1000]
    return "IMU", values


def samples(session: Path) -> dict[str, Any]:
    opened = open_session(session)
    block, columns = read_table(opened.truth_path)
    assert opened.metadata.table is not None
    return {
        **block.columns,
        "units": {name: one.unit for name, one in columns.items()},
        "of": opened.metadata,
    }


def test_ardupilot(tmp_path: Path) -> None:
    rows = []
    for k in range(50):
        rows += [imu(1_000_000 + 10_000 * k, 0, 0.01 * k), imu(1_000_003 + 10_000 * k, 1, 7.0)]
        if k % 10 == 0:
            rows.append(("MAG", [1_002_000 + 10_000 * k, 0, 200, -100, 400]))
            rows.append(("BARO", [1_001_000 + 10_000 * k, 0, 12.0, 101_325.0]))
    rows.append(imu(1_000_000, 0, 9.0))
    dataflash(tmp_path / "flight.BIN", rows)
    report, log = import_log(tmp_path / "flight.BIN", None, tmp_path / "session")
    assert (log.sensor, log.others) == ("IMU.0", ["IMU.1"])
    assert (report.rows_in, report.rows_out, report.rows_dropped) == (51, 50, 1)
    found = samples(tmp_path / "session")
    np.testing.assert_allclose(found["gyro_x"], 0.01 * np.arange(50), rtol=1e-6)
    np.testing.assert_array_equal(found["device_time_ns"], (1_000_000 + 10_000 * np.arange(50)) * 1000)
    np.testing.assert_allclose(found["accel_z"], -9.8, rtol=1e-6)
    np.testing.assert_allclose(found["temperature"], 30.0)
    np.testing.assert_allclose(found["mag_x"][::10], 20.0)  # µT of 200 mGauss
    assert np.isnan(found["mag_x"]).sum() == 45
    np.testing.assert_allclose(found["pressure"][::10], 101_325.0)
    assert found["of"].axes == "FRD"
    assert found["of"].table.file == "flight.BIN"
    second, _ = import_log(tmp_path / "flight.BIN", "IMU.1", tmp_path / "second")
    assert second.rows_out == 50
    np.testing.assert_allclose(samples(tmp_path / "second")["gyro_x"], 7.0)


@pytest.mark.parametrize("wrong_us", [{7: 1}, {7: 10**12}, {7: 10**12, 35: 1, 20: 10**11}])
def test_a_wrong_time_takes_no_other_row_along(tmp_path: Path, wrong_us: dict[int, int]) -> None:
    rows = [imu(wrong_us.get(k, 1000 * k), 0, 0.1) for k in range(1, 40)]
    dataflash(tmp_path / "a.bin", rows)
    report, _ = import_log(tmp_path / "a.bin", None, tmp_path / "session")
    dropped = len(wrong_us)
    assert (report.rows_out, report.rows_dropped) == (39 - dropped, dropped)


def test_pymavlink_reads_the_same(tmp_path: Path) -> None:
    from pymavlink.DFReader import DFReader_binary

    rows = [imu(1000 * k, k % 2, 0.1 * k) for k in range(1, 40)]
    dataflash(tmp_path / "a.bin", [*rows, ("MAG", [500, 0, 200, -100, 400]), ("BARO", [600, 0, 1.0, 9e4])])
    found, damage = ardupilot._messages(tmp_path / "a.bin")
    theirs = DFReader_binary(str(tmp_path / "a.bin"))
    for name, fields in found.items():
        kind, number = name.split(".")
        theirs.rewind()
        messages = list(iter(partial(theirs.recv_match, type=[kind]), None))
        expected = [one for one in messages if int(number) == one.I]
        for field, values in fields.items():
            assert values.tolist() == [getattr(one, field) for one in expected]
    theirs.filehandle.close()
    theirs.data_map.close()
    assert found.keys() == {"IMU.0", "IMU.1", "MAG.0", "BARO.0"}
    assert damage.places == 0


def test_behind_a_damaged_place_the_log_goes_on(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    dataflash(tmp_path / "a.bin", [imu(1000 * k, 0, 0.1) for k in range(1, 400)])
    gyro = [(1000 * k + 5, 1000 * k, 1, 0.1, 0.2, 0.3, 40.0) for k in range(1, 400)]
    ulog(tmp_path / "a.ulg", {"sensor_gyro.0": (SENSOR, gyro)})
    random = np.random.default_rng(1)
    for path in (tmp_path / "a.bin", tmp_path / "a.ulg"):
        data = bytearray(path.read_bytes())
        hole = slice(len(data) // 4, len(data) // 4 + 500)
        for name, junk in (("0", bytes(500)), ("r", random.bytes(500)), ("f", b"\xff" * 500)):
            data[hole] = junk
            path.write_bytes(data)
            out = path.with_suffix(f"{path.suffix}-{name}")
            report, log = import_log(path, None, out)
            size = len(data) / 400
            assert 399 - 500 / size - 4 <= report.rows_out <= 399 - 500 / size + 1
            assert log.damage.places >= 1
            assert 450 <= log.damage.size <= 500 + 3 * size
            assert report.span_s == pytest.approx(0.398)
    assert capfd.readouterr() == ("", "")


def test_a_sensor_without_a_thermometer_has_no_temperature(tmp_path: Path) -> None:
    dataflash(tmp_path / "a.bin", [imu(1000 * k, 0, 0.0, 0.0) for k in range(1, 20)])
    import_log(tmp_path / "a.bin", None, tmp_path / "session")
    assert "temperature" not in samples(tmp_path / "session")


def test_px4_joins_gyro_and_accelerometer_of_a_number(tmp_path: Path) -> None:
    gyro = [(10 * k + 5, 10 * k, 1, 0.1, 0.2, 0.001 * k, 40.0 + k) for k in range(1, 100)]
    accel = [(20 * k + 5, 20 * k + 1, 2, 0.0, 0.0, -9.8, 39.0) for k in range(1, 50)]
    other = [(10 * k + 5, 10 * k, 3, 5.0, 5.0, 5.0, 40.0) for k in range(1, 100)]
    topics: dict[str, tuple[str, list[tuple[Any, ...]]]] = {
        "sensor_gyro.0": (SENSOR, gyro), "sensor_gyro.1": (SENSOR, other), "sensor_accel.0": (SENSOR, accel),
        "sensor_baro.0": (BARO, [(500, 501, 1, 99_000.0)]),
    }  # fmt: skip
    ulog(tmp_path / "log.ulg", topics)
    _, log = import_log(tmp_path / "log.ulg", None, tmp_path / "session")
    assert (log.sensor, log.others) == ("sensor_gyro.0", ["sensor_gyro.1"])
    found = samples(tmp_path / "session")
    np.testing.assert_array_equal(found["device_time_ns"], 10_000 * np.arange(1, 100))
    np.testing.assert_allclose(found["gyro_z"], 0.001 * np.arange(1, 100), rtol=1e-6)
    np.testing.assert_allclose(found["temperature"], 40.0 + np.arange(1, 100))
    # Each of its samples once, in the row nearest to it.
    there = np.isfinite(found["accel_z"])
    np.testing.assert_array_equal(np.flatnonzero(there) + 1, 2 * np.arange(1, 50))
    assert found["pressure"][49] == 99_000.0


def test_the_barometer_of_an_older_px4_is_in_millibar(tmp_path: Path) -> None:
    """Before v1.14 `sensor_baro.pressure` was in millibar, and nothing in the log says so."""
    gyro = [(10 * k + 5, 10 * k, 1, 0.1, 0.2, 0.3, 40.0) for k in range(1, 50)]
    for name, sent in (("old", 990.0), ("new", 99_000.0)):
        topics: dict[str, tuple[str, list[tuple[Any, ...]]]] = {
            "sensor_gyro.0": (SENSOR, gyro),
            "sensor_baro.0": (BARO, [(100 * k, 100 * k, 1, sent) for k in range(1, 5)]),
        }
        ulog(tmp_path / f"{name}.ulg", topics)
        import_log(tmp_path / f"{name}.ulg", None, tmp_path / name)
        pressure = samples(tmp_path / name)["pressure"]
        np.testing.assert_allclose(pressure[np.isfinite(pressure)], 99_000.0)


def test_the_sensors_of_an_older_ardupilot_have_messages_of_their_own(tmp_path: Path) -> None:
    """Before 4.1 there is no number in the message: IMU, IMU2, IMU3."""
    columns = "TimeUS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T"
    rows = [
        (name, [1000 * k, rate, 0.0, 0.0, 0.0, 0.0, -9.8, 0, 0, 30.0])
        for k in range(1, 30)
        for name, rate in (("IMU", 0.1), ("IMU2", 0.2))
    ]
    kinds = {name: (129 + k, "QffffffIIf", columns) for k, name in enumerate(("IMU", "IMU2"))}
    dataflash(tmp_path / "old.BIN", rows, kinds)
    _, log = import_log(tmp_path / "old.BIN", None, tmp_path / "first")
    assert (log.sensor, log.others) == ("IMU.0", ["IMU.1"])
    import_log(tmp_path / "old.BIN", "IMU.1", tmp_path / "second")
    np.testing.assert_allclose(samples(tmp_path / "first")["gyro_x"], 0.1, rtol=1e-6)
    np.testing.assert_allclose(samples(tmp_path / "second")["gyro_x"], 0.2, rtol=1e-6)


def test_a_log_whose_messages_have_no_known_time_is_refused(tmp_path: Path) -> None:
    kinds = {"IMU": (129, "Iffffff", "TimeMS,GyrX,GyrY,GyrZ,AccX,AccY,AccZ")}
    dataflash(tmp_path / "old.BIN", [("IMU", [k, 0.1, 0.2, 0.3, 0.0, 0.0, -9.8]) for k in range(20)], kinds)
    with pytest.raises(ImumonError, match=r"old\.BIN: none of the 20 samples of IMU\.0 has a time"):
        import_log(tmp_path / "old.BIN", None, tmp_path / "session")


@pytest.mark.parametrize(
    ("layout", "columns"),
    [
        ("QBfffnffIIfBBHH", "TimeUS,I,GyrX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),  # a flipped bit
        ("QBffffffIIfBBHH", "TimeUS,I,GyzX,GyrY,GyrZ,AccX,AccY,AccZ,EG,EA,T,GH,AH,GHz,AHz"),
        ("QBffffffIIfBBHH", "TimeUS,I,a,b,c,d,e,f,g,h,T,i,j,k,l"),
    ],
)
def test_a_log_whose_sensor_has_no_rates_is_refused_by_its_own_name(
    tmp_path: Path, layout: str, columns: str
) -> None:
    path = tmp_path / "a.BIN"
    dataflash(path, [imu(1000 * k, 0, 0.1) for k in range(20)])
    before = path.read_bytes()
    form, names = (text.encode() for text in DATAFLASH["IMU"][1:])
    path.write_bytes(
        before.replace(form, layout.encode(), 1).replace(names, columns.encode().ljust(len(names), b"\0"), 1)
    )
    with pytest.raises(ImumonError, match=r"a\.BIN: there is no gyro") as refused:
        import_log(path, None, tmp_path / "session")
    assert refused.value.reason is Reason.BAD_DATA


@pytest.mark.parametrize("left", [1, 2, 3, 40])
def test_a_message_that_was_cut_is_damage(tmp_path: Path, left: int) -> None:
    dataflash(tmp_path / "a.bin", [imu(1000 * k, 0, 0.1) for k in range(1, 21)])
    data = (tmp_path / "a.bin").read_bytes()
    last = data.rfind(ardupilot.MARK)
    (tmp_path / "a.bin").write_bytes(data[: last + left])
    report, log = import_log(tmp_path / "a.bin", None, tmp_path / "session")
    assert (report.rows_out, log.damage.places, log.damage.size) == (19, 1, left)


def test_an_infinite_value_is_missing_and_the_log_is_taken(tmp_path: Path) -> None:
    rows = [imu(1000 * k, 0, np.inf if k == 5 else 0.1) for k in range(1, 21)]
    dataflash(tmp_path / "a.bin", rows)
    report, _ = import_log(tmp_path / "a.bin", None, tmp_path / "session")
    assert report.rows_out == 20
    found = samples(tmp_path / "session")
    assert np.flatnonzero(np.isnan(found["gyro_x"])).tolist() == [4]
    np.testing.assert_allclose(found["accel_z"], -9.8, rtol=1e-6)


def bag(path: Path, stamps: IntArray, rate: FloatArray, dated: bool = True) -> None:
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    of = store.types
    header_of, time_of = of["std_msgs/msg/Header"], of["builtin_interfaces/msg/Time"]
    vector, unknown = of["geometry_msgs/msg/Vector3"], np.zeros(9)
    none = np.r_[-1.0, np.zeros(8)]
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        topics = {
            name: writer.add_connection(name, kind, typestore=store)
            for name, kind in (("/b/imu", "sensor_msgs/msg/Imu"), ("/t", "sensor_msgs/msg/Temperature"))
        }
        for time_ns, value in zip(stamps.tolist(), rate.tolist(), strict=True):
            header = header_of(time_of(*(divmod(time_ns, 10**9) if dated else (0, 0))), "imu")
            q = of["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0)
            message = of["sensor_msgs/msg/Imu"](
                header, q, none, vector(value, 0.0, 0.0), unknown, vector(0.0, 0.0, 9.8), unknown
            )
            writer.write(topics["/b/imu"], time_ns + 5, store.serialize_cdr(message, "sensor_msgs/msg/Imu"))
            warm = of["sensor_msgs/msg/Temperature"](header, 25.0 + value, 0.0)
            kind = "sensor_msgs/msg/Temperature"
            writer.write(topics["/t"], time_ns + 5, store.serialize_cdr(warm, kind))


@pytest.mark.parametrize("folder", [True, False])
def test_a_ros_bag(tmp_path: Path, folder: bool) -> None:
    stamps = 1_700_000_000_000_000_000 + 5_000_000 * np.arange(40)
    bag(tmp_path / "drive", stamps, np.linspace(0.0, 1.0, 40))
    path = tmp_path / "drive" if folder else next((tmp_path / "drive").glob("*.mcap"))
    report, log = import_log(path, None, tmp_path / "session")
    assert log.sensor == "/b/imu"
    assert not report.warnings
    found = samples(tmp_path / "session")
    np.testing.assert_array_equal(found["device_time_ns"], stamps)
    np.testing.assert_allclose(found["gyro_x"], np.linspace(0.0, 1.0, 40))
    np.testing.assert_allclose(found["temperature"], 25.0 + np.linspace(0.0, 1.0, 40))
    assert "q_w" not in found
    assert found["of"].axes == "FLU"
    with pytest.raises(ImumonError, match="there is no sensor '/c/imu'") as refused:
        import_log(path, "/c/imu", tmp_path / "other")
    assert "/b/imu" in refused.value.hint


def test_a_bag_without_times_in_its_headers_is_dated_by_the_recorder_with_a_warning(tmp_path: Path) -> None:
    stamps = 1_700_000_000_000_000_000 + 5_000_000 * np.arange(40)
    bag(tmp_path / "drive", stamps, np.linspace(0.0, 1.0, 40), dated=False)
    report, _ = import_log(tmp_path / "drive", None, tmp_path / "session")
    np.testing.assert_array_equal(samples(tmp_path / "session")["device_time_ns"], stamps + 5)
    assert len(report.warnings) == 1
    assert "/b/imu: 40 of 40 headers have no time" in report.warnings[0]


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"a,b\n1,2\n",
        b"ULog\x01\x12\x35" + bytes(20),
        b"\xa3\x95\x80" + bytes(200),
        b"\x89MCAP0\r\n" + bytes(9),
    ],
)
def test_what_is_no_log_is_refused_with_one_clear_error(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "x").write_bytes(content)
    with pytest.raises(ImumonError) as refused:
        import_log(tmp_path / "x", None, tmp_path / "session")
    assert refused.value.reason in (Reason.BAD_DATA, Reason.BAD_CONFIG)
    assert not (tmp_path / "session").exists()


@settings(max_examples=40, deadline=None)
@given(cut=st.integers(0, 5000), flip=st.integers(0, 5000), value=st.integers(0, 255))
def test_a_damaged_log_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, cut: int, flip: int, value: int
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    dataflash(folder / "a.bin", [imu(1000 * k, 0, 0.1) for k in range(1, 40)])
    gyro = [(10 * k + 5, 10 * k, 1, 0.1, 0.2, 0.3, 40.0) for k in range(1, 40)]
    ulog(folder / "a.ulg", {"sensor_gyro.0": (SENSOR, gyro)})
    for path in (folder / "a.bin", folder / "a.ulg"):
        data = bytearray(path.read_bytes())
        data[flip % len(data)] = value
        path.write_bytes(data[: len(data) - cut % len(data)])
        try:
            report, _ = import_log(path, None, path.with_suffix(".session"))
        except ImumonError:
            continue
        assert 0 < report.rows_out <= 39


@given(
    rows=st.lists(st.integers(0, 1000), min_size=1, unique=True).map(sorted),
    others=st.lists(st.integers(-10, 1010)),
)
def test_what_is_put_beside_stands_in_the_nearest_row_once(rows: list[int], others: list[int]) -> None:
    times, values = np.array(rows, np.int64), np.arange(len(others), dtype=np.float64)
    found = _beside(Series(np.array(others, np.int64), {"a": values}), times)["a"]
    taken = found[np.isfinite(found)]
    assert len(set(taken.tolist())) == len(taken)
    for row in np.flatnonzero(np.isfinite(found)):
        distance = abs(others[int(found[row])] - rows[row])
        assert distance == min(abs(others[int(found[row])] - time) for time in rows)


@pytest.mark.parametrize("wrong", [3_600_000, -50_000])
def test_what_is_far_from_all_rows_stands_in_none(wrong: int) -> None:
    """A sample of the magnetometer with a wrong time, or of before the gyro began, is not of the last row."""
    rows = np.arange(0, 1000, 10, dtype=np.int64)
    others = np.append(np.arange(200, 800, 100), wrong).astype(np.int64)
    found = _beside(Series(others, {"a": np.append(np.zeros(6), 9.0)}), rows)["a"]
    assert np.isfinite(found).sum() == 6
    assert not np.any(found == 9.0)
