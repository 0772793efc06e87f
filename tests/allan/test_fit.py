"""The terms that were put in are found, within their stated standard deviations; others are not."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.allan.analysis import analyse
from imumon.allan.covariance import NAMES
from imumon.allan.fit import DIGITS, Fit
from imumon.allan.series import even_channels
from imumon.blocks import FloatArray
from tests.allan.simulated import correlated, noise

INTERVAL_S = 0.02
N = 60_000
SEEDS = 20


def fits(records: list[FloatArray]) -> list[Fit]:
    n = len(records[0])
    channels = {str(row): values for row, values in enumerate(records)}
    series = even_channels(np.arange(n) * round(INTERVAL_S * 1e9), np.zeros(n, np.int64), channels)
    found = [result.fit for result in analyse(series).values()]
    return [fit for fit in found if fit is not None]


CASES = [
    {"angle_random_walk": 1e-3},
    {"angle_random_walk": 1e-3, "rate_random_walk": 2e-4},
    {"angle_random_walk": 1e-3, "bias_instability": 7e-4},
    {"angle_random_walk": 1e-3, "bias_instability": 7e-4, "quantization": 3e-4},
    {"angle_random_walk": 1e-3, "rate_ramp": 5e-6},
]
ARGUMENTS = {
    "angle_random_walk": "white",
    "bias_instability": "instability",
    "rate_random_walk": "walk",
    "quantization": "quantization",
    "rate_ramp": "ramp",
}


@pytest.mark.parametrize("truth", CASES, ids="+".join)
def test_terms_are_found_within_their_standard_deviations(truth: dict[str, float]) -> None:
    arguments = {ARGUMENTS[name]: value for name, value in truth.items()}
    found = fits([noise(seed, N, INTERVAL_S, **arguments) for seed in range(1000, 1000 + SEEDS)])
    assert len(found) == SEEDS
    for name, value in truth.items():
        estimates = [fit.terms[name] for fit in found]
        errors = np.array([(each.value - value) / each.sd for each in estimates if each is not None])
        assert len(errors) >= 0.95 * SEEDS, name
        assert abs(errors.mean()) < 0.7, name
        assert 0.7 < np.sqrt(np.mean(errors**2)) < 1.5, name
        assert np.mean(np.abs(errors) < 2) > 0.82, name
    for term in NAMES:
        if term not in truth:
            assert sum(fit.terms[term] is not None for fit in found) <= 2, term


def test_noise_with_heavy_tails_is_known_less_well_and_reports_it() -> None:
    rng = np.random.default_rng(7)
    found = fits([1e-3 / np.sqrt(2.0 * INTERVAL_S) * rng.standard_t(4.0, N) for _ in range(12)])
    walks = [estimate for fit in found if (estimate := fit.terms["angle_random_walk"]) is not None]
    errors = np.array([(walk.value - 1e-3) / walk.sd for walk in walks])
    assert len(errors) == 12
    assert 0.5 < np.sqrt(np.mean(errors**2)) < 1.5


def test_flicker_and_random_walk_that_look_alike_do_not_take_each_others_place() -> None:
    truth = 1e-4
    found = fits(
        [noise(seed, N, INTERVAL_S, white=1e-3, instability=3e-4, walk=truth) for seed in range(1000, 1030)]
    )
    walks = [estimate for fit in found if (estimate := fit.terms["rate_random_walk"]) is not None]
    errors = np.array([(walk.value - truth) / walk.sd for walk in walks])
    assert len(errors) > 15
    assert np.sqrt(np.mean(errors**2)) < 1.3
    assert np.mean([walk.value for walk in walks]) < 1.1 * truth


def test_a_filter_in_the_device_is_left_out_and_the_angle_random_walk_is_still_found() -> None:
    rng = np.random.default_rng(5)
    white = 1e-3 / np.sqrt(INTERVAL_S) * rng.normal(size=N + 7)
    filtered = np.convolve(white, np.ones(8) / 8, "valid")
    (fit,) = fits([filtered])
    assert 0 < fit.first < 5
    estimate = fit.terms["angle_random_walk"]
    assert estimate is not None
    assert estimate.value == pytest.approx(1e-3, abs=3 * estimate.sd)
    assert estimate.sd < 3e-5
    assert fit.terms["quantization"] is None


def tone(hertz: float, size: float) -> FloatArray:
    return np.asarray(size * np.sin(2 * np.pi * hertz * INTERVAL_S * np.arange(N)), np.float64)


def test_a_small_tone_widens_the_standard_deviations_by_enough() -> None:
    plain = noise(6, N, INTERVAL_S, white=1e-3)
    good, bad = fits([plain, plain + tone(0.5, 1e-3)])
    assert good.model_error == 0.0
    assert bad.model_error > 0.02
    certain, uncertain = good.terms["angle_random_walk"], bad.terms["angle_random_walk"]
    assert certain is not None
    assert uncertain is not None
    assert uncertain.sd > 3 * certain.sd
    assert uncertain.value == pytest.approx(1e-3, abs=3 * uncertain.sd)


@pytest.mark.parametrize("size", [3e-3, 3e-2, 0.3])
def test_a_slow_tone_of_any_size_leaves_the_angle_random_walk_alone_and_true(size: float) -> None:
    found = fits([noise(seed, N, INTERVAL_S, white=1e-3) + tone(0.05, size) for seed in range(6)])
    for fit in found:
        assert fit.last < 9
        estimates = dict(fit.terms)
        estimate = estimates.pop("angle_random_walk")
        assert not any(estimates.values())
        if size < 0.1:
            assert estimate is not None
        if estimate is not None:
            assert estimate.value == pytest.approx(1e-3, abs=3.5 * estimate.sd)


@pytest.mark.parametrize(("hertz", "size"), [(0.5, 0.1), (5.03, 0.01), (5.03, 0.1)])
def test_no_term_is_reported_of_a_curve_that_a_tone_has_taken_over(hertz: float, size: float) -> None:
    for fit in fits([noise(seed, N, INTERVAL_S, white=1e-3) + tone(hertz, size) for seed in range(6)]):
        assert not any(fit.terms.values())


def test_a_correlated_disturbance_is_not_taken_for_a_filter() -> None:
    rng = np.random.default_rng(8)
    slow = np.zeros(N)
    for k, step in enumerate(rng.normal(scale=1e-3 * np.sqrt(2 * INTERVAL_S / 3.0), size=N - 1)):
        slow[k + 1] = (1.0 - INTERVAL_S / 3.0) * slow[k] + step
    (fit,) = fits([noise(9, N, INTERVAL_S, white=1e-3) + slow])
    estimate = fit.terms["angle_random_walk"]
    assert estimate is not None
    assert estimate.value == pytest.approx(1e-3, rel=0.05)


@pytest.mark.parametrize(("sd", "time_s"), [(2e-3, 10.0), (2e-3, 3.0), (2e-2, 10.0)])
def test_correlated_noise_is_reported_as_such_with_its_time(sd: float, time_s: float) -> None:
    found = fits(
        [
            noise(700 + row, N, INTERVAL_S, white=1e-3) + correlated(800 + row, N, INTERVAL_S, sd, time_s)
            for row in range(3)
        ]
    )
    truth = {"angle_random_walk": 1e-3, "correlated_noise": sd, "correlation_time": time_s}
    for name, value in truth.items():
        told = [term for fit in found if (term := fit.terms[name]) is not None]
        assert len(told) == len(found)
        assert max(abs(term.value - value) / term.sd for term in told) < 4.0
    for name in ("bias_instability", "rate_random_walk", "rate_ramp", "quantization"):
        assert not any(fit.terms[name] for fit in found)


def test_a_reported_term_never_lies_above_the_measured_curve() -> None:
    """A random walk that was told of such noise stood seven times above the curve of a longer record."""
    records = [
        noise(600 + row, N, INTERVAL_S, white=1e-3) + correlated(row, N, INTERVAL_S, sd, time_s)
        for row, (sd, time_s) in enumerate([(1e-2, 30.0), (1e-3, 30.0), (3e-4, 10.0), (1e-3, 100.0)])
    ]
    n = len(records[0])
    channels = {str(row): values for row, values in enumerate(records)}
    series = even_channels(np.arange(n) * round(INTERVAL_S * 1e9), np.zeros(n, np.int64), channels)
    for result in analyse(series).values():
        assert result.fit is not None
        walk = result.fit.terms["rate_random_walk"]
        flicker = result.fit.terms["bias_instability"]
        upper = result.allan.high[: result.trusted]
        if walk is not None:
            line = (walk.value - 2 * walk.sd) * np.sqrt(result.tau_s[: result.trusted] / 3)
            assert np.all(line < 2 * upper)
        if flicker is not None:
            assert np.all(0.664 * (flicker.value - 2 * flicker.sd) < 2 * upper)


@pytest.mark.parametrize("steps", [1.0, 2.0, 2.5])
def test_the_noise_of_rounded_readings_is_reported_with_what_rounding_adds(steps: float) -> None:
    step = steps * 1e-3 / np.sqrt(INTERVAL_S)
    rng = np.random.default_rng(21)
    found = fits(
        [
            step * np.round(noise(900 + row, N, INTERVAL_S, white=1e-3) / step + rng.uniform())
            for row in range(8)
        ]
    )
    truth = 1e-3 * np.sqrt(1.0 + steps**2 / 12.0)
    told = [term for fit in found if (term := fit.terms["angle_random_walk"]) is not None]
    assert len(told) == len(found)
    assert np.sqrt(np.mean([((term.value - truth) / term.sd) ** 2 for term in told])) < 1.6


@pytest.mark.parametrize("steps", [4.0, 10.0, 20.0])
def test_nothing_is_reported_of_noise_that_the_steps_of_the_readings_hide(steps: float) -> None:
    step = steps * 1e-3 / np.sqrt(INTERVAL_S)
    for fit in fits(
        [
            step * np.round(noise(950 + row, N, INTERVAL_S, white=1e-3) / step + 0.125 * row)
            for row in range(1, 8)
        ]
    ):
        assert not any(fit.terms.values())
        assert fit.withheld == DIGITS
