from __future__ import annotations

import io
import itertools
import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
import pytest
import yaml

from imumon.blocks import SampleBlock
from imumon.cli import progress
from imumon.columns import TEMPERATURES
from imumon.fleet.catalog.page import BIASES, Curve, _course
from imumon.fleet.catalog.tables import MONTH_NS, drifts, find_outliers, line
from imumon.fleet.catalog.units import Dated, Unit, read_models, units_of
from imumon.fleet.catalog_command import read
from imumon.recordings.folder import fingerprint
from imumon.recordings.reduced import reduce
from tests.cli.command import imumon
from tests.fleet.batch.sessions import tiny
from tests.fleet.catalog.fleet import DEG_PER_H, PER_MONTH, RUNAWAY, SD, fleet, model_of


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return fleet(tmp_path_factory.mktemp("fleet"), units=5, months=3)


def unit(name: str, constants: list[float]) -> Unit:
    models = [
        Dated(model_of(name, month, "s", constant), round(month * MONTH_NS))
        for month, constant in enumerate(constants)
    ]
    return Unit(name, "ax1", models=models)


def test_the_sessions_that_are_replayed_are_counted_but_not_beside_json(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines: list[str] = []
    monkeypatch.setattr(progress, "LINE_S", 0.0)
    monkeypatch.setattr(progress, "log", lambda _, text: lines.append(text))
    monkeypatch.setattr("sys.stderr", io.StringIO())
    few = tmp_path / "few"
    for session in sorted(path.parent for path in folder.rglob("session.yaml"))[:2]:
        shutil.copytree(session, few / session.name)
    read(few, tmp_path / "quiet", quiet=True)
    assert not lines
    units, _ = read(few, tmp_path / "shown", quiet=False)
    assert units
    assert [line.partition(", ")[2] for line in lines] == ["1 of 2", "2 of 2"]


def test_drift_is_the_slope_of_the_models() -> None:
    found = drifts(unit("a", [month * PER_MONTH for month in range(4)]))
    assert [drift.channel for drift in found] == ["gyro_x", "gyro_y", "gyro_z"]
    assert found[0].at_degc == 25.0
    assert found[0].per_month == pytest.approx(PER_MONTH, rel=1e-6)
    assert found[1].per_month == pytest.approx(-PER_MONTH, rel=1e-6)
    assert found[0].per_month_sd == pytest.approx(SD / np.sqrt(5.0), rel=1e-6)
    (only,) = {drift.per_month_sd for drift in drifts(unit("a", [0.0]))[:1]}
    assert np.isnan(only)


def test_sigma_of_a_slope_states_how_far_it_errs() -> None:
    noise, x = np.random.default_rng(0), np.arange(6.0)
    for said, true in ((1.0, 1.0), (1.0, 5.0)):  # the points may scatter more than they say
        found = [line(x, 2 * x + noise.normal(0, true, 6), np.full(6, said)) for _ in range(2000)]
        slope, sd = np.array(found).T
        assert 0.9 < np.sqrt(np.mean(((slope - 2) / sd) ** 2)) < 1.6
    assert np.isnan(line(np.zeros(2), np.ones(2), np.ones(2))).all()


def test_models_with_and_without_the_earth_rate_are_not_compared() -> None:
    made = unit("a", [0.0, 1.0])
    latest = made.models[-1]
    removed = {"earth_rate": "removed"}
    made.models[-1] = Dated(latest.model.model_copy(update=removed), latest.time_ns)
    assert [len(drift.bias) for drift in drifts(made)] == [1, 1, 1]


def test_one_of_many_is_unusual() -> None:
    noise = np.random.default_rng(2).normal(0.0, DEG_PER_H, 20)
    units = [unit(f"u{n}", [value]) for n, value in enumerate(noise)]
    find_outliers(units)
    usual = sum(len(one.outliers) for one in units)
    units = [unit(one.name, [constant]) for one, constant in zip(units, noise, strict=True)]
    units.append(unit("far", [20 * DEG_PER_H]))
    find_outliers(units)
    scores = [abs(outlier.score) for outlier in units[-1].outliers]
    assert len(scores) == 3
    assert scores == sorted(scores, reverse=True)
    assert scores[0] > max((abs(outlier.score) for one in units[:-1] for outlier in one.outliers), default=0)
    assert sum(len(one.outliers) for one in units) == usual + 3
    few = [unit(f"u{n}", [value]) for n, value in enumerate([0, 1e-6, 2e-6, 9e-3])]
    find_outliers(few)
    assert not any(one.outliers for one in few)


def test_a_model_without_session_has_a_unit(tmp_path: Path) -> None:
    model_of("SN99", 0, "gone", 0.0).write(tmp_path / "model.yaml")
    (tmp_path / "other.yaml").write_text("imumon-bias-model/2 is a format\n")
    (found,) = units_of([], read_models(tmp_path))
    assert (found.name, found.device, len(found.models)) == ("SN99", "ax1", 1)


@pytest.mark.long
def test_catalog_of_a_folder(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = imumon("catalog", folder, "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [row["unit"] for row in rows["units"]] == [f"SN0{n}" for n in range(1, 6)]
    assert all((row["sessions"], row["models"]) == (3, 3) for row in rows["units"])
    units = pl.read_parquet(out / "units.parquet")
    assert not any(units[name].has_nulls() for name in ("best_sigma_rad_per_s", "coldest_degc"))
    assert (units["best_sigma_rad_per_s"] > 0).all()
    assert (units["best_sigma_rad_per_s"] <= units["worst_sigma_rad_per_s"]).all()
    assert (units["coldest_degc"] <= units["hottest_degc"]).all()
    models = pl.read_parquet(out / "models.parquet").filter(pl.col("channel") == "gyro_x")
    pull = (models["per_month"] - PER_MONTH) / models["per_month_sd"]
    assert (pull.abs() < 4).all()
    rows_before = sorted((folder / "catalog" / "rows").iterdir())
    again = imumon("catalog", folder, "--json")
    assert json.loads(again.stdout) == rows
    assert sorted((folder / "catalog" / "rows").iterdir()) == rows_before
    assert "ax1" in imumon("catalog", folder).stdout


def test_hours_and_packets_are_those_that_can_be_read(tmp_path: Path) -> None:
    whole, cut, holed, unreadable = (tmp_path / name for name in ("a", "b", "c", "d"))
    recorded = (tiny(whole, seconds=60.0) / "wire.mcap").read_bytes()
    for path in (cut, holed, unreadable):
        shutil.copytree(whole, path)
    half, third = len(recorded) // 2, len(recorded) // 3
    (cut / "wire.mcap").write_bytes(recorded[:half])
    (holed / "wire.mcap").write_bytes(recorded[:third] + bytes(third) + recorded[2 * third :])
    (unreadable / "wire.mcap").write_bytes(bytes(half))
    done = imumon("catalog", tmp_path, "--json")
    rows = {Path(row["session"]).name: row for row in json.loads(done.stdout)["sessions"]}
    hours = {name: row["hours"] for name, row in rows.items()}
    assert hours["a"] == pytest.approx(60.0 / 3600.0, rel=1e-3)
    assert hours["b"] == pytest.approx(hours["a"] / 2.0, rel=0.1)
    assert hours["c"] == pytest.approx(hours["a"] * 2.0 / 3.0, rel=0.1)
    assert hours["d"] == 0.0
    assert rows["a"]["lost"] == 0
    assert rows["c"]["lost"] == pytest.approx(2000, rel=0.1)
    assert rows["d"]["lost"] is None
    assert json.loads(done.stdout)["units"][0]["hours"] == pytest.approx(sum(hours.values()))


def only_session(folder: Path) -> dict[str, object]:
    (row,) = json.loads(imumon("catalog", folder, "--json").stdout)["sessions"]
    assert isinstance(row, dict)
    return row


@pytest.mark.long
def test_a_session_that_grows_is_mended_or_is_another_one_is_replayed_again(tmp_path: Path) -> None:
    other, session = tiny(tmp_path / "other" / "s", seconds=20.0, seed=1), tmp_path / "lab" / "s"
    tiny(session, seconds=60.0)
    whole = {name: (session / name).read_bytes() for name in ("session.yaml", "wire.mcap")}

    def hours(metadata: bytes, wire: bytes) -> float:
        (session / "session.yaml").write_bytes(metadata)
        (session / "wire.mcap").write_bytes(wire)
        found = only_session(session.parent)["hours"]
        assert isinstance(found, float)
        return found

    wire, is_open = whole["wire.mcap"], whole["session.yaml"].replace(b"state: closed", b"state: open")
    minute = pytest.approx(60.0 / 3600.0, rel=1e-3)
    growing = [hours(is_open, wire[: len(wire) * part // 4]) for part in (1, 2)]
    assert 0.0 < growing[0] < growing[1] < 60.0 / 3600.0
    assert hours(whole["session.yaml"], wire) == minute
    begun = yaml.safe_load((other / "session.yaml").read_text())
    begun["created_ns"] += 1
    assert hours(yaml.safe_dump(begun).encode(), (other / "wire.mcap").read_bytes()) == pytest.approx(
        20.0 / 3600.0, rel=1e-3
    )
    assert hours(whole["session.yaml"], bytes(1000)) == 0.0
    assert hours(whole["session.yaml"], wire) == minute
    parts = sorted((session.parent / "catalog" / "rows").iterdir())
    only_session(session.parent)
    assert sorted((session.parent / "catalog" / "rows").iterdir()) == parts


def test_a_session_is_of_the_unit_whose_model_was_made_of_its_bytes(tmp_path: Path) -> None:
    of_a, of_b = (tiny(tmp_path / name / "night", seconds=2.0, seed=seed) for seed, name in enumerate("AB"))
    model = model_of("SN-A", 0, "night", 0.0)
    trained = model.trained_on[0].model_copy(update={"sha256": fingerprint(of_a / "wire.mcap")})
    model.model_copy(update={"trained_on": [trained]}).write(tmp_path / "a.yaml")
    rows = json.loads(imumon("catalog", tmp_path, "--json").stdout)["sessions"]
    assert {row["session"]: row["unit"] for row in rows} == {str(of_a): "SN-A", str(of_b): "(ax1)"}


def test_a_model_without_a_date_is_left_out(tmp_path: Path) -> None:
    tiny(tmp_path / "s", seconds=2.0)
    model_of("SN1", 0, "gone", 0.0).model_copy(update={"created": "yesterday"}).write(tmp_path / "m.yaml")
    done = imumon("catalog", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    assert [unit["models"] for unit in json.loads(done.stdout)["units"]] == [0, 0]


def test_results_of_sessions_of_which_none_can_be_read_any_more(tmp_path: Path) -> None:
    session = tiny(tmp_path / "s", seconds=2.0)
    assert only_session(tmp_path)["hours"]
    (session / "session.yaml").write_text("format: nothing of ours\n")
    done = imumon("catalog", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert (rows["sessions"], len(rows["left_out"])) == ([], 1)


def test_a_serial_number_of_two_devices_is_refused_with_their_names(tmp_path: Path) -> None:
    for name in ("ax1", "ax2"):
        session = tiny(tmp_path / name, seconds=2.0)
        text = yaml.safe_load((session / "session.yaml").read_text())
        (session / "session.yaml").write_text(yaml.safe_dump(text | {"serial": "77", "device": name}))
    done = imumon("report", "77", "--sessions", tmp_path, "--out", tmp_path / "u.html")
    assert done.returncode == 4
    assert "there are: 77 (ax1), 77 (ax2)" in done.stderr


def test_runs_of_a_record_stand_one_after_the_other(monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: dict[str, Curve] = {}

    def figure(_caption: str, curves: dict[str, Curve], **_: Any) -> dict[str, str]:
        drawn.update(curves)
        return {}

    monkeypatch.setattr("imumon.fleet.catalog.page._figure", figure)
    n = 50
    times = np.concatenate([np.arange(n), np.arange(n), 3600 + np.arange(n)]) * 1_000_000_000
    made = {"device_time_ns": times, "segment": np.repeat([0, 1, 2], n), "temperature": np.ones(3 * n)}
    _course(reduce([SampleBlock(made)], [*TEMPERATURES, *itertools.chain(*BIASES)], 1.0))
    np.testing.assert_allclose(np.diff(drawn["temperature"].x), 1.0 / 3600.0, rtol=1e-6)


def test_a_narrow_terminal_tears_no_word(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shown = {}
    for columns in ("80", "160"):
        monkeypatch.setenv("COLUMNS", columns)
        shown[columns] = imumon("catalog", folder).stdout
    assert max(map(len, shown["80"].splitlines())) <= 80
    for text in shown.values():
        assert {"sessions", "outliers", "°/h/month", "SN05"} <= set(text.replace(",", " ").split())
    assert len(shown["160"].splitlines()) < 12 < len(shown["80"].splitlines())


def test_record_of_a_unit_and_of_a_session(folder: Path, tmp_path: Path) -> None:
    done = imumon("report", "SN01", "--sessions", folder, "--out", tmp_path / "unit.html")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "unit.html").read_text()
    assert "Calibration record of SN01" in page
    assert page.count("<svg") == 2
    assert "earth rate" in page
    done = imumon("report", folder / "SN01-0", "--out", tmp_path / "session.html")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "session.html").read_text()
    assert page.count("<svg") == 2
    assert "SN01" in page
    assert "src=" not in page  # it needs no network
    assert "<link" not in page
    unknown = imumon("report", RUNAWAY, "--sessions", folder, "--out", tmp_path / "none.html")
    assert unknown.returncode == 4
    assert "there are: SN01" in unknown.stderr
