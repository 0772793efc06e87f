"""Samples in files of other programs, read back by readers that are not imumon's."""

from __future__ import annotations

import json
import sys
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.io import loadmat

from imumon.blocks import FloatArray, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.logs.importing import import_log
from imumon.pipeline import Pipeline
from imumon.recordings.exports import convert, export_run, read_npz
from imumon.recordings.importing import import_table
from imumon.recordings.ros2 import SECOND_NS, write_ros2
from imumon.recordings.source import open_source, run_over
from imumon.recordings.table import TableWriter
from tests.protocols.wire import mtdata2_gnss, mtdata2_inertial

N, START_NS = 400, 1_700_000_000 * SECOND_NS
ATTITUDE = [Column(f"attitude_estimate_{name}", "1") for name in (*"wxyz", "tilt_sd", "heading_sd")]
BIAS = [Column(f"{name}_{axis}", "rad/s") for name in ("gyro_bias", "gyro_bias_sd") for axis in "xyz"]
FLAGS = [Column(name, "1", "int64") for name in ("at_rest", "attitude_estimate_north")]
COLUMNS = {one.name: one for one in [*KNOWN.values(), *ATTITUDE, *BIAS, *FLAGS]}


def samples() -> SampleBlock:
    """Return 4 s of a forward-right-down unit that looks to the north, with noise and a known bias."""
    random = np.random.default_rng(1)
    time = START_NS + np.arange(N) * SECOND_NS // 100
    columns: dict[str, Any] = {"device_time_ns": time - START_NS, "host_time_ns": time}
    for axis, rate, bias, force in zip(
        "xyz", (0.1, 0.2, 0.3), (0.01, 0.02, 0.03), (0.0, 0.0, -9.8), strict=True
    ):
        columns[f"gyro_{axis}"] = rate + bias + 1e-3 * random.standard_normal(N)
        columns[f"accel_{axis}"] = force + 1e-2 * random.standard_normal(N)
        columns[f"gyro_bias_{axis}"] = np.full(N, bias)
        columns[f"gyro_bias_sd_{axis}"] = np.full(N, 1e-4)
        columns[f"mag_{axis}"] = np.full(N, 20.0)
    columns["temperature"] = np.repeat([20.0, 20.5], N // 2)
    columns["at_rest"] = np.ones(N, np.int64)
    half = np.sqrt(0.5)
    # Its x axis to the north, its y axis to the east.
    for part, value in zip("wxyz", (0.0, half, half, 0.0), strict=True):
        columns[f"attitude_estimate_{part}"] = np.full(N, value)
    columns["attitude_estimate_tilt_sd"] = np.full(N, 0.01)
    columns["attitude_estimate_heading_sd"] = np.full(N, 0.1)
    columns["attitude_estimate_north"] = np.ones(N, np.int64)
    columns["attitude_estimate_heading_sd"][1] = np.nan
    columns["attitude_estimate_north"][2] = 0
    columns["attitude_estimate_tilt_sd"][3] = np.nan
    columns["gyro_x"][7] = np.nan
    return SampleBlock(columns)


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("converted") / "run.parquet"
    with TableWriter(path, COLUMNS) as writer:
        writer.write(samples())
    return path


def bag(path: Path) -> dict[str, list[Any]]:
    """Return the messages of each topic as a reader has them that knows nothing of the writer."""
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    found: dict[str, list[Any]] = {}
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_FOXY)) as reader:
        for connection, _, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            found.setdefault(connection.topic, []).append(message)
    return found


@pytest.mark.parametrize("time_s", [-1, 2**31, 4_200_000_000])
def test_a_time_that_ros_cannot_hold_is_refused_before_a_file_appears(tmp_path: Path, time_s: int) -> None:
    (tmp_path / "t.csv").write_text(f"t,x,y,z\n{time_s + 0.25},1,2,3\n{time_s + 0.5},1,2,3\n")
    (tmp_path / "m.yaml").write_text("time: {column: t, unit: s}\ngyro: {columns: [x, y, z], unit: deg/s}\n")
    import_table(tmp_path / "t.csv", tmp_path / "m.yaml", tmp_path / "s")
    source, pipeline, out = open_source(tmp_path / "s"), Pipeline(None), tmp_path / "out.mcap"
    with pytest.raises(ImumonError) as caught:
        export_run(run_over(source.items, pipeline), pipeline, source, out, None)
    assert caught.value.reason is Reason.BAD_DATA
    assert f"device_time_ns is from {time_s + 0.25:.3f} s" in caught.value.seen
    assert not out.exists()


def vector(message: Any) -> FloatArray:
    return np.array([message.x, message.y, message.z])


def rotated(q: Any, v: FloatArray) -> FloatArray:
    axis = np.array([q.x, q.y, q.z])
    turned: FloatArray = v + 2.0 * np.cross(axis, np.cross(axis, v) + q.w * v)
    return turned


def test_ros_has_forward_left_up_axes_and_covariances_of_the_estimators(table: Path, tmp_path: Path) -> None:
    written = write_ros2({"imu": table}, tmp_path / "run.mcap", "FRD")
    found = bag(tmp_path / "run.mcap")
    assert written == (["imu"], [])
    raw, estimated = found["/imu/data_raw"], found["/imu/data"]
    assert len(raw) == len(estimated) == N
    np.testing.assert_allclose(vector(estimated[0].angular_velocity), [0.1, -0.2, -0.3], atol=5e-3)
    np.testing.assert_allclose(vector(raw[0].angular_velocity), [0.11, -0.22, -0.33], atol=5e-3)
    np.testing.assert_allclose(vector(raw[0].linear_acceleration), [0.0, 0.0, 9.8], atol=5e-2)
    # White noise of the samples and the sigma of the bias.
    np.testing.assert_allclose(
        np.diag(estimated[0].angular_velocity_covariance.reshape(3, 3)), 1.01e-6, rtol=0.3
    )
    np.testing.assert_allclose(np.diag(estimated[0].orientation_covariance.reshape(3, 3)), [1e-4, 1e-4, 1e-2])
    # A heading that is not known, or is free, may be any; without a tilt nothing is known.
    for row in (1, 2):
        of_any = np.diag(estimated[row].orientation_covariance.reshape(3, 3))
        np.testing.assert_allclose(of_any, [1e-4, 1e-4, np.pi**2 / 3])
    assert not estimated[3].orientation_covariance.any()
    assert raw[0].orientation_covariance[0] == -1.0
    np.testing.assert_allclose(
        rotated(estimated[0].orientation, np.array([1.0, 0, 0])), [0, 1, 0], atol=1e-12
    )
    np.testing.assert_allclose(
        rotated(estimated[0].orientation, np.array([0, 1.0, 0])), [-1, 0, 0], atol=1e-12
    )
    # What is missing is said to be.
    assert raw[7].angular_velocity_covariance[0] == -1.0
    assert vector(raw[7].linear_acceleration)[2] > 9.0
    stamp = raw[1].header.stamp
    assert stamp.sec * SECOND_NS + stamp.nanosec == START_NS + SECOND_NS // 100
    assert vector(found["/imu/mag"][0].magnetic_field) == pytest.approx([20e-6, -20e-6, -20e-6])
    # As it changes, and once a second.
    assert [one.temperature for one in found["/imu/temperature"]] == [20.0, 20.0, 20.5, 20.5]
    (status,) = found["/diagnostics"][0].status
    assert {pair.key: float(pair.value) for pair in status.values}["gyro_bias_sd_x"] == 1e-4


def test_import_prefers_what_the_unit_sent_to_rates_without_their_bias(table: Path, tmp_path: Path) -> None:
    write_ros2({"imu": table}, tmp_path / "run.mcap", "FRD")
    _, made = import_log(tmp_path / "run.mcap", None, tmp_path / "session")
    assert (made.sensor, made.others) == ("/imu/data_raw", ["/imu/data"])


def test_axes_that_nobody_stated_stay_as_they_are(table: Path, tmp_path: Path) -> None:
    write_ros2({"imu": table}, tmp_path / "run.mcap", None)
    first = bag(tmp_path / "run.mcap")["/imu/data_raw"][0]
    assert vector(first.linear_acceleration)[2] == pytest.approx(-9.8, abs=0.05)


def test_a_field_in_arbitrary_units_is_left_out_and_reported(tmp_path: Path) -> None:
    block, path = samples(), tmp_path / "run.parquet"
    arbitrary = {name: Column(name, "1") for name in ("mag_x", "mag_y", "mag_z")}
    with TableWriter(path, COLUMNS | arbitrary) as writer:
        writer.write(block)
    _, left_out = write_ros2({"imu": path}, tmp_path / "run.mcap", "FLU")
    assert "/imu/mag" not in bag(tmp_path / "run.mcap")
    assert left_out == ["the magnetic field: its unit is '1', ROS has tesla"]


def test_rerun_opens_the_bag(table: Path, tmp_path: Path) -> None:
    import rerun as rr

    write_ros2({"imu": table}, tmp_path / "run.mcap", "FRD")
    with rr.RecordingStream("imumon_bag_test") as stream:
        stream.save(tmp_path / "run.rrd")
        stream.log_file_from_path(tmp_path / "run.mcap")
    content = (tmp_path / "run.rrd").read_bytes()
    assert len(content) > 10_000
    assert b"/imu/data_raw" in content


@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_numpy_and_matlab_have_every_value_with_its_unit(table: Path, tmp_path: Path, suffix: str) -> None:
    out = tmp_path / f"run{suffix}"
    made, left_out = convert({"imu": table}, out, "FRD")
    assert (made, left_out) == ({"imu": out}, [])
    for name, expected in samples().columns.items():
        if suffix == ".npz":
            with np.load(out) as file:
                values, unit = file[name], json.loads(str(file["units"]))[name]
        else:
            file = loadmat(out, squeeze_me=True)
            values, unit = file[name], str(file["units"][name])
        np.testing.assert_array_equal(values, expected)
        assert unit == COLUMNS[name].unit


@pytest.mark.parametrize(("name", "suffix"), [("units", ".npz"), ("n" * 64, ".mat"), ("file", ".npz")])
def test_a_name_that_the_format_reserves_is_refused(tmp_path: Path, suffix: str, name: str) -> None:
    source: Any = SimpleNamespace(columns=lambda *_: [Column(name, "1")], axes=None)
    block = SampleBlock({name: np.zeros(3)})
    with pytest.raises(ImumonError, match=f"can have the name {name}") as caught:
        export_run([block], Pipeline(None), source, tmp_path / f"t{suffix}", None)
    assert caught.value.reason is Reason.BAD_CONFIG
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("at", [8, 10, 60])
def test_a_damaged_file_of_numpy_is_bad_data(table: Path, tmp_path: Path, at: int) -> None:
    convert({"imu": table}, tmp_path / "run.npz", "FRD")
    data = bytearray((tmp_path / "run.npz").read_bytes())
    data[at] ^= 0xFF
    directory = data.rindex(b"PK\x01\x02", 0, data.index(b"PK\x05\x06"))
    data[directory + at] ^= 0xFF
    (tmp_path / "run.npz").write_bytes(data)
    with pytest.raises(ImumonError, match="cannot be read as a table") as caught:
        read_npz(tmp_path / "run.npz")
    assert caught.value.reason is Reason.BAD_DATA


def test_a_run_with_a_receiver_is_one_bag(tmp_path: Path) -> None:
    main = [mtdata2_inertial(k, 100 * k, 0.5) for k in range(30)]
    side = [mtdata2_gnss(None, 100 * k, 250 * k) for k in range(4)]
    raw = tmp_path / "raw.bin"
    raw.write_bytes(b"".join(main + side))
    for suffix in (".mcap", ".npz"):
        source = open_source(raw, "xsens")
        pipeline = Pipeline(source.device)
        out = tmp_path / f"drive{suffix}"
        made = export_run(run_over(source.items, pipeline), pipeline, source, out, None)
        assert made.rows == 30
        expected = out if suffix == ".mcap" else tmp_path / "drive.gnss.npz"
        assert made.tables == {"imu": out, "gnss": expected}
    count = Counter({topic: len(messages) for topic, messages in bag(tmp_path / "drive.mcap").items()})
    assert count["/imu/data_raw"] == 30
    assert count["/gnss/fix"] == 4
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "drive.gnss.npz", "drive.mcap", "drive.npz", "raw.bin",
    ]  # fmt: skip


def test_without_the_package_it_states_what_to_install(table: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mcap_ros2.writer", None)
    with pytest.raises(ImumonError, match="mcap-ros2-support") as refused:
        write_ros2({"imu": table}, table.with_name("never.mcap"), None)
    assert refused.value.reason is Reason.BAD_CONFIG
    assert not table.with_name("never.mcap").exists()
