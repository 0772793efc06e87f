"""The bank of filters against the same written out with matrices, and against the textbook filter."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.estimation.zupt import bank as fast
from imumon.published.dense_zupt import DenseSettings, dense_filter
from tests.estimation.zupt.plain_bank import PlainBank
from tests.estimation.zupt.records import ARW, DPH, VRW, Truth, local_earth, record


def test_the_bank_is_the_textbook_bank() -> None:
    rng = np.random.default_rng(0)
    family = fast.unknown_family()
    bank, plain = fast.empty_bank(6, len(family.prior)), PlainBank(family, ARW)
    fast.start(bank, family, np.full(3, ARW))
    fast.come_to_rest(bank, np.ones(3))
    temperature = np.cumsum(rng.normal(size=400)) * 0.02
    for k, (rate, tilt) in enumerate(rng.normal(size=(400, 2)) * [ARW * 1.4, 1e-4]):
        warming, growth = float(np.diff(temperature, prepend=0.0)[k]), 1e-14
        travel = 0.5 if k % 50 == 0 else 0.0
        rate += 30 * DPH * temperature[k]
        fast.wander(bank, 3, family, 0.5, ARW, warming, travel, growth)
        plain.wander(0.5, warming, travel, growth)
        if k % 10 == 9:
            fast.mix(bank, 3, family, 5.0)
            plain.mix(5.0)
        fast.rotate(bank, 3, 0.5, rate, tilt, ARW**2, 1e-8, 1e-12)
        assert fast.correct(bank, 3) == pytest.approx(plain.take(0.5, rate, tilt, 1e-8, 1e-12), rel=1e-9)
        np.testing.assert_allclose(bank.weight[3], plain.weight, rtol=1e-6)
        mean, variance = fast.bias(bank, 3)
        assert mean == pytest.approx(plain.bias()[0], rel=1e-6, abs=1e-5 * DPH)
        assert variance == pytest.approx(plain.bias()[1], rel=1e-6)
    assert fast.slope(bank, 3)[0] == pytest.approx(plain.slope(), rel=1e-6)
    assert fast.slope(bank, 3)[0] == pytest.approx(30 * DPH, rel=0.5)


@pytest.mark.parametrize("k_dph", [0.1, 0.5])
def test_level_the_three_axes_apart_are_the_dense_filter(k_dph: float) -> None:
    dt, settings = 0.01, DenseSettings(0.01, bias_random_walk=k_dph * DPH)
    block, _ = record(Truth(), 60.0, 5, earth=local_earth())
    gyro, accel = block.gyro, block.accel
    assert gyro is not None
    assert accel is not None
    dense = dense_filter(settings, gyro, accel, np.zeros(3), up=np.array([0.0, 0.0, -1.0]))
    family = fast.known_family(np.zeros(3), np.full(3, k_dph * DPH))
    bank = fast.empty_bank(3, 1)
    fast.start(bank, family, np.full(3, ARW))
    gravity = float(np.linalg.norm(accel[:100].mean(0)))
    # The accelerometer's bias is the same as a tilt, and its random walk as one of the rotation.
    for axis, tilt_sd in enumerate((math.hypot(1e-3, 1e-4), math.hypot(1e-3, 1e-4), 1e-4)):
        start = np.array([tilt_sd, 1e-3 / gravity if axis < 2 else 0.0, settings.bias_sd])
        bank.p[axis, 0] = 0.0
        bank.p[axis, 0, range(3), range(3)] = start**2
    sway2 = [(1e-3 / gravity) ** 2, (1e-3 / gravity) ** 2, 0.0]
    tilt2 = [(VRW / gravity) ** 2, (VRW / gravity) ** 2, 1e-4**2 * dt]
    noise2 = [ARW**2 + 1e-12, ARW**2 + 1e-12, ARW**2]
    up = np.array([0.0, 0.0, -1.0])
    tilt = np.cross(accel / gravity - up, up)
    rate = gyro - local_earth()
    bias, sd = np.empty((len(gyro), 3)), np.empty((len(gyro), 3))
    for k in range(len(gyro)):
        for axis in range(3):
            fast.wander(bank, axis, family, dt, ARW, 0.0, 0.0, 0.0)
            given = float(rate[k, axis]), float(tilt[k, axis])
            fast.rotate(bank, axis, dt, *given, noise2[axis], tilt2[axis], sway2[axis])
            fast.correct(bank, axis)
            bias[k, axis], sd[k, axis] = fast.bias(bank, axis)
    off = np.abs(bias - dense.bias).max(0) / DPH
    assert off[:2].max() < 0.002
    # Here the heading is held over a sample, there at its end.
    assert off[2] < 0.02
    np.testing.assert_allclose(np.sqrt(sd), dense.bias_sd, rtol=1e-3)
