"""Levenberg-Marquardt: its derivatives, and its minimum against that of another implementation."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from imumon.blocks import FloatArray
from imumon.models.curves.points import Points
from imumon.models.curves.training import (
    DECAY,
    Scaled,
    Scaling,
    fit_network,
    mean_square,
    neurons_of,
    response,
    starts,
    train,
    weights_of,
)

RANDOM = 5


def data(seed: int = 0, n: int = 120, noise: float = 0.02) -> Scaled:
    random = np.random.default_rng(seed)
    u = np.sort(random.uniform(-1.0, 1.0, n))
    y = np.tanh(3 * u) - 0.5 * u**2 + noise * random.standard_normal(n)
    return Scaled(u, y, np.linspace(0.5, 1.5, n))


def test_neurons_and_weights_belong_together() -> None:
    assert [weights_of(n) for n in (1, 2, 3)] == [6, 13, 22]
    assert [neurons_of(weights_of(n)) for n in range(1, 9)] == list(range(1, 9))


@pytest.mark.parametrize("neurons", [1, 2, 4])
def test_the_jacobian_is_the_derivative(neurons: int) -> None:
    weights = starts(neurons, 3, np.random.default_rng(RANDOM))
    u = np.linspace(-1.0, 1.0, 7)
    _, jacobian = response(weights, u)
    for j in range(weights.shape[1]):
        step = np.zeros_like(weights)
        step[:, j] = 1e-6
        numeric = (response(weights + step, u)[0] - response(weights - step, u)[0]) / 2e-6
        np.testing.assert_allclose(jacobian[:, :, j], numeric, atol=1e-8)


def test_the_minimum_is_one_that_scipy_cannot_improve() -> None:
    given = data()
    begun = starts(2, 6, np.random.default_rng(RANDOM))

    def residual(weights: FloatArray) -> FloatArray:
        error = np.sqrt(given.w / len(given.u)) * (response(weights[np.newaxis], given.u)[0][0] - given.y)
        return np.concatenate([error, np.sqrt(DECAY) * weights])

    def derivative(weights: FloatArray) -> FloatArray:
        by_weights = (
            response(weights[np.newaxis], given.u)[1][0] * np.sqrt(given.w / len(given.u))[:, np.newaxis]
        )
        return np.concatenate([by_weights, np.sqrt(DECAY) * np.eye(len(weights))])

    ours = train(begun, given, iterations=400)
    costs = mean_square(ours, given) + DECAY * np.sum(ours**2, axis=1)
    theirs = [least_squares(residual, start, derivative, method="lm").cost * 2 for start in begun]
    assert costs.min() == pytest.approx(min(theirs), rel=1e-3)
    best = ours[np.argmin(costs)]
    assert least_squares(residual, best, derivative, method="lm").cost * 2 == pytest.approx(
        costs.min(), rel=1e-5
    )


def test_restarts_end_differently_and_training_never_makes_worse() -> None:
    given, begun = data(), starts(2, 12, np.random.default_rng(RANDOM))
    after = mean_square(train(begun, given), given)
    assert (after < mean_square(begun, given)).all()
    assert after.max() > 1.05 * after.min()


def test_the_early_stop_keeps_the_least_validation_error() -> None:
    given, other = data(0, 24, 0.4), data(1, 40, 0.4)
    begun = starts(4, 8, np.random.default_rng(RANDOM))
    stopped = train(begun, given, other, decay=0.0, iterations=150)
    to_the_end = train(begun, given, decay=0.0, iterations=150)
    assert mean_square(stopped, other).mean() < 0.8 * mean_square(to_the_end, other).mean()


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
    scaling = Scaling(10.0, 30.0, 1e-3, 2e-4)
    t = np.linspace(-20.0, 40.0, 50)
    output = response(weights[np.newaxis], (t - 10.0) / 30.0)[0][0]
    np.testing.assert_allclose(scaling.curve(weights).value(t), 1e-3 + 2e-4 * output, rtol=1e-12)
