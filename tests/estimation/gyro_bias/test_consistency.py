"""What is claimed is true: errors and innovations over their sigmas, flicker noise in the truth."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.bank import LEAST_WHITE, SENSITIVITY, SENSITIVITY_SD, SLOPE_PER_SIGMA, Bank
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.estimation.rest.slots import Measurement
from tests.bias_noise import INSTABILITY_PER_DECADE
from tests.estimation.gyro_bias.records import (
    ARW,
    DPH,
    GIVEN,
    Truth,
    markov,
    record,
    vector,
    with_rest,
)

RUNS = 24
AT_S = (30.0, 60.0, 100.0, 150.0, 199.0)


def runs(truth: Truth, parameters: GyroBiasParameters) -> tuple[FloatArray, FloatArray]:
    """Return normalised errors (runs, times, 3) and normalised innovations after a minute (values, 3)."""
    errors, innovations = [], []
    at = [round(t * truth.rate_hz) for t in AT_S]
    for seed in range(RUNS):
        block, bias = record(truth, 200.0, seed)
        added = RestAndBias(parameters).process(block)
        errors.append(((vector(added) - bias) / vector(added, "gyro_bias_sd"))[at])
        given = vector(added, "zupt_innovation")[round(60 * truth.rate_hz) :]
        innovations.append(given[np.isfinite(given[:, 0])])
    return np.array(errors), np.concatenate(innovations)


@pytest.mark.long
def test_with_known_noise_errors_and_innovations_are_within_chi_square_bounds() -> None:
    known = GyroBiasParameters(
        assume_at_rest=True,
        angle_random_walk_rad_per_sqrt_s=ARW,
        bias_instability_rad_per_s=2.0 * DPH * INSTABILITY_PER_DECADE,
    )
    errors, innovations = runs(Truth(rate_hz=10.0, low_pass_hz=None), known)
    low, high = chi2.ppf([0.001, 0.999], 3 * RUNS) / (3 * RUNS)
    for square in np.mean(errors**2, axis=(0, 2)):
        assert 0.7 * low < square < high
    assert 0.9 < np.mean(innovations**2) < 1.05
    lagged = np.mean(innovations[1:] * innovations[:-1], axis=0)
    assert np.abs(lagged).max() < 0.1


@pytest.mark.long
def test_with_nothing_known_the_claim_is_careful_not_bold() -> None:
    """The axes wander differently: each has its own bounds."""
    flicker = np.array([1.0, 2.0, 5.0]) * DPH
    errors, innovations = runs(Truth(rate_hz=10.0, flicker=flicker, low_pass_hz=None), GIVEN)
    squares = np.mean(errors**2, axis=0)
    assert (squares.min(0) > [0.08, 0.19, 0.5]).all()
    most = np.array([1.22, 1.22, 1.9])
    assert (squares.mean(0) < most).all()
    assert (squares.max(0) < most * chi2.ppf(0.99, RUNS) / RUNS).all()
    assert np.mean(np.abs(errors) < 2.0) > 0.9
    assert np.mean(innovations**2, axis=0) == pytest.approx(np.ones(3), abs=0.08)


@pytest.mark.long
@pytest.mark.parametrize("arw_deg", [0.03, 0.3])
def test_the_sigma_is_true_of_a_gyro_that_mostly_flickers(arw_deg: float) -> None:
    """27 °/h in each decade are more than the white noise of a second, or of a hundredth."""
    truth = Truth(rate_hz=10.0, arw=np.radians(arw_deg) / 60.0, flicker=27.0 * DPH, low_pass_hz=None)
    normalised = []
    for seed in range(30, 34):
        block, bias = record(truth, 600.0, seed)
        added = RestAndBias(GIVEN).process(block)
        normalised.append(((vector(added) - bias) / vector(added, "gyro_bias_sd"))[600:])
    z = np.concatenate(normalised)
    assert 0.7 < np.sqrt(np.mean(z**2)) < 1.5
    assert np.mean(np.abs(z) > 5.0) < 2e-3


@pytest.mark.long
def test_without_a_model_the_claim_holds_while_it_moves_and_warms_up() -> None:
    t = np.arange(15000) / 10
    temperature = 25.0 + 20.0 * (1.0 - np.exp(-t / 400.0))
    # Curves like those of a MEMS gyro: steep, bent, and nearly flat.
    curves = (45.0 * (temperature - 25.0), -1500.0 * np.tanh((temperature - 32.0) / 15.0), 0.3 * temperature)
    thermal = np.column_stack(curves) * DPH
    rest = t % 120.0 < 10.0
    moving = ~rest & (t > 15.0)
    squares, largest = [], 0.0
    for seed in range(3):
        block, bias = record(Truth(rate_hz=10.0, low_pass_hz=None), 1500.0, seed, thermal)
        added = RestAndBias(GIVEN, mode="learned").process(
            with_rest(block.with_columns({"temperature": temperature}), rest)
        )
        off = (vector(added) - bias) / vector(added, "gyro_bias_sd")
        squares.append(np.mean(off[moving] ** 2, axis=0))
        largest = max(largest, float(np.abs(off[moving]).max()))
        sd = vector(added, "gyro_bias_sd")[rest & (t > 600.0)] / DPH
        assert np.median(sd, axis=0).max() < 60.0  # true, and of use
    assert np.mean(squares, axis=0).max() < 1.5
    assert largest < 5.0


@pytest.mark.long
def test_the_sigma_is_true_for_five_decades_of_flicker() -> None:
    """White noise and five decades of flicker of an MTi-28A: Allan deviation 127 deg/h at 1 s, floor 9."""
    white, sd, rate_hz, n = 127.0 * DPH, 12.0 * DPH, 10.0, 18000
    normalised = []
    for seed in range(3):
        rng = np.random.default_rng(seed)
        drift = np.zeros((n, 3))
        for tau in (1.0, 10.0, 100.0, 1e3, 1e4):
            drift += markov(rng, n, 1.0 / rate_hz, tau, sd)
        block, _ = record(Truth(rate_hz=rate_hz), n / rate_hz, seed)
        gyro = drift + white * np.sqrt(rate_hz) * rng.normal(size=(n, 3))
        added = RestAndBias(GIVEN).process(
            block.with_columns({f"gyro_{axis}": gyro[:, j] for j, axis in enumerate("xyz")})
        )
        late = slice(600, None)
        off = (vector(added, "gyro_random_error") - drift)[late]
        normalised.append(np.mean((off / vector(added, "gyro_random_error_sd")[late]) ** 2))
    assert 0.5 < np.sqrt(np.mean(normalised)) < 1.25


@pytest.mark.long
@pytest.mark.parametrize(("walk", "times"), [(2e-7, 3.0), (2e-5, 1.0)])  # as docs/random-error.md has it
def test_a_walk_without_flicker_has_too_large_a_sigma_if_it_is_weak(walk: float, times: float) -> None:
    normalised = []
    for seed in range(2):
        block, bias = record(Truth(rate_hz=4.0, flicker=0.0, walk=walk, low_pass_hz=None), 600.0, seed)
        added = RestAndBias(GIVEN).process(block)
        normalised.append(((vector(added) - bias) / vector(added, "gyro_bias_sd"))[240:])
    assert 1.0 / np.sqrt(np.mean(np.square(normalised))) == pytest.approx(times, rel=0.2)


@pytest.mark.long
def test_declared_noise_holds_though_a_fan_ran_in_the_first_rest() -> None:
    walk, rate_hz = 2e-6, 10.0
    declared = GyroBiasParameters(rate_random_walk_rad_per_s_per_sqrt_s=walk, assume_at_rest=True)
    truth = Truth(rate_hz, flicker=0.0, walk=walk, low_pass_hz=None)
    block, _ = record(truth, 1600.0, 0)
    t = np.arange(len(block)) / rate_hz
    fan = np.where(t < 100.0, 3e-3 * np.random.default_rng(1).standard_normal(len(t)), 0.0)
    sd = []
    for added in (0.0, fan):
        samples = block.with_columns({f"gyro_{axis}": block[f"gyro_{axis}"] + added for axis in "xyz"})
        sd.append(vector(RestAndBias(declared).process(with_rest(samples, t < 1000.0)), "gyro_bias_sd")[-1])
    assert (np.array(sd) > 0.9 * walk * np.sqrt(600.0)).all()
    assert sd[1] == pytest.approx(sd[0], rel=0.1)


@pytest.mark.parametrize("seconds", [1, 4])
def test_the_first_means_are_as_certain_as_their_sigma(seconds: int) -> None:
    """The noise is known as that of a chi-square of six degrees of freedom; there is neither flicker nor
    walk."""
    rng, sigma, zero, z = np.random.default_rng(0), 1e-5, np.zeros(3), []
    for _ in range(700):
        bias, white = rng.normal(0.0, 0.02, 3), sigma**2 * rng.chisquare(6.0, 3) / 6.0
        means = [
            Measurement(
                k + 1.0, 1.0, 1.0, bias + sigma * rng.standard_normal(3), zero, np.full((2, 3), np.nan), zero
            )
            for k in range(seconds)
        ]
        bank = Bank.begin([None, zero, zero], (0.0,), white, means[0])
        for now in means[1:]:
            bank = bank.after(now)
        mean, variance = bank.prediction.bias(zero)
        z.append((mean - bias) / np.sqrt(variance))
    assert 0.93 < np.sqrt(np.mean(np.square(z))) < 1.03


def test_the_prior_of_the_sensitivity_is_that_of_the_data_sheets_whatever_the_noise() -> None:
    zero = np.zeros(3)
    first = Measurement(1.0, 1.0, 1.0, zero, zero, np.full((2, 3), np.nan), zero)
    for white in (1e-12, 1e-6):
        bank = Bank.begin((None, None, None), (0.0,), np.full(3, white), first)
        sd = np.sqrt(np.einsum("aii->ai", bank.prediction.covariance)[:, SENSITIVITY])
        assert sd == pytest.approx(np.full((3, 3), SENSITIVITY_SD))


def test_a_gyro_whose_readings_were_equal_for_hours_has_a_sigma_when_they_change() -> None:
    zero, rng = np.zeros(3), np.random.default_rng(0)

    def reading(time_s: float, rate: float) -> Measurement:
        force = rng.normal([0.0, 0.0, 9.8], 0.005)
        return Measurement(time_s, 1.0, 1.0, np.full(3, rate), force, np.zeros((2, 3)), zero)

    bank = Bank.begin((None, None, None), (0.0,), np.full(3, LEAST_WHITE), reading(1.0, 0.0))
    for k in range(2, 5000):
        bank = bank.after(reading(float(k), 0.0))
    for k in range(3):
        bank = bank.after(reading(5000.0 + 2 * k, 1e-3), jumped=True).after(reading(5001.0 + 2 * k, 1e-3))
    mean, variance = bank.prediction.bias(np.array([0.0, 0.0, 9.8]))
    assert mean == pytest.approx(np.full(3, 1e-3))
    assert (variance > 0.1 * LEAST_WHITE).all()


def test_a_motion_of_one_step_widens_the_bias_like_one_of_many() -> None:
    """The slope changes on the way, and the bias with it."""
    zero, cold, white = np.zeros(3), np.array([[25.0], [0.0]]) + np.zeros(3), np.full(3, (17.0 * DPH) ** 2)
    first = Measurement(1.0, 1.0, 1.0, zero, zero, cold, zero)
    start = Bank.begin((None, None, None), (SLOPE_PER_SIGMA,), white, first)
    for change in (np.array([[10.0], [0.0]]), np.array([[-10.0], [0.0]])):
        one = many = start
        one = one.at(101.0, cold + change)
        for k in range(1, 101):
            many = many.at(1.0 + k, cold + change * k / 100.0)
        np.testing.assert_allclose(one.covariance, many.covariance, rtol=1e-9, atol=1e-30)
