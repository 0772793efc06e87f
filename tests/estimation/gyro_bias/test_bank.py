"""The bank of filters against the textbook filter, against closed forms, and against the textbook mixing."""

from __future__ import annotations

import copy
import math

import numpy as np
import pytest
from dense_record import dense_filter

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import bank as filters
from imumon.estimation.gyro_bias.bank import AtRest, Bank
from imumon.estimation.gyro_bias.intake import SLOT_S
from imumon.estimation.gyro_bias.steps import ROTATION, STATES, TAUS_S, VELOCITY, WALK
from imumon.filters.noise import BiasNoise
from imumon.published.dense_zupt import DenseSettings
from tests.estimation.gyro_bias.records import ARW, DPH, VRW, Truth, local_earth, record

ZERO, ONE = np.zeros(3), np.ones(3)


def still(rate: FloatArray, dt: float = 0.5, force: FloatArray = ZERO) -> AtRest:
    """Return a slot whose heading stands still, whatever gravity shows."""
    return AtRest(dt, rate, ZERO, force, ARW**2 * ONE, 1e-20 * ONE, ZERO)


def take(bank: Bank, slot: AtRest) -> None:
    filters.integrate(bank, slot)
    filters.take(bank, slot)


def bias(bank: Bank) -> tuple[FloatArray, FloatArray]:
    """Return bias and variance, (variants, 3) each, in the pose of the first rest."""
    mean, covariance = filters.law(bank, bank.family, ARW * ONE, 0.0)
    return mean[..., 0], covariance[..., 0, 0]


def test_with_white_noise_alone_it_is_the_mean_with_its_sigma() -> None:
    rng = np.random.default_rng(0)
    family = filters.known_family(ZERO, ZERO)
    bank = filters.start(family, 1, ARW * ONE)
    filters.come_to_rest(bank, ZERO)
    rates = rng.normal(size=(60, 3)) * ARW / math.sqrt(0.5)
    for rate in rates:
        filters.wander(bank, ARW * ONE, 0.5, ZERO, ZERO, ZERO)
        take(bank, still(rate))
    value, variance = bias(bank)
    np.testing.assert_allclose(value[0], rates.mean(0), atol=0.01 * ARW / math.sqrt(30.0))
    np.testing.assert_allclose(np.sqrt(variance), ARW / math.sqrt(30.0), rtol=1e-3)


def test_what_is_said_ahead_is_what_the_filter_would_have_predicted() -> None:
    bank = random_bank(np.random.default_rng(3), filters.unknown_family())
    ahead = filters.law(bank, bank.family, ARW * ONE, 1.0)
    filters.wander(bank, ARW * ONE, 1.0, ZERO, ZERO, ZERO)
    for said, predicted in zip(ahead, filters.law(bank, bank.family, ARW * ONE, 0.0), strict=True):
        np.testing.assert_allclose(said, predicted, rtol=1e-9)


def test_level_the_three_axes_apart_are_the_dense_filter() -> None:
    dt, walk = 0.01, 0.5 * DPH
    settings = DenseSettings(dt, bias_random_walk=walk)
    block, _ = record(Truth(), 30.0, 5, earth=local_earth())
    gyro, accel = block.gyro, block.accel
    assert gyro is not None
    assert accel is not None
    dense = dense_filter(settings, gyro, accel, np.zeros(3), up=np.array([0.0, 0.0, -1.0]))
    family = filters.known_family(ZERO, walk * ONE)
    bank = filters.start(family, 1, ARW * ONE)
    gravity = float(np.linalg.norm(accel[:100].mean(0)))
    # The accelerometer's bias is the same as a tilt, and its random walk as one of the rotation.
    p = np.zeros((1, 3, 1, STATES, STATES))
    tilt_sd = np.array([math.hypot(1e-3, 1e-4), math.hypot(1e-3, 1e-4), 1e-4])
    p[0, :, 0, ROTATION, ROTATION] = tilt_sd**2
    p[0, :2, 0, VELOCITY, VELOCITY] = (1e-3 / gravity) ** 2
    p[..., WALK, WALK] = settings.bias_sd**2
    bank.mean, bank.covariance = np.zeros(p.shape[:-1]), p
    level = np.array([1.0, 1.0, 0.0])
    still2 = level * (1e-3 / gravity) ** 2
    tilt2 = np.array([(VRW / gravity) ** 2, (VRW / gravity) ** 2, 1e-4**2 * dt])
    up = np.array([0.0, 0.0, -1.0])
    tilt, rate = np.cross(accel / gravity - up, up), gyro - local_earth()
    found, variance = np.empty((len(gyro), 3)), np.empty((len(gyro), 3))
    for k in range(len(gyro)):
        filters.wander(bank, ARW * ONE, dt, ZERO, ZERO, ZERO)
        slot = AtRest(dt, rate[k], tilt[k], ZERO, ARW**2 + level * 1e-12, tilt2, still2)
        take(bank, slot)
        (found[k],), (variance[k],) = bias(bank)
    off = np.abs(found - dense.bias).max(0) / DPH
    assert off[:2].max() < 0.002
    # Here the heading is held over a sample, there at its end.
    assert off[2] < 0.02
    np.testing.assert_allclose(np.sqrt(variance), dense.bias_sd, rtol=1e-3)


def test_second_differences_of_slots_show_so_much_of_what_wanders() -> None:
    """Against the covariance of fine samples, averaged."""
    slots, fine = 3, 50
    time_s = (np.arange(slots * fine) + 0.5) * SLOT_S / fine
    differ = np.repeat([1.0, -2.0, 1.0], fine) / fine
    strengths = np.eye(4)
    for k, shown in enumerate(filters.in_differences()):
        noise = BiasNoise(TAUS_S, strengths[k, 1:], strengths[k, 0])
        white = 6.0 / SLOT_S
        assert differ @ noise.covariance(time_s) @ differ / white == pytest.approx(shown, rel=0.01)


def test_a_filter_takes_its_own_share_of_second_differences_for_white() -> None:
    measured, known = filters.unknown_family(), filters.unknown_family(white_known=True)
    flicker = len(filters.FLICKER_CORNERS_S)
    assert (np.diff(measured.white2[:flicker]) < 0.0).all()
    np.testing.assert_array_equal(known.white2, 1.0)
    whole = measured.white2 + measured.strength2[0] @ filters.in_differences()
    np.testing.assert_allclose(whole, 1.0)


def random_bank(rng: np.random.Generator, family: filters.Family) -> Bank:
    """Return a bank with any states, covariances and weights."""
    shape = (1, 3, family.filters)
    root = rng.normal(size=(*shape, STATES, STATES))
    weight = rng.random(shape)
    mean, covariance = rng.normal(size=(*shape, STATES)), root @ np.swapaxes(root, -1, -2)
    weight /= weight.sum(-1, keepdims=True)
    return Bank(family, mean, covariance, weight, weight.copy(), weight.copy())


def test_mixing_is_that_of_the_interacting_multiple_model_within_each_group() -> None:
    family = filters.unknown_family(np.array([1e-6, 1e-4]))
    bank = random_bank(np.random.default_rng(1), family)
    before = copy.deepcopy(bank)
    filters.mix(bank, 600.0)
    n, stay = len(family.prior), math.exp(-600.0 / filters.DWELL_S)
    switch = np.kron(np.eye(2), stay * np.eye(n) + (1.0 - stay) * family.prior)
    weight, x, p = before.weight[0, 1], before.mean, before.covariance
    after = weight @ switch
    np.testing.assert_allclose(bank.weight[0, 1], after, rtol=1e-12)
    for j in (0, 9):
        share = weight * switch[:, j] / after[j]
        mean = share @ x[0, 1]
        off = x[0, 1] - mean
        cover = np.einsum("h,hij->ij", share, p[0, 1] + off[:, :, np.newaxis] * off[:, np.newaxis, :])
        np.testing.assert_allclose(bank.mean[0, 1, j], mean, rtol=1e-9)
        np.testing.assert_allclose(bank.covariance[0, 1, j], cover, rtol=1e-9)


@pytest.mark.parametrize("truth", [0.0, 0.02])
def test_a_sensitivity_to_the_specific_force_is_learned_from_poses(truth: float) -> None:
    rng = np.random.default_rng(2)
    per_g = math.radians(truth) / 9.81
    family = filters.unknown_family(np.radians([0.002, 0.05]) / 9.81)
    bank = filters.start(family, 1, ARW * ONE)
    forces = 9.81 * np.array([[0, 0, -1], [1, 0, 0], [0, -1, 0], [0, 0, 1], [0.6, 0.8, 0]])
    for force in forces:
        filters.come_to_rest(bank, ZERO)
        for _ in range(60):
            rate = per_g * (force @ [[0, 1, 0], [0, 0, 1], [1, 0, 0]]) + rng.normal(size=3) * ARW * 1.4
            filters.wander(bank, ARW * ONE, 0.5, ZERO, ZERO, ZERO)
            take(bank, still(rate, force=force - forces[0]))
    found = filters.law(bank, family, ARW * ONE, 0.0)[0][0, :, 2:]
    expected = per_g * np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_allclose(found, expected, atol=5.0 * DPH / 9.81)
