from __future__ import annotations

import numpy as np
import pytest

from imumon.simulation.unit.unit import LowPass


def test_the_low_pass_lets_0_770_of_the_standard_deviation_through_at_100_hz() -> None:
    noise = np.random.default_rng(1).standard_normal((60_000, 3))
    out = LowPass(30.0, 100.0, np.zeros(3)).process(noise)
    assert out.std() / noise.std() == pytest.approx(0.770, rel=0.006)


def test_the_low_pass_keeps_the_density() -> None:
    noise = np.random.default_rng(2).standard_normal((200_000, 1))
    out = LowPass(30.0, 100.0, np.zeros(1)).process(noise)
    means = [values.reshape(-1, 100).mean(axis=1).std() for values in (out, noise)]
    assert means[0] / means[1] == pytest.approx(1.0, rel=0.01)


def test_the_low_pass_starts_settled_and_cuts_half_the_power_at_its_cutoff() -> None:
    t = np.arange(4000) / 400.0
    steady = LowPass(30.0, 400.0, np.array([3.0])).process(np.full((100, 1), 3.0))
    np.testing.assert_allclose(steady, 3.0, rtol=1e-12)
    sine = LowPass(30.0, 400.0, np.zeros(1)).process(np.sin(2 * np.pi * 30 * t)[:, np.newaxis])
    assert sine[2000:].std() * np.sqrt(2) == pytest.approx(np.sqrt(0.5), rel=0.005)


def test_a_unit_that_sends_slowly_is_not_filtered() -> None:
    values = np.random.default_rng(3).standard_normal((100, 2))
    np.testing.assert_array_equal(LowPass(30.0, 60.0, np.zeros(2)).process(values), values)
    np.testing.assert_array_equal(LowPass(None, 100.0, np.zeros(2)).process(values), values)
