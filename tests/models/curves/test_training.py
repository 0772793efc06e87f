"""Training of the network: its derivatives, and that it ends at a minimum."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.models.curves.network import (
    Scaled,
    fit_network,
    mean_square,
    response,
    sensitivity,
    starts,
    train,
    weights_of,
)
from imumon.models.curves.points import Points

RANDOM = 5


def data(seed: int = 0, n: int = 120, noise: float = 0.02) -> Scaled:
    random = np.random.default_rng(seed)
    u = np.sort(random.uniform(-1.0, 1.0, n))
    y = np.tanh(3 * u) - 0.5 * u**2 + noise * random.standard_normal(n)
    return Scaled(u, y, np.linspace(0.5, 1.5, n))


def test_the_number_of_weights_is_that_of_the_neurons() -> None:
    assert [weights_of(n) for n in (1, 2, 3)] == [6, 13, 22]


@pytest.mark.parametrize("neurons", [1, 2, 4])
def test_the_jacobian_is_the_derivative(neurons: int) -> None:
    weights = starts(neurons, 1, np.random.default_rng(RANDOM))[0]
    u = np.linspace(-1.0, 1.0, 7)
    jacobian = sensitivity(weights, u)
    for j in range(len(weights)):
        step = 1e-6 * (np.arange(len(weights)) == j)
        numeric = (response(weights + step, u) - response(weights - step, u)) / 2e-6
        np.testing.assert_allclose(jacobian[:, j], numeric, atol=1e-8)


def test_at_the_minimum_the_gradient_of_the_penalised_error_is_zero() -> None:
    given = data()
    for start in starts(2, 6, np.random.default_rng(RANDOM)):
        weights = train(start, given, decay=1e-3, evaluations=2000)
        output, jacobian = response(weights, given.u), sensitivity(weights, given.u)
        gradient = jacobian.T @ (given.w * (output - given.y)) / len(given.u) + 1e-3 * weights
        assert np.abs(gradient).max() < 1e-6


def test_restarts_end_differently_and_training_never_makes_worse() -> None:
    given, begun = data(), starts(2, 12, np.random.default_rng(RANDOM))
    before = np.array([mean_square(start, given) for start in begun])
    after = np.array([mean_square(train(start, given), given) for start in begun])
    assert (after < before).all()
    assert after.max() > 1.05 * after.min()


def test_the_steps_on_the_way_have_less_and_less_error() -> None:
    given, way = data(0, 24, 0.4), list[float]()
    start = starts(4, 1, np.random.default_rng(RANDOM))[0]
    train(start, given, decay=0.0, evaluations=200, accepted=lambda now: way.append(mean_square(now, given)))
    assert len(way) > 3
    assert way == sorted(way, reverse=True)


def test_a_network_finds_a_smooth_curve_in_physical_units() -> None:
    t = np.repeat(np.linspace(-20.0, 48.0, 15), 10)
    true = 1e-3 + 2e-3 * np.tanh((t - 10.0) / 20.0)
    points = Points(t, true, np.ones(len(t)), np.repeat(np.arange(15), 10))
    curve = fit_network(points, 2)
    x = np.linspace(-20.0, 48.0, 200)
    assert np.abs(curve.value(x) - 1e-3 - 2e-3 * np.tanh((x - 10.0) / 20.0)).max() < 4e-5
    np.testing.assert_allclose(curve.minus(1e-3).value(x), curve.value(x) - 1e-3)
    assert fit_network(points, 2) == curve


def test_scaling_there_and_back() -> None:
    weights = starts(3, 1, np.random.default_rng(RANDOM))[0]
    scaled = Scaled(np.zeros(0), np.zeros(0), np.zeros(0), 10.0, 30.0, 1e-3, 2e-4)
    t = np.linspace(-20.0, 40.0, 50)
    output = response(weights, (t - 10.0) / 30.0)
    np.testing.assert_allclose(scaled.curve(weights).value(t), 1e-3 + 2e-4 * output, rtol=1e-12)
