"""Errors against the truth of a simulated session."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError
from imumon.geodesy import DEG_PER_H
from imumon.recordings.folder import TRUTH_NAME as NAME
from imumon.recordings.table import read_table
from imumon.run.truth import GYROS, check_truth, errors_of_model, read_truth
from tests.cli.command import answer, imumon
from tests.models.models import three_curves


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("truth") / "session"
    answer("simulate", "crs05-ramp", "--rate", 10, "--duration", 90, "--out", folder)
    return folder


def test_a_known_error_is_found_to_the_digit(session: Path) -> None:
    table, _ = read_table(session / NAME)
    truth = read_truth(session, earth_removed=True)
    off, sigma = 3.0 * DEG_PER_H, np.full(len(table), 2.0 * DEG_PER_H)
    truth.take(SampleBlock(table.columns), {GYROS[0]: (table[GYROS[0]] + off, sigma)})
    found = truth.as_data()[GYROS[0]]
    assert found["unit"] == "°/h"
    assert found["samples"] == len(table)
    assert [found[key] for key in ("rms", "rms_over_sigma", "largest")] == pytest.approx([3.0, 1.5, 3.0])
    assert "3 °/h rms, 1.50 σ rms, at most 3 °/h" in truth.rows()["error of gyro_bias_x"]


def test_samples_without_a_true_value_and_estimates_that_are_missing_do_not_count(session: Path) -> None:
    table, _ = read_table(session / NAME)
    truth = read_truth(session, earth_removed=True)
    later = SampleBlock({**table.columns, "device_time_ns": table["device_time_ns"] + 1})
    truth.take(later, {GYROS[0]: (table[GYROS[0]], None)})
    truth.take(SampleBlock(table.columns), {GYROS[0]: (np.full(len(table), np.nan), None)})
    assert truth.errors[GYROS[0]][0, 0] == 0
    assert truth.rows() == {"error of gyro_bias_x": "no estimate"}


def test_the_rotation_of_the_earth_is_added_where_the_estimate_contains_it(session: Path) -> None:
    table, _ = read_table(session / NAME)
    truth = read_truth(session, earth_removed=False)
    rates = [f"rate_{axis}" for axis in "xyz"]
    both = {gyro: (table[gyro] + table[rate], None) for gyro, rate in zip(GYROS, rates, strict=True)}
    truth.take(SampleBlock(table.columns), both, at_rest=True)
    assert all(one["samples"] and one["rms"] < 2e-7 for one in truth.as_data().values())


def test_replay_prints_the_errors_and_they_fit_their_sigmas(session: Path) -> None:
    found = answer("replay", session, "--truth")["truth"]
    assert set(GYROS) <= set(found)
    assert any(name.startswith("temperature_estimate") for name in found)
    assert all(found[name]["rms_over_sigma"] < 2.0 for name in GYROS)
    assert "error of gyro_bias_x" in imumon("replay", session, "--truth").stderr


def test_a_model_is_compared_at_rest(session: Path) -> None:
    model = three_curves()
    found = errors_of_model(session, model).as_data()
    assert {*GYROS, "temperature_x"} <= set(found)
    assert float(found["temperature_x"]["rms"]) < 0.1
    estimated = {
        name: channel.model_copy(update={"temperature_column": f"temperature_estimate_{name[-1]}"})
        for name, channel in model.channels.items()
    }
    found = errors_of_model(session, model.model_copy(update={"channels": estimated})).as_data()
    assert all(found[name]["samples"] == found["temperature_x"]["samples"] for name in GYROS)


def test_a_session_without_truth_is_refused(session: Path, tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match=r"no truth\.parquet"):
        check_truth([tmp_path])
    (session / NAME).rename(tmp_path / NAME)
    try:
        for arguments in (["replay", session], ["calibrate", session, "--out", tmp_path / "m.yaml"]):
            done = imumon(*arguments, "--truth")
            assert done.returncode == 4
            assert "only a session of `imumon simulate` has true values" in done.stderr
        half = imumon("replay", session, "--truth", "--latitude", 40)
        assert half.returncode == 2
        assert "add --heading" in half.stderr
    finally:
        (tmp_path / NAME).rename(session / NAME)
