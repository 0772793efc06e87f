from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.alignment.sums import decay_terms
from imumon.geodesy import EARTH_RATE
from imumon.published.fixed_gain_loop import azimuth, level_attitude, loop_gains, loop_step

G = 9.80665
LEVEL = EARTH_RATE * math.cos(math.radians(36.0))


def plain_step(
    attitude: FloatArray, velocity: FloatArray, rate: FloatArray, force: FloatArray, reference: FloatArray,
    decay: float, gain: float, h: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """The loop in matrices: turns of body and frame, to second order in the small angles."""
    velocity = decay * velocity + h * (attitude @ force)[:2]
    control = np.array([-gain * velocity[1], gain * velocity[0], 0.0])
    small = h * (control + reference - attitude @ rate)
    x, y, z = small
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return attitude - skew @ attitude + 0.5 * skew @ skew @ attitude, velocity, control


def test_the_loop_is_that_of_its_matrices() -> None:
    rng = np.random.default_rng(0)
    h = 0.005
    decay, gain = loop_gains(2.0 * math.pi * 2.0, 0.7, h, G)
    attitude, velocity, turned = np.empty((3, 3)), np.zeros(2), np.zeros(5)
    level_attitude(np.array([0.3, -0.2, 9.7]), np.array([0.5, 0.7, 0.1]), attitude)
    twin, speed = attitude.copy(), velocity.copy()
    reference = np.array([0.0, LEVEL, 4e-5])
    for _ in range(400):
        rate, force = (
            1e-3 * rng.standard_normal(3),
            np.array([0.3, -0.2, 9.7]) + 0.05 * rng.standard_normal(3),
        )
        twin, speed, control = plain_step(twin, speed, rate, force, reference, decay, gain, h)
        loop_step(attitude, velocity, rate, force, reference, decay, gain, h, turned)
        np.testing.assert_allclose(turned[3:], h * control[:2], rtol=1e-4, atol=1e-10)
    np.testing.assert_allclose(attitude, twin, atol=1e-6)
    np.testing.assert_allclose(attitude @ attitude.T, np.eye(3), atol=1e-12)


def test_the_warm_up_makes_the_published_heading_errors() -> None:
    """Equation 22 of Lee et al.: 1.53 and 1.39 mrad at 30 and 60 s for 30 µg, 300 s, 2 Hz, 36°."""
    h, amplitude, tau = 0.005, 30e-6 * G, 300.0
    decay, gain = loop_gains(2.0 * math.pi * 2.0, 0.7, h, G)
    attitude, velocity, turned = np.eye(3), np.zeros(2), np.zeros(5)
    earth = np.array([0.0, LEVEL, 0.0])
    found = {}
    for i in range(1, 12001):
        error = amplitude * (1.0 - math.exp(-i * h / tau))
        loop_step(attitude, velocity, earth, np.array([error, error, G]), earth, decay, gain, h, turned)
        found[i * h] = abs(turned[3]) / h / LEVEL
    assert 1e3 * found[30.0] == pytest.approx(1.53, rel=0.01)
    assert 1e3 * found[60.0] == pytest.approx(1.39, rel=0.01)
    assert abs(attitude[1, 2]) == pytest.approx(30e-6 * (1.0 - math.exp(-60.0 / tau)), rel=0.01)


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 200.0, 2000.0])
@pytest.mark.parametrize("damping", [0.3, 0.7, 1.0, 1.5])
def test_the_loop_is_stable_at_every_rate(rate_hz: float, damping: float) -> None:
    decay, gain = loop_gains(2.0 * math.pi * 2.0, damping, 1.0 / rate_hz, G)
    # v' = decay v + h g tilt, tilt' = tilt - h gain v'
    h = 1.0 / rate_hz
    step = np.array([[decay, h * G], [-h * gain * decay, 1.0 - h * h * gain * G]])
    assert np.abs(np.linalg.eigvals(step)).max() < 1.0


def test_angles_of_an_attitude() -> None:
    attitude = np.empty((3, 3))
    # Level forward-right-down axes, x to the east: up is -z, north is -y.
    level_attitude(np.array([0.0, 0.0, -1.0]), np.array([0.0, -2.0, 0.3]), attitude)
    assert azimuth(attitude) == pytest.approx(math.pi / 2.0)


@pytest.mark.parametrize("x", [1e-6, 1e-3, 0.019, 0.021, 0.5, 30.0])
def test_the_terms_of_a_decay_do_not_cancel(x: float) -> None:
    first, second = decay_terms(x)
    terms = [(-x) ** n / math.factorial(n) for n in range(2, 60)] if x < 1.0 else []
    expected = math.fsum(terms) if terms else math.exp(-x) - 1.0 + x
    assert first == pytest.approx(expected, rel=1e-5)
    assert second == pytest.approx(x * (math.exp(-x) - 1.0) + 2.0 * expected, rel=1e-3, abs=1e-15)
