"""The page of the library as it stands, on a simulated device."""

from __future__ import annotations

import inspect
import re
import sys
import textwrap
from collections.abc import Iterator
from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import imumon
from imumon import plugins
from imumon.columns import Column
from imumon.errors import ImumonError
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_names, load_device
from imumon.recordings.exports import convert
from imumon.recordings.table import TableWriter
from imumon.run.stages import estimators
from imumon.simulation.virtual_device import VirtualDevice

PAGE = Path(__file__).resolve().parents[1] / "docs" / "library.md"
BLOCK = re.compile(r"(?:^    .*\n|^\n(?=(?:\n)*    ))+", re.MULTILINE)


def examples() -> list[str]:
    """Return the programs of the page."""
    blocks = [textwrap.dedent(found) for found in BLOCK.findall(PAGE.read_text(encoding="utf-8"))]
    return [block.strip() + "\n" for block in blocks if re.search(r"^(import|from) ", block, re.MULTILINE)]


@pytest.fixture(scope="module")
def unit(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    folder = tmp_path_factory.mktemp("library")
    with VirtualDevice(load_device("ax1"), folder / "imu"):
        yield folder


@pytest.mark.long
def test_the_page_runs_as_it_stands(
    unit: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(unit)
    said = []
    for program in examples():
        exec(program.replace("/dev/ttyUSB0", str(unit / "imu")), {})
        said.append(capsys.readouterr().out)
    assert len(said) == 7
    assert all(said)
    times = [float(line.split()[0]) for line in said[0].splitlines()]
    assert times == sorted(times)
    assert times
    rows, unit_of_rate, deviation = said[2].split()
    assert int(rows) >= 100
    assert unit_of_rate == "rad/s"
    assert 0.0 < float(deviation) < 1.0
    assert 0.0 < float(said[5].split()[0]) < 1.0


def test_the_table_of_names_is_that_of_the_package() -> None:
    rows = []
    for name in imumon.__all__:
        offered = getattr(imumon, name)
        parameters = (
            f"({', '.join(inspect.signature(offered).parameters)})" if inspect.isfunction(offered) else ""
        )
        if not isinstance(offered, str):
            about = (inspect.getdoc(offered) or "").partition("\n\n")[0].replace("\n", " ")
            rows.append(f"| `imumon.{name}{parameters}` | {about.replace('``', '`')} |\n")
    assert PAGE.read_text(encoding="utf-8").rpartition("|---|---|\n")[2] == "".join(rows)


def test_a_port_is_closed_and_what_came_is_still_there(unit: Path) -> None:
    live = imumon.open(str(unit / "imu"), "ax1")
    first = next(iter(live))
    live.close()
    rest = list(live)
    assert len(first)
    assert live.counters.samples == len(first) + sum(map(len, rest))
    assert list(live) == []
    assert live.units["gyro_x"] == "rad/s"


def test_a_recording_reads_the_same_as_it_came(unit: Path) -> None:
    live = imumon.open(str(unit / "imu"), "ax1", record=unit / "same", stages=[Doubled()])
    came = []
    for block in live:
        came.append(block)
        if sum(map(len, came)) > 30:
            live.close()
    again = imumon.read(unit / "same", stages=[Doubled()])
    for name in ("gyro_x", "doubled", "at_rest"):
        assert np.array_equal(np.concatenate([b[name] for b in came]), again[name], equal_nan=True)
    with pytest.raises(ImumonError, match="holds a session already"):
        imumon.open(str(unit / "imu"), "ax1", record=unit / "same")


def test_tables_are_read_as_they_are(unit: Path) -> None:
    import pandas as pd

    pd.DataFrame({"device_time_ns": [0, 10], "gyro_x": [0.5, np.nan]}).to_csv(unit / "t.csv", index=False)
    table = imumon.read(unit / "t.csv")
    assert table.units == {"device_time_ns": "ns", "gyro_x": "rad/s"}
    assert table.to_pandas()["gyro_x"].isna().tolist() == [False, True]
    assert table.to_polars()["device_time_ns"].to_list() == [0, 10]
    assert "gyro_x" in table
    assert "gyro_y" not in table


def test_a_table_in_a_file_of_numpy_is_read_and_others_are_refused_in_words(tmp_path: Path) -> None:
    columns = {"gyro_x": Column("gyro_x", "rad/s"), "packet_counter": Column("packet_counter", "1", "int64")}
    block = imumon.SampleBlock({"gyro_x": np.array([0.5, np.nan]), "packet_counter": np.array([3, 4])})
    with TableWriter(tmp_path / "t.parquet", columns) as table:
        table.write(block)
    convert({"imu": tmp_path / "t.parquet"}, tmp_path / "t.npz", None)
    read = imumon.read(tmp_path / "t.npz")
    assert read.units == {"gyro_x": "rad/s", "packet_counter": "1"}
    np.testing.assert_array_equal(read["gyro_x"], block["gyro_x"])
    assert read.to_arrow()["packet_counter"].to_pylist() == [3, 4]
    (tmp_path / "t.mat").write_bytes(b"MATLAB 5.0")
    with pytest.raises(ImumonError, match=r"takes \.parquet, \.csv and \.npz, not \.mat"):
        imumon.read(tmp_path / "t.mat")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    (tmp_path / "torn.npz").write_bytes((tmp_path / "t.npz").read_bytes()[:99])
    for name in ("other.npz", "torn.npz"):
        with pytest.raises(ImumonError, match="cannot be read as a table of imumon"):
            imumon.read(tmp_path / name)


def test_a_table_without_units_is_reported_as_one(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "t.csv").write_text("gyro_x,flow\n1.0,2.0\n")
    assert imumon.read(tmp_path / "t.csv").units == {"gyro_x": "rad/s", "flow": ""}
    assert "without t.units.yaml known names have the units of imumon" in caplog.text
    assert "the unit of flow is not stated" in caplog.text


class Doubled:
    columns = (Column("doubled", "rad/s"),)

    def process(self, block: imumon.SampleBlock) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64]]]:
        return {"doubled": 2.0 * block["gyro_x"]}

    def notices(self) -> list[str]:
        return []


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, str]]:
    """Entry points as if a package had them: name by group."""
    values: dict[str, str] = {}

    def entry_points(group: str) -> EntryPoints:
        return EntryPoints([EntryPoint("mine", values[group], group)] if group in values else [])

    monkeypatch.setattr(plugins, "entry_points", entry_points)
    plugins.plugins.cache_clear()
    yield values
    plugins.plugins.cache_clear()


def test_a_stage_of_another_package_runs_behind_the_others(offered: dict[str, str]) -> None:
    offered[plugins.STAGES] = f"{__name__}:Doubled"
    stages = estimators(None)
    assert isinstance(stages[-1], Doubled)
    pipeline = Pipeline(None, stages)
    pipeline.push(imumon.SampleBlock({"device_time_ns": np.arange(3), "segment": np.zeros(3, np.int64),
                                      "gyro_x": np.arange(3.0)}))  # fmt: skip
    assert pipeline.take()["doubled"].tolist() == [0.0, 2.0, 4.0]


def test_devices_of_another_package_have_names(
    offered: dict[str, str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from imumon.protocols.device import device_text

    monkeypatch.setattr(sys.modules[__name__], "FOLDER", tmp_path, raising=False)
    offered[plugins.DEVICES] = f"{__name__}:FOLDER"
    (tmp_path / "theirs.yaml").write_text(device_text("ax1")[0].replace("name: ax1", "name: theirs"))
    assert {"ax1", "theirs"} <= set(device_names())
    assert load_device("theirs").name == "theirs"


def test_a_package_that_cannot_be_imported_is_named(offered: dict[str, str]) -> None:
    offered[plugins.STAGES] = "no_such_module:Stage"
    with pytest.raises(ImumonError, match=r"mine of .* \(imumon.stages\) cannot be imported"):
        estimators(None)


def _raises() -> imumon.Estimator:
    raise RuntimeError("no licence")


def _nothing() -> None:
    """Be no stage."""


class Broken(Doubled):
    def process(self, block: imumon.SampleBlock) -> dict[str, Any]:  # noqa: ARG002 - as a stage has it
        raise ZeroDivisionError("of mine")


class Silent(Doubled):
    def process(self, block: imumon.SampleBlock) -> dict[str, Any]:  # noqa: ARG002 - as a stage has it
        return None  # type: ignore[return-value]


class Talks(Doubled):
    def notices(self) -> list[str]:
        return [3]  # type: ignore[list-item]


@pytest.mark.parametrize(
    ("offer", "said"),
    [
        ("NUMBER", r"mine of .* \(imumon.stages\) is no callable that returns a stage: 3"),
        ("_raises", r"mine of .* \(imumon.stages\) makes no stage: RuntimeError: no licence"),
        (
            "_nothing",
            r"mine of .* \(imumon.stages\) makes no stage: stage NoneType of builtins has no columns",
        ),
    ],
)
def test_what_makes_no_stage_is_one_error_that_names_it(
    offered: dict[str, str], monkeypatch: pytest.MonkeyPatch, offer: str, said: str
) -> None:
    monkeypatch.setattr(sys.modules[__name__], "NUMBER", 3, raising=False)
    offered[plugins.STAGES] = f"{__name__}:{offer}"
    with pytest.raises(ImumonError, match=said):
        estimators(None)


@pytest.mark.parametrize(
    ("offer", "said"),
    [
        ("Broken", "process: ZeroDivisionError: of mine"),
        ("Silent", "process: it returned None"),
        ("Talks", "notices: it returned what is no text"),
    ],
)
def test_a_stage_of_another_package_that_fails_is_reported_once(
    offered: dict[str, str], offer: str, said: str
) -> None:
    offered[plugins.STAGES] = f"{__name__}:{offer}"
    for n in (0, 3):
        pipeline = Pipeline(None, estimators(None))
        block = {"device_time_ns": np.arange(n), "segment": np.zeros(n, np.int64), "gyro_x": np.ones(n)}
        pipeline.push(imumon.SampleBlock(block))
        [report] = [text for text in pipeline.warnings() if "switched off" in text]
        assert f"stage {offer} of {__name__} is switched off" in report
        assert said in report
        assert not any("switched off" in text for text in pipeline.warnings())
        pipeline.push(imumon.SampleBlock({name: values + n for name, values in block.items()}))
        assert np.isnan(pipeline.take()["doubled"][n:]).all()


@pytest.mark.parametrize("folder", ["/no/such/folder", 3, None])
def test_a_folder_of_devices_that_is_none_is_named(
    offered: dict[str, str], monkeypatch: pytest.MonkeyPatch, folder: object
) -> None:
    monkeypatch.setattr(sys.modules[__name__], "FOLDER", folder, raising=False)
    offered[plugins.DEVICES] = f"{__name__}:FOLDER"
    with pytest.raises(ImumonError, match=r"mine of .* is no path of a folder of device files"):
        device_names()


def test_files_are_named_by_text_or_by_path(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("format: imumon-pipeline/1\nlatitude_deg: 40.9\n")
    assert imumon.load_setup(str(path)) == imumon.load_setup(path)
    for load in (imumon.load_model, imumon.load_setup):
        with pytest.raises(imumon.ImumonError, match="nothing"):
            load(str(tmp_path / "nothing.yaml"))
