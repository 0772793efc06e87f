"""What is known of a run that another one continues, and how exactly."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from imumon.effects.base import Effect
from imumon.effects.since_power_on import Drift, Periodic, Step
from imumon.lab.diagnosis.blocks import make_blocks, survey, white_floor
from imumon.lab.diagnosis.candidates import Candidate, Channel, Part, Training
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.fit import sigmas
from imumon.lab.diagnosis.likelihood import Likelihood
from imumon.lab.diagnosis.runs import Run
from tests.lab.diagnosis.units import DPH, Bias, ramps, run


def nothing(time: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.zeros_like(time)


def jump(time: np.ndarray, _: np.ndarray) -> np.ndarray:
    return np.where(time > 1200.0, 60.0, 0.0)


def offsets(levels: tuple[float, ...], seconds: int) -> list[Run]:
    """Return runs with a turn-on bias each, °/h, of distinct power-ons."""
    runs = []
    for at, level in enumerate(levels):
        one = run(at + 1, *ramps(seconds, at % 2 == 0), nothing)
        one.mean["gyro_x"] += level * DPH
        runs.append(replace(one, start_ns=at * 10**15))
    return runs


@pytest.mark.parametrize("continued", [0, 1])
def test_the_turn_on_bias_of_any_training_run_goes_on_in_a_test_that_continues_it(continued: int) -> None:
    """That of the first run, against which the others have their offsets, was estimated in the test."""
    seconds, half = 6000, 3600
    runs = offsets((0.0, 40.0), seconds)
    whole = runs[continued]
    parts = [
        replace(
            whole,
            name=name,
            time_s=whole.time_s[: stop - start],
            mean={key: values[start:stop] for key, values in whole.mean.items()},
            variance={key: values[start:stop] for key, values in whole.variance.items()},
            count={key: values[start:stop] for key, values in whole.count.items()},
            rest=whole.rest[start:stop],
            start_ns=(whole.start_ns or 0) + start * 10**9,
        )
        for name, start, stop in (("first part", 0, half), ("rest of it", half, seconds))
    ]
    train = [parts[0] if at == continued else one for at, one in enumerate(runs)]
    (verdict,) = diagnose(train, [parts[1]]).verdicts
    assert [claim.finding.name for claim in verdict.claims] == ["run_offset"]
    assert verdict.test_after.continues_training
    assert verdict.prediction.rms < 1.3 * verdict.channel.floor.sd < verdict.test_before.rms
    assert verdict.test_after.estimated_rms == verdict.prediction.rms


def test_the_sigma_of_a_constant_beside_a_jump_is_that_of_the_constant_that_is_stated() -> None:
    """It was that of the level before the jump; stated is the mean over the training."""
    train = [run(1, *ramps(3000, True), jump)]
    (verdict,) = diagnose(train, []).verdicts
    assert [claim.finding.name for claim in verdict.claims] == ["step"]
    channel, model = verdict.channel, [finding.candidate for finding in verdict.findings]
    design = channel.design(model)
    mean = np.append(np.eye(channel.base.shape[1])[0], design[:, -1].mean())
    white = verdict.channel.floor.sd * np.linalg.norm(mean @ np.linalg.pinv(design))
    assert np.sqrt(verdict.declared_covariance[0, 0]) == pytest.approx(white, rel=0.3)


def test_the_sigmas_of_many_runs_take_no_matrix_of_all_blocks_by_all() -> None:
    """It took that of the whitening: of 7,200 blocks 415 MB."""
    runs = [run(seed, *ramps(3000, seed % 2 == 0), nothing) for seed in range(12)]
    blocks = [make_blocks(one, ["gyro_x"], ["temperature"]) for one in runs]
    training = Training(blocks, "temperature")
    channel = Channel("gyro_x", white_floor("gyro_x", blocks), 3, "all", training, [])
    likelihood, span = Likelihood(training), survey(blocks, ["temperature"], 3)
    tracemalloc.start()
    sigmas(channel, span, likelihood, [Candidate((Part(Drift()),))])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 0.5 * 8 * likelihood.n**2


def sigma_beside(bias: Bias, effect: Effect, parameter: str) -> tuple[float, float, int]:
    """Return the sigma of a parameter in one run of 20,000 s, the white floor, and the number of blocks."""
    one = run(1, *ramps(20_000, True), bias)
    blocks = [make_blocks(one, ["gyro_x"], ["temperature"])]
    training, floor = Training(blocks, "temperature"), white_floor("gyro_x", blocks)
    channel, span = Channel("gyro_x", floor, 3, "all", training, []), survey(blocks, ["temperature"], 3)
    part = Part(effect, (0,) if effect.scope == "event" else ())
    _, ((found,),) = sigmas(channel, span, Likelihood(training), [Candidate((part,))])
    return found.nonlinear[parameter], floor.sd, len(blocks[0])


def test_the_sigma_of_a_period_of_many_cycles_is_that_of_white_noise() -> None:
    """The period was changed for the slope by a percent, two cycles at the end of these: sigma was five
    times too large."""
    swing = Periodic(period_s=100.0)
    found, floor, blocks = sigma_beside(lambda t, _: 8.0 * np.sin(2.0 * np.pi * t / 100.0), swing, "period_s")
    amplitude = 8.0 * DPH * np.sinc(0.3)
    of_frequency = np.sqrt(24.0 / blocks) * floor / (amplitude * 20_000.0)  # rad/s
    assert found == pytest.approx(100.0**2 / (2.0 * np.pi) * of_frequency, rel=0.15)


def test_the_sigma_of_the_time_of_a_late_jump_is_that_of_the_block_it_is_in() -> None:
    """Its time was changed by a percent, over many blocks: sigma was several times too large."""
    middle_s = 18_015.0  # of a block
    step = Step(time_s=middle_s)
    found, floor, _ = sigma_beside(lambda t, _: np.where(t >= middle_s, 60.0, 0.0), step, "time_s")
    assert found == pytest.approx(30.0 * floor / (60.0 * DPH), rel=0.15)
