"""What cannot be in a recording changes nothing that is computed from it but what losing it changes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import fields
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.allan.recording import read_channels
from imumon.fleet.batch.dataset import BatchOptions
from imumon.fleet.batch.tasks import Job, work
from imumon.lab.calibration.calibration import calibrate
from imumon.lab.calibration.cells import Record, read_session
from imumon.lab.diagnosis.runs import read_runs
from tests.cli.command import answer, imumon
from tests.faults.readings import FAULTS, Columns, Fault, write_session
from tests.lab.calibration.records import few_steps, samples, soak

LENGTH_S = 310
"""A diagnosis needs five minutes."""
TEMPERATURES = np.linspace(-19.0, 47.0, 50)


def resting(n: int, rate_hz: float, seed: int = 0) -> Columns:
    """Return a unit at rest that warms up."""
    rng = np.random.default_rng(seed)
    columns: Columns = {f"gyro_{axis}": 1e-3 * (1.0 + rng.standard_normal(n)) for axis in "xyz"}
    for axis, gravity in zip("xyz", (0.1, -0.2, 9.79), strict=True):
        columns[f"accel_{axis}"] = gravity + 5e-3 * rng.standard_normal(n)
        columns[f"mag_{axis}"] = 20.0 + rng.standard_normal(n)
    columns["temperature"] = 25.0 + 1e-3 * np.arange(n) / rate_hz + 0.01 * rng.standard_normal(n)
    return columns


def chamber() -> Columns:
    block = samples(soak(200.0)[::9])
    return {name: np.array(block[name]) for name in ("gyro_x", "gyro_y", "gyro_z", "temperature")}


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The unit in a chamber, without a fault and with each of them."""
    folder = tmp_path_factory.mktemp("readings")
    every = {"none": Fault(), **FAULTS}
    return {
        name: write_session(folder / name.replace(" ", "-"), chamber(), 1.0, fault)
        for name, fault in every.items()
    }


def curves(session: Path) -> tuple[dict[str, Any], dict[str, float], list[str]]:
    """Return the bias of each gyro over temperature, its residual sigma, and what is said."""
    record, said = read_session(session)
    found = calibrate([record])
    channels = found.model.channels
    return (
        {name: channel.value(TEMPERATURES) for name, channel in channels.items()},
        {name: channel.residual_sd for name, channel in channels.items()},
        [*said, *found.warnings],
    )


TOLD = {
    "one reading of 1e10 of each sensor": ["gyro_y at its range of 100 deg/s (1 in all)", "°C (1 in all)"],
    "a stretch at the declared range": ["gyro_x at its range of 100 deg/s"],
    "packets twice": ["rows whose time does not go on"],
    "one reading of each sensor that is none": [],
}


@pytest.mark.long
def test_a_calibration_is_the_one_without_the_fault_and_counts_it(
    bench: dict[str, Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    few_steps(monkeypatch)
    clean, sd, _ = curves(bench["none"])
    for fault, counted in TOLD.items():
        struck, _, said = curves(bench[fault])
        for name, values in clean.items():
            assert np.abs(struck[name] - values).max() < sd[name], fault
        texts = " ".join(said)
        assert all(text in texts for text in counted), fault
        assert texts.count("left out of all estimates") == texts.count("in all)"), fault


@pytest.mark.long
def test_a_thermometer_that_reads_zero_at_first_is_none_till_then(
    bench: dict[str, Path], tmp_path: Path
) -> None:
    columns = chamber()
    columns["temperature"][: len(columns["temperature"]) // 20] = np.nan
    lost, _ = read_session(write_session(tmp_path / "lost", columns, 1.0))
    struck, said = read_session(bench["a temperature that is zero at first"])
    np.testing.assert_array_equal(struck.means.mean, lost.means.mean)
    assert "temperature while its values are nothing but zero (" in " ".join(said)


@pytest.mark.long
def test_what_is_refused_states_what_was_left_out(bench: dict[str, Path], tmp_path: Path) -> None:
    dead = bench["a dead temperature"]
    columns = chamber() | {f"mag_{axis}": np.full(len(chamber()["gyro_x"]), 1e12) for axis in "xyz"}
    beyond = write_session(tmp_path / "beyond", columns, 1.0)
    for command, session, said in (
        (
            ("calibrate", "--out", tmp_path / "model.yaml"),
            dead,
            "temperature while its values are nothing but zero (",
        ),
        (
            ("diagnose", "--out", tmp_path / "out", "--train"),
            dead,
            "temperature while its values are nothing but zero (",
        ),
        (("magnetometer", "--out", tmp_path / "model.yaml"), beyond, "mag_x beyond"),
    ):
        done = imumon(*command, session)
        assert done.returncode == 4
        assert done.stderr.count(f"left out of all estimates: {said}") == 1


@pytest.mark.parametrize("fault", FAULTS)
def test_a_batch_and_a_catalog_have_the_figures_of_what_can_be(
    bench: dict[str, Path], fault: str, tmp_path: Path
) -> None:
    options = BatchOptions(command="decode", tables=True)
    rows, clean = (
        {row["channel"]: row for row in work(Job(str(bench[name]), options, str(tmp_path)))}
        for name in (fault, "none")
    )
    assert set(clean) - set(rows) == ({"temperature"} if "dead" in fault else set())
    for name, row in rows.items():
        if name.startswith("gyro"):
            assert row["mean"] == pytest.approx(clean[name]["mean"], abs=0.01 * clean[name]["sd"])
        assert clean[name]["least"] <= row["least"] <= row["greatest"] <= clean[name]["greatest"]
        assert (len(row["warnings"]) > 0) == ("none" not in fault)
    table = pq.read_table(rows["gyro_x"]["file"])  # it has what was sent
    sent = table["gyro_y"].to_numpy()
    assert len(table) > len(chamber()["gyro_x"]) or not FAULTS[fault].twice
    assert (np.nanmax(sent) == 1e10) == ("1e10" in fault)


@pytest.mark.long
def test_a_smoothed_replay_has_its_rows_where_they_were_sent(tmp_path: Path) -> None:
    n, rate_hz = 3000, 50.0
    found = {}
    for name in ("none", "packets twice"):
        fault = FAULTS.get(name, Fault())
        session = write_session(tmp_path / name.replace(" ", "-"), resting(n, rate_hz), rate_hz, fault)
        out = tmp_path / f"{session.name}.parquet"
        assert answer("replay", session, "--smooth", "--out", out)["rows"] >= n
        table = pq.read_table(out)
        taken = np.diff(table["device_time_ns"].to_numpy(), prepend=-1) > 0
        smoothed = table["gyro_bias_smoothed_x"].to_numpy()
        assert np.isnan(smoothed[~taken]).all()
        found[name] = smoothed[taken]
    np.testing.assert_array_equal(found["none"], found["packets twice"])


def read_by_each(session: Path) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield what each command that computes from samples has read of a session."""
    record, _ = read_session(session)
    yield "calibrate", {field.name: getattr(record.means, field.name) for field in fields(record.means)}
    for run in read_runs(session):
        yield "diagnose", {**run.mean, "rest": run.rest}
        yield "diagnose", {f"variance of {name}": values for name, values in run.variance.items()}
    for name, series in read_channels(session)[0].items():
        yield "allan", {f"{name} {field}": getattr(series, field) for field in ("values", "there")}
    for row in work(Job(str(session), BatchOptions(command="replay"), str(session))):
        numbers = ("samples", "mean", "sd", "least", "greatest")
        yield "catalog", {f"{row['channel']} {key}": row[key] for key in numbers}


BEYOND = {"gyro": 1e3, "accel": 1e6, "mag": 1e9, "temperature": 250.0}
PLACE = st.tuples(
    st.sampled_from(["gyro_x", "gyro_z", "accel_x", "accel_y", "mag_x", "temperature"]),
    st.floats(0.0, 1.0, exclude_max=True),
    st.floats(0.01, 290.0),
    st.sampled_from([-1.0, 1.0]),
)


@pytest.mark.long
@given(places=st.lists(PLACE, min_size=1, max_size=5))
@settings(max_examples=2, deadline=None)
def test_readings_that_cannot_be_change_what_losing_them_changes(
    places: list[tuple[str, float, float, float]],
) -> None:
    n, rate_hz = LENGTH_S, 1.0
    sent, lost = resting(n, rate_hz), resting(n, rate_hz)
    for name, where, decades, sign in places:
        sent[name][int(where * n)] = sign * BEYOND[name.partition("_")[0]] * 10.0**decades
        lost[name][int(where * n)] = np.nan
    with TemporaryDirectory() as folder:
        struck = write_session(Path(folder) / "sent", sent, rate_hz)
        without = write_session(Path(folder) / "lost", lost, rate_hz)
        for (who, one), (_, other) in zip(read_by_each(struck), read_by_each(without), strict=True):
            for what, values in one.items():
                np.testing.assert_array_equal(values, other[what], f"{who}: {what}")


@cache
def complete() -> tuple[Columns, Record]:
    """Return the unit at rest as it was sent, and as a calibration reads it."""
    clean = resting(LENGTH_S, 1.0)
    with TemporaryDirectory() as folder:
        return clean, read_session(write_session(Path(folder) / "whole", clean, 1.0))[0]


@pytest.mark.long
@given(places=st.lists(PLACE, min_size=1, max_size=5))
@settings(max_examples=3, deadline=None)
def test_losing_readings_changes_means_by_what_they_weighed(
    places: list[tuple[str, float, float, float]],
) -> None:
    clean, whole = complete()
    lost = resting(LENGTH_S, 1.0)
    for name, where, *_ in places:
        lost[name][int(where * LENGTH_S)] = np.nan
    with TemporaryDirectory() as folder:
        some, _ = read_session(write_session(Path(folder) / "some", lost, 1.0))
    assert len(whole.means) == len(some.means)
    for at, name in enumerate(whole.means.names):
        if name in clean:
            gone = whole.means.count[:, at] - some.means.count[:, at]
            weight = gone / np.maximum(some.means.count[:, at], 1)
            furthest = np.ptp(clean[name])
            assert (np.abs(some.means.of(name) - whole.means.of(name)) <= weight * furthest).all()
