"""What the extended model states of itself: how far it is off, and how well its curve is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.effects.vibration import SECOND_NS
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.runs import Run
from tests.lab.diagnosis.units import DPH, ramps, run, three

SECONDS = 3000


def jump(time: FloatArray, _: FloatArray) -> FloatArray:
    return np.where(time > 1500.0, 60.0, 0.0)


def test_a_declared_model_alone_is_off_by_the_jump_that_goes_on_in_the_test() -> None:
    """It stated what the test was left with where that jump was known."""
    whole = replace(run(1, *ramps(2 * SECONDS, True), jump), start_ns=0)

    def part(start: int, stop: int) -> Run:
        mean, variance, count = (
            {name: values[start:stop] for name, values in one.items()}
            for one in (whole.mean, whole.variance, whole.count)
        )
        return replace(
            whole,
            name=f"from {start} s",
            time_s=whole.time_s[: stop - start],
            mean=mean,
            variance=variance,
            count=count,
            rest=whole.rest[start:stop],
            start_ns=start * SECOND_NS,
        )

    diagnosis = diagnose([part(0, SECONDS)], [part(SECONDS, 2 * SECONDS)])
    (verdict,) = diagnosis.verdicts
    assert [claim.finding.name for claim in verdict.claims] == ["step"]
    assert verdict.test_after.continues_training
    assert not verdict.predicts
    assert verdict.test_after.rms < 0.2 * verdict.test_before.rms
    stated = extended_model(diagnosis).channels["gyro_x"].residual_sd
    assert stated == pytest.approx(verdict.test_before.rms, rel=0.05)


def test_the_constant_of_a_curve_is_the_mean_over_runs_and_its_sigma_that_of_the_mean() -> None:
    """It was that of the first run's constant: larger by the root of the number of runs."""
    train, test = three(lambda time, _: np.zeros_like(time), 2400)
    train += [replace(one, name=f"{one.name} again") for one in train]
    (verdict,) = diagnose(train, test, "polynomial 3 + offset").verdicts
    base = verdict.channel.base
    of_constant = np.eye(base.shape[1])[0] + np.array([0.0] * 4 + [0.25] * 3)
    white = verdict.channel.floor.sd * np.linalg.norm(of_constant @ np.linalg.pinv(base))
    assert np.sqrt(verdict.declared_covariance[0, 0]) == pytest.approx(white, rel=0.3)
    assert (
        abs(verdict.after.declared[0] - 30.0 * DPH) < 4.0 * np.sqrt(verdict.declared_covariance[0, 0]) + DPH
    )
