"""The grid of noise beside which candidates are tried."""

from __future__ import annotations

import tracemalloc

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive
from imumon.effects.since_power_on import Drift, StressRelaxation
from imumon.lab.diagnosis.blocks import make_blocks
from imumon.lab.diagnosis.candidates import ALL_RUNS, Candidate, Part, Term, Training, least_squares
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
    beside = np.column_stack([curve, training.effect_columns([Candidate((Part(Drift()),))])])
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


BLOCKS = 240


def with_columns(columns: FloatArray) -> tuple[Likelihood, FloatArray, list[Term]]:
    """Return the likelihood of a run with these columns (n, k), a cubic, and their terms."""
    told = run(1, *ramps(30 * BLOCKS, up=True), lambda time, _: 0.0 * time)
    training = Training([make_blocks(told, ["gyro_x"], ["temperature"])], "temperature", [*columns.T])
    cubic = np.linspace(-1.0, 1.0, BLOCKS)[:, np.newaxis] ** np.arange(4)
    return Likelihood(training), cubic, [Term(at, ALL_RUNS) for at in range(columns.shape[1])]


def test_nearly_collinear_columns_explain_no_more_than_they_can() -> None:
    """As a difference of products, G had eigenvalues below zero: too much was explained, or less than 0."""
    random = np.random.default_rng(5)
    for apart in (1e-1, 1e-2, 1e-3, 1e-5, 1e-9, 0.0):
        for _ in range(20):
            one, other, noise = random.standard_normal((3, BLOCKS))
            like = np.column_stack([one, one + apart * other])
            likelihood, cubic, terms = with_columns(2e-5 * like + random.standard_normal(2))
            values = 3.0 * one + noise
            found, alone = likelihood.scan(values, cubic, [terms, []], [(0.0, 0.0)]).tolist()
            without, left = (values - x @ least_squares(x, values) for x in (cubic, np.hstack([cubic, like])))
            most = 0.5 * BLOCKS * np.log((without @ without) / (left @ left))
            assert -1e-6 <= found - alone <= most + 1e-3


def test_an_effect_without_columns_has_means_without_columns() -> None:
    """An effect of another package with a free start and no `starts` ended the run."""
    blocks = make_blocks(
        run(1, *ramps(600, up=True), lambda time, _: 0.0 * time), ["gyro_x"], ["temperature"]
    )
    assert blocks.average(np.empty((600, 0))).shape == (len(blocks), 0)


def test_the_memory_of_a_scan_does_not_grow_with_the_candidates() -> None:
    """Whitened columns were kept for each noise: 6.5 GB for two days at rest."""
    columns = np.random.default_rng(7).standard_normal((BLOCKS, 4000))
    likelihood, cubic, terms = with_columns(columns)
    tracemalloc.start()
    found = likelihood.scan(columns[:, 7], cubic, [[term] for term in terms], NOISE_GRID)
    assert tracemalloc.get_traced_memory()[1] < columns.nbytes
    tracemalloc.stop()
    assert np.argmax(found) == 7
