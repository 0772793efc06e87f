"""The fixed-gain alignment against the closed forms of its paper, batch fits and a simulated unit."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.filters.turns import rotation_by
from imumon.geodesy import EARTH_RATE, MICRO_G, STANDARD_GRAVITY, body_to_ned, earth_rate_along
from imumon.papers import self_alignment
from imumon.papers.self_alignment import (
    CORNER,
    DAMPING,
    Loop,
    SelfAlignment,
    coarse,
    gains,
)

METHODS = ("fixed_gain_loop", "total_average", "curve_fit")
LATITUDE = math.radians(36.0)
EARTH = earth_rate_along(np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), LATITUDE)
LEVEL = EARTH_RATE * math.cos(LATITUDE)


def warming(seconds: float, rate_hz: float, tau: float = 300.0) -> FloatArray:
    """Return the means, (n, 3, 2), of a unit along east, north and up that warms up by 30 µg."""
    loop, h = Loop(np.eye(3), EARTH), 1.0 / rate_hz
    found = []
    for k in range(1, round(seconds * rate_hz) + 1):
        error = 30 * MICRO_G * (1.0 - math.exp(-k * h / tau))
        force = np.array([error, error, STANDARD_GRAVITY])
        loop.step(h, EARTH, force)
        found.append(loop.means)
    return np.array(found)


@pytest.mark.parametrize("rate_hz", [8.0, 100.0])
def test_the_warm_up_makes_the_published_heading_errors(rate_hz: float) -> None:
    """Equation 22: 1.53 and 1.39 mrad at 30 and 60 s for 30 µg, 300 s, 2 Hz, 36°."""
    control = warming(60.0, rate_hz)[:, 0, 0]
    for second, expected in ((30, 1.53), (60, 1.39)):
        assert 1e3 * abs(control[round(second * rate_hz) - 1]) / LEVEL == pytest.approx(expected, rel=0.01)


def test_total_average_and_curve_fit_keep_what_the_paper_states_they_keep() -> None:
    """Equation 28: the mean of A e^(-t/T)/(...) over the time, and for the line its least-squares slope."""
    rate_hz, tau = 8.0, 300.0
    means = warming(120.0, rate_hz, tau)
    control, average, slope = means[:, 0], means[-1, 1], means[-1, 2]
    t = np.arange(1, len(control) + 1) / rate_hz
    amplitude = 30e-6 / tau
    assert abs(average[0]) == pytest.approx(amplitude * np.mean(np.exp(-t / tau)), rel=0.01)
    angle = amplitude * tau * (1.0 - np.exp(-t / tau))
    assert abs(slope[0]) == pytest.approx(np.polyfit(t, angle, 1)[0], rel=0.01)
    assert slope == pytest.approx(np.polyfit(t, np.cumsum(control, axis=0) / rate_hz, 1)[0], rel=1e-7)


@pytest.mark.parametrize("rate_hz", [1.0, 10.0, 200.0, 2000.0])
def test_the_poles_of_the_sampled_loop_are_those_of_the_continuous_one(rate_hz: float) -> None:
    h, g = 1.0 / rate_hz, STANDARD_GRAVITY
    decay, kb = gains(h)
    # v' = decay v + h g tilt, tilt' = tilt - h k_b v'
    sampled = np.array([[decay, h * g], [-h * kb * decay, 1.0 - h * h * kb * g]])
    poles = np.roots([1.0, 2.0 * DAMPING * CORNER, CORNER**2])
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(sampled)), np.sort_complex(np.exp(poles * h)), atol=1e-6
    )


@pytest.mark.parametrize("a", [[0.0, 0.0, 0.0], [1e-9, 0.0, -2e-9], [0.3, -0.2, 0.9]])
def test_a_turn_is_that_of_scipy(a: list[float]) -> None:
    np.testing.assert_allclose(rotation_by(np.array(a)), Rotation.from_rotvec(a).as_matrix(), atol=1e-15)


def at_rest(heading: float, seconds: float, rate_hz: int, up: FloatArray, seed: int) -> SampleBlock:
    """Return samples of a unit at rest with the noise of a navigation grade."""
    rng = np.random.default_rng(seed)
    to_body = body_to_ned(up, heading).T
    earth = to_body @ (EARTH_RATE * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)]))
    n = round(seconds * rate_hz)
    gyro = earth + 1e-6 * rng.standard_normal((n, 3))
    accel = STANDARD_GRAVITY * up + 0.5 * MICRO_G * math.sqrt(rate_hz) * rng.standard_normal((n, 3))
    columns = {f"gyro_{a}": gyro[:, j] for j, a in enumerate("xyz")}
    columns |= {f"accel_{a}": accel[:, j] for j, a in enumerate("xyz")}
    times = {"device_time_ns": np.arange(n) * (1_000_000_000 // rate_hz), "segment": np.zeros(n, np.int64)}
    return SampleBlock({**times, **columns})


@pytest.mark.parametrize("heading_deg", [10.0, 200.0])
@pytest.mark.parametrize("up", [[0.0, 0.0, -1.0], [0.02, -0.05, 1.0], [1.0, 0.03, 0.0]])
def test_the_heading_of_a_unit_at_rest(heading_deg: float, up: list[float]) -> None:
    block = at_rest(math.radians(heading_deg), 120.0, 100, np.array(up) / np.linalg.norm(up), 1)
    added = SelfAlignment(LATITUDE, METHODS).process(block)
    assert np.isnan(added["total_average_heading"][:2999]).all()
    # The gyros leave 1e-6/√9000 rad/s, 0.01° (the line 1.1 times that); the accelerometers as much: √(2 Hz)
    # of 0.5 µg/√Hz over 90 s.  Three sigma of both.
    for name in ("total_average_heading", "curve_fit_heading"):
        assert np.degrees(added[name][-1]) == pytest.approx(heading_deg, abs=0.05)


def test_coarse_alignment_knows_up_and_north() -> None:
    up = np.array([0.1, -0.2, -0.97])
    up /= np.linalg.norm(up)
    to_ned = body_to_ned(up, 1.0)
    rate = to_ned.T @ (EARTH_RATE * np.array([math.cos(LATITUDE), 0.0, -math.sin(LATITUDE)]))
    enu = np.vstack([to_ned[1], to_ned[0], -to_ned[2]])
    np.testing.assert_allclose(coarse(rate, 9.8 * up), enu, atol=1e-12)


def test_motion_a_gap_and_a_restart_begin_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(self_alignment, "COARSE_S", 10.0)
    block = at_rest(1.0, 80.0, 50, np.array([0.0, 0.0, -1.0]), 2)
    rest = np.ones(len(block), np.int64)
    rest[1000:1010] = 0
    segment = np.zeros(len(block), np.int64)
    segment[2600:] = 1
    x = block["gyro_x"].copy()
    x[1900:2050] = np.nan
    block = block.with_columns({"at_rest": rest, "segment": segment, "gyro_x": x})
    whole = SelfAlignment(LATITUDE, METHODS).process(block)
    heading = whole["total_average_heading"]
    assert np.isfinite(heading[600:1000]).all()
    assert np.isnan(heading[1007:1500]).all()
    assert np.isfinite(heading[1600:1900]).all()
    assert np.isnan(heading[2600:3100]).all()
    assert np.isfinite(heading[3200:]).all()


def test_only_what_is_requested_has_columns() -> None:
    stage = SelfAlignment(LATITUDE, ["curve_fit"])
    assert [column.name for column in stage.columns] == ["curve_fit_heading"]
    assert list(stage.process(at_rest(1.0, 1.0, 50, np.array([0.0, 0.0, 1.0]), 0))) == ["curve_fit_heading"]
