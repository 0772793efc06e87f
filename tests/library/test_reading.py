"""Sessions, captures and tables as the library reads them, with a session of a simulated device."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import imumon
from imumon.blocks import NO_INT
from imumon.columns import KNOWN
from imumon.errors import ImumonError, Reason
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.simulation.recording import record_session
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice


class Doubled:
    columns = (imumon.Column("doubled", "rad/s"),)

    def process(self, block: imumon.SampleBlock) -> dict[str, Any]:
        return {"doubled": 2.0 * block["gyro_x"]}

    def notices(self) -> list[str]:
        return []


def test_a_file_that_holds_nothing_or_is_not_there_is_an_error(tmp_path: Path) -> None:
    for name, content in (("noise.bin", bytes(100)), ("empty.bin", b"")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(ImumonError, match=r"no samples of ax1 in the 100 bytes|is empty") as caught:
            imumon.read(tmp_path / name, "ax1")
        assert caught.value.reason is Reason.BAD_DATA
        with pytest.raises(ImumonError):
            list(imumon.read_blocks(tmp_path / name, "ax1"))
    for device in (None, "ax1"):
        with pytest.raises(ImumonError, match="there is no such file") as caught:
            imumon.read(tmp_path / "absent.parquet", device)
        assert caught.value.reason is Reason.NOT_FOUND


def test_stages_run_over_a_table_and_a_setup_is_refused(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("gyro_x\n1.0\n2.0\n")
    table = imumon.read(tmp_path / "t.csv", stages=[Doubled()], columns=["doubled"])
    assert table["doubled"].tolist() == [2.0, 4.0]
    assert table.units == {"doubled": "rad/s"}
    with pytest.raises(ImumonError, match=r"setup: .*t\.csv is a table"):
        imumon.read(tmp_path / "t.csv", setup=imumon.Setup(latitude_deg=48.0))


def some_samples() -> imumon.Samples:
    """Return samples of which some integers are missing, with a side stream."""
    times = np.arange(4) * 500_000_000
    block = imumon.SampleBlock(
        {
            "device_time_ns": times,
            "host_time_ns": times + 1_767_225_600_000_000_001,
            "gyro_x": np.array([0.5, np.nan, 1.5, 2.5]),
            "status": np.array([1, NO_INT, 3, 5]),
        }
    )
    gnss = imumon.SampleBlock({"device_time_ns": times[:1], "altitude": np.array([400.0])})
    side = imumon.Samples(gnss, {name: KNOWN[name] for name in gnss.columns})
    return imumon.Samples(block, {name: KNOWN[name] for name in block.columns}, {"gnss": side})


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".npz"])
def test_what_is_written_reads_back_and_a_missing_integer_is_nan(tmp_path: Path, suffix: str) -> None:
    some_samples()[1:].write(tmp_path / f"t{suffix}")
    read = imumon.read(tmp_path / f"t{suffix}")
    assert len(read) == 3
    np.testing.assert_array_equal(read["status"], [np.nan, 3.0, 5.0])
    assert np.nanmean(read.block["status"]) == 4.0
    assert read["host_time_ns"].dtype == np.int64
    assert read["host_time_ns"].tolist() == some_samples()["host_time_ns"][1:].tolist()
    assert read.to_arrow()["status"].to_pylist() == [None, 3, 5]
    (part,) = imumon.read_blocks(tmp_path / f"t{suffix}", columns=["status", "gyro_x"])
    np.testing.assert_array_equal(part.to_numpy(), [[np.nan, np.nan], [3.0, 1.5], [5.0, 2.5]])
    assert imumon.read(tmp_path / f"t.gnss{suffix}")["altitude"].tolist() == [400.0]


def test_a_table_of_another_suffix_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match=r"cannot have the suffix '\.xls'"):
        some_samples().write(tmp_path / "t.xls")


def test_data_frames_have_times_and_no_sentinels() -> None:
    import xarray

    samples = some_samples()
    frame = samples.to_pandas()
    assert str(frame.index[1]) == "2026-01-01 00:00:00.500000001+00:00"
    assert frame.loc["2026-01-01 00:00:01":]["status"].tolist() == [3.0, 5.0]
    assert frame["device_time"].iloc[3].total_seconds() == 1.5
    assert frame["status"].mean() == 3.0
    assert frame["device_time_ns"].dtype == np.int64
    data = samples.to_xarray()
    assert data["status"].mean() == 3.0
    assert data["status"].sel(time=slice("2026-01-01T00:00:01", None)).values.tolist() == [3.0, 5.0]
    assert data["device_time"].values[3] == np.timedelta64(1_500_000_000, "ns")
    encoded = xarray.conventions.encode_cf_variable(data["status"].variable)
    assert (encoded.dtype, encoded.attrs["_FillValue"]) == (np.int64, NO_INT)
    assert encoded.values.tolist() == [1, NO_INT, 3, 5]


def test_without_a_host_time_the_device_time_is_the_index() -> None:
    columns = {"device_time_ns": KNOWN["device_time_ns"], "host_time_ns": KNOWN["host_time_ns"]}
    block = imumon.SampleBlock({"device_time_ns": np.array([0, 10**9]), "host_time_ns": np.full(2, NO_INT)})
    samples = imumon.Samples(block, columns)
    assert samples.to_pandas().index.total_seconds().tolist() == [0.0, 1.0]
    assert samples.to_xarray()["time"].values[1] == np.timedelta64(1, "s")
    untimed = imumon.Samples(imumon.SampleBlock({"gyro_x": np.ones(2)}), {"gyro_x": KNOWN["gyro_x"]})
    assert untimed.to_xarray()["gyro_x"].dims == ("sample",)
    assert untimed.to_pandas().index.tolist() == [0, 1]


def test_what_is_printed_is_short_and_dir_lists_what_is_public() -> None:
    assert repr(some_samples()) == "<imumon.Samples: 4 rows of 4 columns, side streams gnss>"
    assert repr(some_samples().block) == "<SampleBlock: 4 rows of 4 columns>"
    assert dir(imumon) == sorted(imumon.__all__)


def test_columns_a_span_and_blocks_are_parts_of_the_whole(
    tmp_path: Path,
) -> None:
    session = tmp_path / "session"
    with (
        VirtualDevice(load_device("ax1"), tmp_path / "imu") as device,
        imumon.open(device.port.path, "ax1", record=session) as live,
    ):
        for _ in live:
            if live.counters.samples > 60:
                break
    whole = imumon.read(session)
    for names in (["gyro_z", "device_time_ns"], ["gyro_bias_z", "at_rest"]):
        part = imumon.read(session, columns=names)
        assert list(part.columns) == names
        np.testing.assert_array_equal(part.to_numpy(), whole.to_numpy(*names))
    blocks = list(imumon.read_blocks(session, columns=["gyro_z"]))
    np.testing.assert_array_equal(np.concatenate([block["gyro_z"] for block in blocks]), whole["gyro_z"])
    since_s = (whole["host_time_ns"] - whole["host_time_ns"][0]) * 1e-9
    span = imumon.read(session, begin_s=0.1, end_s=0.4)
    wanted = (since_s >= 0.1) & (since_s < 0.4)
    assert 0 < len(span) < len(whole)
    np.testing.assert_array_equal(span["gyro_bias_z"], whole["gyro_bias_z"][wanted])
    assert len(imumon.read(session, begin_s=1e6)) == 0
    with pytest.raises(ImumonError, match=r"columns: there is no gyro_q in .*\nthere are: .*gyro_x"):
        next(imumon.read_blocks(session, columns=["gyro_q"]))
    with pytest.raises(ImumonError, match="columns: there is no true_gyro_x"):
        imumon.read(session, columns=["true_gyro_x"])


def test_a_closed_session_that_was_cut_reports_it(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    scenario = load_scenario("bench").model_copy(update={"duration_s": 5.0, "rate_hz": 100.0, "axes": "FRD"})
    text, source = device_text("ax1")
    record_session(scenario, parse_device(text, source), text, 0, tmp_path / "s", lambda _: None)
    wire = tmp_path / "s" / "wire.mcap"
    imumon.read(tmp_path / "s", estimates=False)
    assert "recording:" not in caplog.text
    os.truncate(wire, wire.stat().st_size // 2)
    imumon.read(tmp_path / "s", estimates=False)
    assert "bytes are not in wire.mcap, of the 29,000 that had come from the device" in caplog.text


def test_only_columns_that_are_wanted_are_computed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    capture = tmp_path / "c.bin"
    capture.write_bytes(
        b"".join(load_device("ax1").encoder().encode(SimulatedUnit(load_scenario("bench")).samples(50)))
    )
    monkeypatch.setattr(RestAndBias, "process", None)
    assert len(imumon.read(capture, "ax1", columns=["gyro_x", "device_time_ns"])) == 50
    with pytest.raises(TypeError):
        imumon.read(capture, "ax1", columns=["at_rest"])


def test_a_span_across_a_restart_needs_times_of_arrival(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("device_time_ns,segment\n0,0\n1000000000,0\n0,1\n")
    with pytest.raises(ImumonError, match="the device restarted"):
        imumon.read(tmp_path / "t.csv", begin_s=0.5)
    (tmp_path / "u.csv").write_text("gyro_x\n1.0\n")
    with pytest.raises(ImumonError, match="neither host_time_ns nor device_time_ns"):
        imumon.read(tmp_path / "u.csv", end_s=1.0)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"path": 3}, "path=3: Input should be a valid string"),
        ({"device": 3}, "device=3"),
        ({"setup": {"latitude_deg": 48}}, "setup="),
        ({"estimates": 1}, "estimates=1"),
        ({"stages": Doubled}, "stages="),
        ({"columns": "gyro_x"}, "columns='gyro_x'"),
        ({"columns": [3]}, "columns=3"),
        ({"begin_s": -1}, "begin_s=-1"),
        ({"end_s": "2"}, "end_s='2'"),
        ({"begin_s": 2.0, "end_s": 1.0}, "end_s=1.0: expected more than begin_s=2.0"),
    ],
)
def test_a_wrong_argument_of_read_is_named(tmp_path: Path, wrong: dict[str, Any], named: str) -> None:
    for read in (imumon.read, imumon.read_blocks):
        with pytest.raises(ImumonError, match=re.escape(named)) as caught:
            read(**{"path": tmp_path, **wrong})
        assert caught.value.reason is Reason.BAD_CONFIG


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"port": None}, "port=None"),
        ({"device": None}, "device=None"),
        ({"baudrate": "fast"}, "baudrate='fast'"),
        ({"baudrate": 0}, "baudrate=0"),
        ({"record": 3}, "record=3: Input should be a valid string"),
        ({"setup": 48.0}, "setup=48.0"),
        ({"stages": None}, "stages=None"),
        ({"timeout": 0}, "timeout=0: Input should be greater than 0"),
        ({"timeout": float("nan")}, "timeout=nan"),
        ({"latest": "yes"}, "latest='yes'"),
    ],
)
def test_a_wrong_argument_of_open_is_named(wrong: dict[str, Any], named: str) -> None:
    with pytest.raises(ImumonError, match=re.escape(named)) as caught:
        imumon.open(**{"port": "/dev/null", "device": "ax1", **wrong})
    assert caught.value.reason is Reason.BAD_CONFIG


def test_an_argument_without_a_name_is_named_and_a_missing_one_is_a_type_error() -> None:
    with pytest.raises(ImumonError, match=r"^path=3: "):
        imumon.read(3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="'port'"):
        imumon.open()  # type: ignore[call-arg]


def test_a_wrong_argument_of_a_setup_is_named() -> None:
    with pytest.raises(ImumonError, match=r"latitude_deg=480: .* less than or equal to 90") as caught:
        imumon.Setup(latitude_deg=480)
    assert caught.value.reason is Reason.BAD_CONFIG
    with pytest.raises(ImumonError, match="latitude=48: Extra inputs are not permitted"):
        imumon.Setup(latitude=48)  # type: ignore[call-arg]
    with pytest.raises(ImumonError, match=r"model='unit\.yaml': expected a bias model") as caught:
        imumon.Setup(model="unit.yaml")
    assert "imumon.load_model" in str(caught.value)
    for load in (imumon.load_setup, imumon.load_model):
        with pytest.raises(ImumonError, match="path=3: expected a path"):
            load(3)  # type: ignore[arg-type]
