"""The paper's filter against batch least squares of each buffer, and against itself in pieces."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.papers.fir import FirRate, Params, fit
from tests.estimation.temperature_rate.records import PER_HOUR, clock, quantized, self_heating, steady


def batch(
    buffer: FloatArray, origin: float, time_constant: float, order: int
) -> tuple[FloatArray, FloatArray]:
    """Return coefficients and unit-weight covariance of the fit to a buffer."""
    u = (buffer[:, 1] - origin) / time_constant
    h = np.column_stack([np.ones_like(u), u, np.exp(-u)])[:, :order]
    q, r = np.linalg.qr(h)
    inverse = np.linalg.inv(r)
    return inverse @ (q.T @ buffer[:, 0]), inverse @ inverse.T


class BatchFir:
    """Events and expiry as in the paper, and a batch fit to the buffer at every sample."""

    def __init__(self, order: int, step: float, window: float, time_constant: float, size: int) -> None:
        self.order, self.step, self.window, self.time_constant = order, step, window, time_constant
        self.size = size
        self.buffer: list[tuple[float, float]] = []
        self.last = self.estimate = np.nan

    def sample(self, t: float, reading: float) -> tuple[float, float, float, float]:
        if not self.buffer:
            self.buffer = [(reading, t - 60.0 * k) for k in range(2 * self.order, 0, -1)]
            self.last = self.estimate = reading
        if abs(reading - self.last) > self.step / 2 or abs(self.estimate - self.last) > self.step:
            self.buffer.append(((reading + self.last) / 2, t))
        while len(self.buffer) == self.size or (
            t - self.buffer[0][1] > self.window
            and self.buffer[-1][1] - self.buffer[1][1] >= self.window
            and len(self.buffer) > 2 * self.order
        ):
            self.buffer.pop(0)
        self.last = reading
        data = np.array(self.buffer)
        x, p = batch(data, data[0, 1], self.time_constant, self.order)
        p = p * (self.step / 4) ** 2
        u = (t - data[0, 1]) / self.time_constant
        h = np.array([1.0, u, np.exp(-u)])[: self.order]
        dh = np.array([0.0, 1.0, -np.exp(-u)])[: self.order] / self.time_constant
        self.estimate = float(h @ x)
        return self.estimate, float(dh @ x), float(np.sqrt(h @ p @ h)), float(np.sqrt(dh @ p @ dh))


@pytest.mark.parametrize(("noise", "hours"), [(0.0, 3.0), (0.005, 0.8)])
def test_state_is_the_batch_fit_of_every_buffer_over_hours(noise: float, hours: float) -> None:
    temperature, _ = self_heating(hours)
    reading = quantized(temperature, noise)
    time_ns, segment = clock(len(reading))
    fir = FirRate(Params())
    seen, worst, worst_root, at = 0.0, 0.0, 0.0, 0
    events = np.flatnonzero(np.diff(reading)) + 2
    for stop in events:
        fir.process(time_ns[at:stop], segment[at:stop], reading[at:stop])
        at = int(stop)
        assert fir.state is not None
        x, p = batch(np.array(fir.state.buffer), float(fir.state.buffer[0, 1]), 180.0, 3)
        worst = max(worst, float(np.linalg.norm(fir.state.x - x) / np.linalg.norm(x)))
        root = fir.state.s
        p = p * 0.0125**2
        worst_root = max(worst_root, float(np.linalg.norm(root @ root.T - p) / np.linalg.norm(p)))
        seen += 1
    assert seen > 300
    assert worst < 1e-6
    assert worst_root < 1e-5


@pytest.mark.parametrize("noise", [0.0, 0.005])
def test_outputs_are_those_of_a_batch_fit_at_every_sample(noise: float) -> None:
    temperature, _ = self_heating(1.2, rate_hz=1.0)
    reading = quantized(temperature, noise)
    time_ns, segment = clock(len(reading), 1.0)
    size = 30
    result = FirRate(Params(0.05, 300.0, 180.0, size)).process(time_ns, segment, reading)
    plain = BatchFir(3, 0.05, 300.0, 180.0, size)
    expected = np.array([plain.sample(t * 1e-9, y) for t, y in zip(time_ns, reading, strict=True)])
    for values, column in zip(
        (result.temperature, result.rate, result.temperature_sd, result.rate_sd), expected.T, strict=True
    ):
        np.testing.assert_allclose(values, column, rtol=1e-5, atol=1e-7)


def test_the_start_is_at_rest() -> None:
    time_ns, segment = clock(10)
    result = FirRate(Params()).process(time_ns, segment, np.full(10, 25.0))
    np.testing.assert_allclose(result.temperature, 25.0, atol=1e-6)
    np.testing.assert_allclose(result.rate, 0.0, atol=1e-8)


def test_a_new_segment_starts_anew() -> None:
    reading = quantized(steady(20.0, 0.5), 0.0)
    time_ns, segment = clock(len(reading))
    fresh = FirRate(Params()).process(time_ns[9000:], segment[9000:], reading[9000:])
    segment[9000:] = 7
    result = FirRate(Params()).process(time_ns, segment, reading)
    np.testing.assert_array_equal(result.rate[9000:], fresh.rate)


def test_readings_that_are_missing_are_passed_over() -> None:
    reading = quantized(steady(20.0, 1.0), 0.0)
    time_ns, segment = clock(len(reading))
    reading[:5] = np.nan
    reading[20000:20500] = np.nan
    result = FirRate(Params()).process(time_ns, segment, reading)
    assert np.isnan(result.rate[:5]).all()
    assert np.isfinite(result.rate[5:]).all()
    assert abs(result.rate[-1] * PER_HOUR - 20.0) < 0.1


def test_a_full_buffer_gives_up_its_oldest() -> None:
    reading = np.where(np.arange(3000) % 2, 25.0, 25.05)
    time_ns, segment = clock(len(reading))
    fir = FirRate(Params(buffer_size=50))
    assert np.isfinite(fir.process(time_ns, segment, reading).rate).all()
    assert fir.state is not None
    times = np.array(fir.state.buffer)[:, 1]
    assert len(times) == 49
    np.testing.assert_allclose(np.diff(times), 0.1)


def test_the_factor_of_the_covariance_is_triangular_with_a_positive_diagonal() -> None:
    rng = np.random.default_rng(3)
    buffer = np.column_stack([rng.normal(25.0, 0.1, 20), np.sort(rng.uniform(0.0, 300.0, 20))])
    x, s = fit(buffer, Params())
    expected, covariance = batch(buffer, float(buffer[0, 1]), 180.0, 3)
    np.testing.assert_allclose(x, expected, rtol=1e-6)
    np.testing.assert_allclose(s @ s.T, covariance * Params().sigma ** 2, rtol=1e-6)
    assert (np.diag(s) > 0).all()
    assert np.array_equal(s, np.triu(s))
