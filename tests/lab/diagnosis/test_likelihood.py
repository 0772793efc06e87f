"""The grid of noise beside which candidates are tried."""

from __future__ import annotations

import numpy as np

from imumon.effects.base import Drive
from imumon.effects.since_power_on import Drift, StressRelaxation
from imumon.lab.diagnosis.blocks import make_blocks
from imumon.lab.diagnosis.candidates import Candidate, Part, Training
from imumon.lab.diagnosis.likelihood import NOISE_GRID, TAUS_S, Likelihood, noise_no_larger
from tests.lab.diagnosis.units import DPH, WHITE_DPH, ramps, run

SECONDS = 7200


def test_noise_beside_a_better_model_is_no_larger_but_may_be_of_another_kind() -> None:
    for start in NOISE_GRID:
        grid = noise_no_larger(start)
        assert start in grid
        assert max(map(sum, grid)) == sum(start)
    assert (3.0, 0.0) in noise_no_larger((0.0, 10.0))


def test_what_is_a_walk_without_a_drift_is_flicker_with_it() -> None:
    random = np.random.default_rng(3)
    flicker = np.zeros(SECONDS)
    for tau in TAUS_S:
        steps = random.standard_normal(SECONDS) * np.sqrt(1.0 - np.exp(-2.0 / tau))
        for at in range(1, SECONDS):
            steps[at] += np.exp(-1.0 / tau) * steps[at - 1]
        flicker += WHITE_DPH * np.sqrt(1.0 / len(TAUS_S)) * steps
    told = run(4, *ramps(SECONDS, up=True), lambda time, _: 15.0 * time / SECONDS + flicker)
    blocks = make_blocks(told, ["gyro_x"], ["temperature"])
    curve = (blocks.temperature["temperature"] - 25.0)[:, np.newaxis] ** np.arange(4)
    training = Training([blocks], "temperature")
    likelihood = Likelihood(training)
    walk = likelihood.maximum(blocks.mean["gyro_x"] / DPH, curve)[1]
    assert walk[1] > walk[0]
    beside = np.column_stack([curve, training.design([Candidate((Part(Drift()),))])])
    noise = likelihood.maximum(blocks.mean["gyro_x"] / DPH, beside)[1]
    assert noise in noise_no_larger(walk)
    assert noise[0] > walk[0]
    assert noise[1] < walk[1]


def test_a_spectrum_with_both_signs_explains_nothing() -> None:
    creep = StressRelaxation(time_constant_s=20.0, ratio=16.0, steps=2)
    for weights, explains in (((30.0, 10.0), True), ((-30.0, 10.0), False)):
        effect = creep.with_coefficients(weights)
        told = run(6, *ramps(SECONDS, up=True), lambda time, t: effect.simulate(Drive(time, t)))  # noqa: B023 - called at once
        blocks = make_blocks(told, ["gyro_x"], ["temperature"])
        curve = (blocks.temperature["temperature"] - 25.0)[:, np.newaxis] ** np.arange(4)
        training = Training([blocks], "temperature")
        likelihood = Likelihood(training)
        values, white = blocks.mean["gyro_x"] / DPH, (0.0, 0.0)
        terms = [training.terms(Candidate((Part(creep),)))[0]]
        found, alone = likelihood.scan(values, curve, [*terms, []], [white]).tolist()
        gain = found - alone
        assert gain > 50.0 if explains else abs(gain) < 1e-6


def test_signs_are_compared_across_a_step_that_the_base_explains() -> None:
    """Only neighbours were compared, and the coefficient of such a step is zero."""
    creep = StressRelaxation(time_constant_s=20.0, ratio=6.0, steps=3)
    effect = creep.with_coefficients([-30.0, 0.0, 30.0])
    told = run(6, *ramps(SECONDS, up=True), lambda time, t: effect.simulate(Drive(time, t)))
    blocks = make_blocks(told, ["gyro_x"], ["temperature"])
    training = Training([blocks], "temperature")
    terms = training.terms(Candidate((Part(creep),)))[0]
    curve = (blocks.temperature["temperature"] - 25.0)[:, np.newaxis] ** np.arange(4)
    base = np.column_stack([curve, training.matrix(terms[1:2])])
    likelihood, values = Likelihood(training), blocks.mean["gyro_x"] / DPH
    found, alone = likelihood.scan(values, base, [terms, []], [(0.0, 0.0)]).tolist()
    assert abs(found - alone) < 1e-6
