"""Turns over slots against rotations that are known in closed form."""

from __future__ import annotations

import math
from functools import reduce

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, IntArray
from imumon.filters.slots import SlotGatherer
from imumon.filters.turns import Turn

SLOT_NS = 250_000_000
FINE = 64
"""Steps to a sample in which the true rate is constant."""


def turned(rate: FloatArray, hz: float, kept: slice | IntArray = slice(None)) -> Turn:
    """Return how samples of the rates, rad/s, (n, 3), have turned the unit since the first."""
    time_ns = np.round(np.arange(len(rate)) * 1e9 / hz).astype(np.int64)[kept]
    gatherer = SlotGatherer(3, SLOT_NS, turns=True)
    slots = gatherer.process(time_ns, np.zeros(len(time_ns), np.int64), rate[kept])
    return reduce(Turn.then, [*slots.turns, *gatherer.finish().turns])


def off(turn: Turn, truth: Rotation) -> FloatArray:
    """Return the error of a turn, rad, (3,), in the axes of its beginning."""
    return np.asarray((Rotation.from_matrix(turn.rotation) * truth.inv()).as_rotvec())


def cone(degrees: float, frequency: float, at_s: FloatArray) -> Rotation:
    """Return the attitudes of an axis that goes round a cone."""
    angle, phase = math.radians(degrees), 2.0 * np.pi * frequency * at_s
    return Rotation.from_rotvec(angle * np.column_stack([np.sin(phase), np.cos(phase), 0.0 * phase]))


def on_a_cone(
    degrees: float, frequency: float, hz: float, seconds: float, kind: str
) -> tuple[FloatArray, Rotation]:
    """Return samples as a device of a kind would send them, (n, 3), and the turn since the first."""
    n = round(seconds * hz)
    fine = cone(degrees, frequency, np.arange(n * FINE + 1) / (FINE * hz))
    coarse = fine[::FINE]
    if kind == "turn since the sample before":
        rate = (coarse[:-1].inv() * coarse[1:]).as_rotvec() * hz
    else:
        every = (fine[:-1].inv() * fine[1:]).as_rotvec().reshape(n, FINE, 3) * FINE * hz
        rate = every.mean(1) if kind == "mean rate" else every[:, -1]
    return rate, coarse[1].inv() * coarse[-1]


@pytest.mark.parametrize("kind", ["turn since the sample before", "mean rate", "rate at a moment"])
@pytest.mark.parametrize(
    ("hz", "frequency"), [(20.0, 1.5), (20.0, 3.0), (50.0, 1.5), (200.0, 2.5), (1000.0, 10.0)]
)
def test_coning_is_followed_and_what_is_lost_between_samples_is_in_the_variance(
    kind: str, hz: float, frequency: float
) -> None:
    rate, truth = on_a_cone(5.0, frequency, hz, 10.0, kind)
    turn = turned(rate, hz)
    sd = np.sqrt([turn.sampling_variance(axis) for axis in np.eye(3)])
    # A rate at a moment is known half an interval beside it: the axes of the end differ by that.
    edge = np.linalg.norm(rate[0]) / hz if kind == "rate at a moment" else 1e-6
    assert (np.abs(off(turn, truth)) < 2.0 * sd + edge).all()
    cone_rad = 2.0 * np.pi * frequency * 10.0 * (1.0 - math.cos(math.radians(5.0)))
    assert sd[2] < 1.5 * (2.0 * np.pi * frequency / hz) ** 2 * cone_rad


def test_the_means_of_the_slots_would_lose_the_cone() -> None:
    rate, truth = on_a_cone(5.0, 1.5, 50.0, 10.0, "turn since the sample before")
    by_means = Rotation.identity()
    for slot in np.array_split(rate[1:], 40):
        by_means = by_means * Rotation.from_rotvec(slot.sum(0) / 50.0)
    lost = np.linalg.norm((by_means.inv() * truth).as_rotvec())
    assert lost > 20.0 * np.linalg.norm(off(turned(rate, 50.0), truth))


def test_motion_too_fast_for_the_samples_makes_the_sigma_wide() -> None:
    rate, truth = on_a_cone(3.0, 8.0, 20.0, 10.0, "mean rate")
    turn = turned(rate, 20.0)
    error = np.abs(off(turn, truth))
    sd = np.sqrt([turn.sampling_variance(axis) for axis in np.eye(3)])
    assert error.max() > math.radians(2.0)
    assert (error < 3.0 * sd).all()


def shaken(hz: float, seconds: float) -> FloatArray:
    """Return rates of a unit that is waved, rad/s, (n, 3)."""
    t = np.arange(round(seconds * hz)) / hz
    return np.column_stack([3.0 * np.cos(9.0 * t), 2.5 * np.sin(7.0 * t + 0.4), 0.5 + np.sin(1.3 * t)])


def test_a_bias_and_a_scale_error_turn_the_unit_as_is_reported() -> None:
    rate, bias = shaken(400.0, 5.0), np.array([2e-3, -1e-3, 3e-3])
    matrix = 1e-3 * np.random.default_rng(1).normal(size=(3, 3))
    true = turned(rate, 400.0)
    turn = turned(rate + rate @ matrix.T + bias, 400.0)
    less = turn.less(bias)
    predicted = np.einsum("aij,ij->a", true.by_scale, matrix)
    both = predicted + true.by_bias @ bias
    truth = Rotation.from_matrix(true.rotation)
    np.testing.assert_allclose(off(turn, truth), both, atol=0.03 * float(np.abs(both).max()))
    np.testing.assert_allclose(off(less, truth), predicted, atol=0.05 * float(np.abs(predicted).max()))
    assert turn.seconds == pytest.approx(5.0 - 1.0 / 400.0)


def test_what_turns_back_takes_its_scale_error_back() -> None:
    half = np.pi * np.sin(np.linspace(0.0, np.pi, 200))[:, np.newaxis] * [0.0, 0.0, 1.0]
    there, and_back = turned(half, 50.0), turned(np.vstack([half, -half]), 50.0)
    up = np.array([0.0, 0.0, 1.0])
    assert there.scale_about(up)[2, 2] == pytest.approx(np.sum(half[:, 2]) / 50.0)
    assert np.abs(and_back.scale_about(up)).max() < 1e-9


def test_missing_samples_and_a_pause_are_in_the_variance() -> None:
    rate = shaken(100.0, 5.0)
    truth = Rotation.from_matrix(turned(rate, 100.0).rotation)
    rng = np.random.default_rng(2)
    some = np.flatnonzero(rng.random(len(rate)) < 0.8)
    paused = np.r_[np.arange(200), np.arange(260, len(rate))]
    for kept in (some, paused):
        turn = turned(rate, 100.0, kept)
        sd = math.sqrt(turn.missed)
        assert 0.1 * sd < np.linalg.norm(off(turn, truth)) < 3.0 * sd
    # Over the pause nothing is claimed.
    assert turned(rate, 100.0, paused).seconds == pytest.approx(5.0 - 0.01 - 0.61)


@pytest.mark.parametrize(("peak_dps", "range_dps"), [(500.0, 250.0), (800.0, 250.0), (3000.0, 2000.0)])
def test_samples_beyond_the_range_of_a_gyro_are_in_the_variance(peak_dps: float, range_dps: float) -> None:
    """The rates before and after them are equal."""
    flick = np.radians(peak_dps) * np.sin(np.linspace(0.0, np.pi, 31)) ** 2
    rate = np.zeros((100, 3))
    rate[30:61, 2] = flick
    kept = np.flatnonzero(rate[:, 2] < math.radians(range_dps))
    turn = turned(rate, 100.0, kept)
    error = np.linalg.norm(off(turn, Rotation.from_matrix(turned(rate, 100.0).rotation)))
    assert 0.1 < error < 2.0 * math.sqrt(turn.missed)


@pytest.mark.parametrize("lost", [20, 100, 240])
def test_samples_that_are_lost_at_rest_cost_what_the_noise_may_turn(lost: int) -> None:
    noise = np.radians(0.005) * math.sqrt(1000.0 / 2.0) * np.random.default_rng(4).normal(size=(2000, 3))
    turn = turned(noise, 1000.0, np.r_[np.arange(1000), np.arange(1000 + lost, 2000)])
    assert math.degrees(math.sqrt(turn.missed)) < 1.0 * lost / 1000.0


def test_a_unit_at_rest_pays_nothing() -> None:
    noise = math.radians(0.3) / 60.0 * np.random.default_rng(3).normal(size=(60_000, 3)) * math.sqrt(1000.0)
    turn = turned(noise, 1000.0)
    assert max(turn.sampling_variance(axis) for axis in np.eye(3)) < 1e-6**2
