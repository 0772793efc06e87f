"""Digits coarser than the noise: what nobody could see is said neither to be complete nor to be structure."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock
from imumon.lab.diagnosis.diagnose import Diagnosis, diagnose
from imumon.lab.diagnosis.report import conclusion, next_step, report
from imumon.lab.diagnosis.runs import Run, Watcher
from tests.lab.diagnosis.units import DPH, WHITE_DPH, Bias, cubic, ramps

RATE = 4
"""Samples a second."""
SAMPLE_DPH = WHITE_DPH * np.sqrt(30.0 * RATE)


def nothing(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    return np.zeros(len(time))


def creep(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    return np.asarray(55.0 * np.log1p(time / 300.0))


def rounded(seed: int, up: bool, rate: float, bias: Bias, sigmas: float, times: float, seconds: int) -> Run:
    """Return a run with so many times the cubic curve, its samples rounded to steps of so many sigmas."""
    time, temperature = ramps(seconds, up, rate)
    at = np.repeat(times * cubic(temperature) + bias(time, temperature), RATE)
    values = at + SAMPLE_DPH * np.random.default_rng(seed).standard_normal(len(at))
    step = sigmas * SAMPLE_DPH
    values = np.round(values / step) * step * DPH
    watcher = Watcher(["gyro_x"])
    list(watcher.through([SampleBlock({"gyro_x": values})]))
    each = values.reshape(-1, RATE)
    mean = {"gyro_x": each.mean(axis=1), "temperature": np.round(temperature * 16) / 16}
    count = dict.fromkeys(mean, np.full(len(time), float(RATE)))
    variance = {"gyro_x": each.var(axis=1, ddof=1)}
    return Run(f"run {seed}", time, count, mean, variance, np.ones(len(time)), samples=watcher.samples())


@cache
def found(bias: Bias, sigmas: float, seed: int = 1, times: float = 20.0, seconds: int = 3000) -> Diagnosis:
    runs = [
        rounded(seed + at, up, rate, bias, sigmas, times, seconds)
        for at, (up, rate) in enumerate(((True, 1.5), (False, 1.5), (True, 1.0)))
    ]
    return diagnose(runs[:2], runs[2:])


@pytest.mark.long
@pytest.mark.parametrize(("sigmas", "times"), [(6.0, 20.0), (12.0, 20.0), (35.0, 20.0), (6.0, 4.0)])
def test_of_a_complete_model_coarse_digits_leave_open_whether_something_is_missing(
    sigmas: float, times: float
) -> None:
    diagnosis = found(nothing, sigmas, 20, times)
    (verdict,) = diagnosis.verdicts
    assert verdict.row.state == "too few digits"
    assert not verdict.unexplained
    assert "too few digits to tell: the declared model leaves" in verdict.summary
    assert conclusion(diagnosis) == "gyro_x: too few digits to tell"
    assert "Record gyro_x again with a range and digits" in next_step(diagnosis, None).what
    assert report(diagnosis)["channels"]["gyro_x"]["verdict"] == "too few digits"


def test_an_effect_that_the_digits_hide_is_not_reported_to_be_nothing() -> None:
    (verdict,) = found(creep, 12.0).verdicts
    assert verdict.row.state in ("too few digits", "not proven", "named", "unexplained")


@pytest.mark.long
def test_an_effect_that_is_larger_than_the_digits_err_is_named_beside_them() -> None:
    (verdict,) = found(creep, 6.0, 100, 8.0, 4000).verdicts
    assert verdict.row.state == "named"
    assert verdict.hidden
    assert "whether there is more" in verdict.in_short
    assert "steps as coarse may make up to" in verdict.summary


@pytest.mark.long
def test_with_digits_finer_than_the_noise_the_same_is_reported() -> None:
    (verdict,) = found(nothing, 0.5).verdicts
    assert verdict.row.state == "nothing missing"
    (verdict,) = found(creep, 0.5).verdicts
    assert verdict.row.state == "named"


def test_a_bias_that_stays_within_a_step_is_not_known_to_be_complete() -> None:
    diagnosis = found(creep, 12.0)
    (verdict,) = diagnosis.verdicts
    assert verdict.test_after is not None
    within = verdict.test_after._replace(rms=0.1 * verdict.channel.floor.sd)
    fitted = verdict.after._replace(residual=0.0 * verdict.after.residual)
    verdict = replace(verdict, claims=[], after=fitted, test_before=within, test_after=within)
    assert verdict.row.state == "too few digits"
