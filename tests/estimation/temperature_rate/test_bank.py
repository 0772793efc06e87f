"""The compiled bank against the plain one, and its parts against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.temperature_rate.bank import (
    AA,
    NOISES,
    RR,
    TT,
    WEIGHT,
    A,
    T,
    condition,
    empty_bank,
    mix,
    motion_over,
    predict,
    restart,
    reweigh,
)
from imumon.estimation.temperature_rate.level_bank import LevelBankRate
from tests.estimation.temperature_rate.plain_bank import PlainBank, slots
from tests.estimation.temperature_rate.records import PER_HOUR, clock, quantized, steady


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_rate_and_band_equal_those_of_the_plain_twin(noise: float) -> None:
    t = np.arange(450) / 10.0
    temperature = steady(30.0, 45.0 / PER_HOUR) + 0.02 * np.sin(t / 10.0)
    reading = quantized(temperature, noise)
    time_ns, segment = clock(len(reading))
    result = LevelBankRate(0.05).process(time_ns, segment, reading)
    plain = PlainBank(reading[0], 0.05)
    shown_at, rate, acceleration, remainder, compared = 0.0, 0.0, 0.0, 0.0, 0
    for closed, slot in slots(t, reading):
        age = closed - shown_at
        before = rate + age * acceleration + remainder * np.exp(-age / 3.0)
        plain.measure(slot)
        mean, acceleration, sd = plain.shown(slot)
        shown_at, rate = closed, mean + (closed - slot.at) * acceleration
        remainder = before - rate
        i = round(closed * 10)
        assert result.rate[i] == pytest.approx(before, abs=0.01 * sd)
        assert result.rate_sd[i] == pytest.approx(np.hypot(sd, remainder), rel=0.01)
        compared += 1
    assert compared > 40


def test_mixing_keeps_weight_and_moments_of_the_whole() -> None:
    bank, work = empty_bank(), empty_bank()
    restart(bank, 20.0, 0.05, 0.0, False)
    rng = np.random.default_rng(1)
    bank[:, WEIGHT] = rng.dirichlet(np.ones(len(bank)))
    bank[:, T : A + 1] = rng.normal(size=(len(bank), 3))
    mean = bank[:, WEIGHT] @ bank[:, T]
    square = bank[:, WEIGHT] @ (bank[:, TT] + bank[:, T] ** 2)
    mix(bank, work, 60.0)
    assert bank[:, WEIGHT].sum() == pytest.approx(1.0, rel=1e-12)
    assert bank[:, WEIGHT] @ bank[:, T] == pytest.approx(mean, rel=1e-12)
    assert bank[:, WEIGHT] @ (bank[:, TT] + bank[:, T] ** 2) == pytest.approx(square, rel=1e-12)


def test_two_predictions_equal_one_of_both_times() -> None:
    rows = empty_bank()[:2]
    rows[:, T : A + 1] = 20.0, 1e-3, 1e-6
    rows[:, TT], rows[:, RR], rows[:, AA] = 1e-4, 1e-6, 1e-12
    predict(rows[0], motion_over(2.0), 0.0)
    predict(rows[0], motion_over(3.0), 0.0)
    predict(rows[1], motion_over(5.0), 0.0)
    np.testing.assert_allclose(rows[0], rows[1], rtol=1e-9)


def test_conditioning_on_a_measurement_is_the_kalman_update() -> None:
    rng = np.random.default_rng(2)
    root = rng.normal(size=(3, 3))
    p, x, z, variance = root @ root.T, rng.normal(size=3), 0.7, 0.2
    row = np.array([1.0, *x, *p[np.triu_indices(3)]])
    total = p[0, 0] + variance
    condition(row, x[0] + p[0, 0] / total * (z - x[0]), p[0, 0] * variance / total)
    np.testing.assert_allclose(row[1:4], x + p[:, 0] * (z - x[0]) / total, rtol=1e-12)
    expected = p - np.outer(p[:, 0], p[:, 0]) / total
    np.testing.assert_allclose(row[4:], expected[np.triu_indices(3)], rtol=1e-10)


def test_negligible_hypotheses_go_and_the_rest_is_normalized() -> None:
    bank = empty_bank()
    bank[:3, WEIGHT] = 0.5, 0.5, 1e-9
    reweigh(bank, np.log(np.array([3.0, 1.0, 1e12, *np.ones(len(bank) - 3)])))
    np.testing.assert_allclose(bank[:3, WEIGHT], [0.75, 0.25, 0.0], rtol=1e-12)


def test_a_restart_may_keep_what_is_known_of_the_noise() -> None:
    bank = empty_bank()
    bank[2, WEIGHT] = 1.0
    restart(bank, 30.0, 0.05, 0.0, True)
    per_noise = bank[:, WEIGHT].reshape(-1, len(NOISES)).sum(0)
    np.testing.assert_allclose(per_noise, np.eye(len(NOISES))[2], atol=1e-12)


def test_a_state_that_is_not_carried_on_never_counts() -> None:
    bank, work = empty_bank(), empty_bank()
    restart(bank, 20.0, 0.05, 0.0, False)
    bank[1:, WEIGHT] = 0.0
    bank[0, WEIGHT] = 1.0
    bank[1:, T] = 1e9
    for _ in range(600):
        mix(bank, work, 1.0)
    assert bank[:, WEIGHT] @ bank[:, T] / bank[:, WEIGHT].sum() == pytest.approx(20.0, rel=1e-9)
    assert bank[:, WEIGHT].sum() == pytest.approx(1.0, abs=1e-3)
