from __future__ import annotations

from fractions import Fraction
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import join
from imumon.geodesy import STANDARD_GRAVITY
from imumon.simulation.bench import BenchUnit


@pytest.mark.parametrize("axes", ["FLU", "FRD"])
def test_blocks_of_any_size_are_the_same_samples(axes: Literal["FLU", "FRD"]) -> None:
    whole, parts = BenchUnit(100.0, axes, 3).samples(700), BenchUnit(100.0, axes, 3)
    pieces = join([parts.samples(n) for n in (1, 99, 300, 300)])
    for name, values in whole.columns.items():
        np.testing.assert_allclose(pieces[name], values, rtol=1e-13, atol=1e-13, err_msg=name)


@pytest.mark.parametrize("axes", ["FLU", "FRD"])
def test_rates_accelerations_and_attitude_belong_together(axes: Literal["FLU", "FRD"]) -> None:
    """Integrating the rates gives the attitude; the specific force points up; angles and quaternion agree."""
    block = BenchUnit(400.0, axes).samples(400 * 30)
    gyro, accel, quaternion = block.gyro, block.accel, block.quaternion
    assert gyro is not None and accel is not None and quaternion is not None  # noqa: PT018 - for the types
    attitude = Rotation.from_quat(quaternion[:, [1, 2, 3, 0]])
    bias = gyro[:1600].mean(axis=0)
    turned = attitude[0]
    for rate in (gyro - bias)[:-1]:
        turned = turned * Rotation.from_rotvec(rate / 400.0)
    drift = (turned.inv() * attitude[-1]).magnitude()
    assert np.degrees(drift) < 1.0
    up = attitude.apply(accel).mean(axis=0)
    np.testing.assert_allclose(
        up, [0, 0, STANDARD_GRAVITY if axes == "FLU" else -STANDARD_GRAVITY], atol=0.01
    )
    angles = Rotation.from_euler("ZYX", np.column_stack([block["yaw"], block["pitch"], block["roll"]]))
    assert np.max((angles.inv() * attitude).magnitude()) < 1e-6


def test_noise_and_warm_up_are_those_stated() -> None:
    from imumon.simulation import bench

    block = BenchUnit(100.0, "FRD").samples(350)
    density = np.std(block["gyro_y"]) / np.sqrt(50.0)
    assert np.degrees(density) == pytest.approx(bench.GYRO_ARW_DPS, rel=0.1)
    assert np.degrees(block["gyro_y"].mean()) == pytest.approx(bench.GYRO_BIAS_DPS[1], abs=0.03)
    late = BenchUnit(1.0, "FRD").samples(2000)
    rise = late["temperature_z"][-1] - late["temperature_z"][0]
    assert rise == pytest.approx(bench.WARM_UP_DEGC[2], rel=0.01)


def test_a_device_counts_in_its_own_ticks() -> None:
    assert BenchUnit(100.0, "FLU", tick_ns=Fraction(100_000)).samples(3)["device_ticks"].tolist() == [
        0,
        100,
        200,
    ]
