"""A range that is declared once holds for whatever reads the recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from imumon.allan.recording import read_channels
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.lab.calibration.cells import read_session
from imumon.lab.diagnosis.runs import read_runs
from imumon.protocols.ranges import Ranges
from imumon.recordings.folder import open_session
from imumon.recordings.importing import import_table
from imumon.recordings.source import open_source, run_over
from imumon.run.setup import Setup
from imumon.run.stages import pipeline_of
from tests.cli.command import imumon

N = 330
MAP = "rate_hz: 1\naccel: {columns: [x, y, z], unit: g}\ngyro: {columns: [p, q, r], unit: deg/s}\n"
DECLARED = "range: {accel_g: 0.9}\n"


READERS: dict[str, Callable[[Path], Iterable[str]]] = {
    "allan": lambda path: read_channels(path)[1],
    "diagnose": lambda path: read_runs(path)[0].warnings,
    "calibrate": lambda path: read_session(path)[1],
}


@pytest.fixture(scope="module")
def sessions(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Five minutes at rest with 1 g on z; the map, the pipeline file or nothing says the range."""
    folder = tmp_path_factory.mktemp("range")
    values = np.random.default_rng(0).normal([0.0, 0.0, 1.0, 0.0, 0.0, 0.0], 1e-3, (N, 6))
    np.savetxt(folder / "t.csv", values, "%.6f", delimiter=",", header="x,y,z,p,q,r", comments="")
    for name in ("map", "pipeline", "nobody"):
        (folder / f"{name}.yaml").write_text(MAP + DECLARED * (name == "map"), encoding="utf-8")
        import_table(folder / "t.csv", folder / f"{name}.yaml", folder / name)
    session = open_session(folder / "pipeline")
    text = Setup(range=Ranges(accel_g=0.9)).text()
    session.save(session.metadata.model_copy(update={"pipeline_yaml": text}))
    return {name: folder / name for name in ("map", "pipeline", "nobody")}


def told(lines: Iterable[str], sensor: str, range_g: float = 0.9) -> bool:
    return any(f"{sensor} at its range of {range_g:g}" in line for line in lines)


@pytest.mark.parametrize("reader", READERS)
def test_a_range_in_map_or_pipeline_file_holds_for_every_command(
    reader: str, sessions: dict[str, Path]
) -> None:
    said = {name: told(READERS[reader](path), "accel_z") for name, path in sessions.items()}
    assert said == {"map": True, "pipeline": True, "nobody": False}


def test_a_table_read_with_its_map_has_the_range_of_the_map(sessions: dict[str, Path]) -> None:
    folder = sessions["map"].parent
    assert told(read_runs(folder / "t.csv", folder / "map.yaml")[0].warnings, "accel_z")


@pytest.mark.parametrize("declared_by", ["map", "pipeline", "nobody"])
def test_the_range_of_another_setup_comes_before_that_of_the_recording(
    declared_by: str, sessions: dict[str, Path]
) -> None:
    found = {}
    for range_g in (None, 0.95, 1.2):
        source = open_source(sessions[declared_by])
        pipeline = pipeline_of(source, Setup(range=Ranges(accel_g=range_g)), only=(RestAndBias,))
        for _ in run_over(source.items, pipeline):
            pass
        found[range_g] = pipeline.counters.left_out
    assert found == {None: 0 if declared_by == "nobody" else N, 0.95: N, 1.2: 0}


def test_samples_come_out_of_a_session_whose_pipeline_file_is_damaged(tmp_path: Path) -> None:
    table = tmp_path / "t.csv"
    table.write_text("x,y,z,p,q,r\n" + "0,0,1,0,0,0\n" * 9, encoding="utf-8")
    (tmp_path / "map.yaml").write_text(MAP, encoding="utf-8")
    import_table(table, tmp_path / "map.yaml", tmp_path / "session")
    session = open_session(tmp_path / "session")
    session.save(session.metadata.model_copy(update={"pipeline_yaml": "range: {accel_g: -1}"}))
    assert imumon("export", tmp_path / "session", "--to", "csv", "--out", tmp_path / "o.csv").returncode == 0
    told = imumon("allan", tmp_path / "session")
    assert told.returncode == 2
    assert "(pipeline_yaml):1: range.accel_g" in told.stderr
