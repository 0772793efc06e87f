from __future__ import annotations

from itertools import accumulate

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.errors import ImumonError
from imumon.lab.calibration.magnetometer import AXIS_MAPS, MagnetometerAxes, axes_of, doubts, fit_magnetometer
from imumon.models.model import MagnetometerModel

FIELD = np.array([2.0, 20.0, -43.0])
UP = np.array([0.0, 0.0, 9.81])
HARD = np.array([12.0, -30.0, 8.0])
BIAS = np.array([0.05, -0.03, 0.02])
LEFT_HANDED = np.diag([1.0, 1.0, -1.0])
MPU_9250 = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def turns(
    seed: int, way: FloatArray, rate_hz: float = 50.0, speed: float = 1.6, late: int = 0, held: int = 1
) -> SampleBlock:
    """Gyros with a bias, and a magnetometer whose axes are `way` away from theirs."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(150.0 / speed * rate_hz)) / rate_hz
    phases = rng.uniform(0.0, 6.0, (3, 2))
    rate = np.column_stack(
        [
            speed * np.sin(speed * t / 1.8 + a) * np.cos(speed * t / (8.0 + k) + b)
            for k, (a, b) in enumerate(phases)
        ]
    )
    steps = Rotation.from_rotvec(rate / rate_hz).as_matrix()
    attitude = np.array(list(accumulate(steps, np.matmul)))
    field, accel = FIELD @ attitude, UP @ attitude
    mag = np.roll(field, late, axis=0) @ way + HARD + 0.3 * rng.normal(size=(len(t), 3))
    mag = mag[np.arange(len(t)) // held * held]
    gyro = rate + BIAS + 0.002 * rng.normal(size=rate.shape)
    columns = {"device_time_ns": np.round(t * 1e9).astype(np.int64), "segment": np.zeros(len(t), np.int64)}
    columns |= {f"gyro_{a}": gyro[:, j] for j, a in enumerate("xyz")}
    columns |= {f"accel_{a}": accel[:, j] for j, a in enumerate("xyz")}
    return SampleBlock(columns | {f"mag_{a}": mag[:, j] for j, a in enumerate("xyz")})


def found(block: SampleBlock) -> tuple[MagnetometerModel, MagnetometerAxes | None]:
    parts = [block.rows(0, 333), block.rows(333, len(block))]
    model = fit_magnetometer(parts, "uT", "test").model
    return model, axes_of(parts, model)


@pytest.mark.parametrize(
    ("rate_hz", "speed", "late", "held"),
    [(50.0, 1.6, 0, 1), (10.0, 0.5, 0, 1), (200.0, 4.0, 4, 1), (100.0, 0.3, 0, 10)],
)
def test_axes_as_declared_are_found_as_such(rate_hz: float, speed: float, late: int, held: int) -> None:
    for seed in (1, 2):
        model, axes = found(turns(seed, np.eye(3), rate_hz, speed, late, held))
        assert axes is not None
        assert axes.is_significant
        assert axes.angle < 3.0 * axes.sd
        assert axes.sd < np.radians(1.5)
        assert doubts(model, axes, "test") == []


@pytest.mark.parametrize("way", [MPU_9250, LEFT_HANDED, AXIS_MAPS[7], -AXIS_MAPS[15]])
def test_other_axes_are_refused_and_named(way: FloatArray) -> None:
    model, axes = found(turns(3, way))
    with pytest.raises(ImumonError, match="has not the gyros' axes: their x, y, z are its") as caught:
        doubts(model, axes, "a recording")
    if way is MPU_9250:
        assert "+y, +x, -z or -y, -x, +z" in str(caught.value)
    if way is LEFT_HANDED:
        assert "+x, +y, -z or -x, -y, +z" in str(caught.value)


def test_a_magnetometer_that_is_mounted_askew_is_reported_with_its_angle() -> None:
    askew = Rotation.from_rotvec(np.radians([3.0, -4.0, 0.0])).as_matrix()
    model, axes = found(turns(4, askew))
    assert axes is not None
    np.testing.assert_allclose(axes.angle, np.radians(5.0), atol=0.01)
    assert "° against the gyros" in doubts(model, axes, "test")[0]


def test_gyros_that_do_not_turn_as_the_field_are_reported() -> None:
    block = turns(5, np.eye(3))
    slow = {name: values / 57.3 for name, values in block.columns.items() if name.startswith("gyro")}
    model, axes = found(block.with_columns(slow))
    assert axes is not None
    assert not axes.follows
    assert "unit and axes of the gyros" in doubts(model, axes, "test")[0]


def test_without_gyros_nothing_is_reported() -> None:
    block = turns(6, np.eye(3))
    alone = SampleBlock({name: v for name, v in block.columns.items() if not name.startswith("gyro")})
    model, axes = found(alone)
    assert axes is None
    assert doubts(model, axes, "test") == []


def test_a_current_that_is_switched_on_meanwhile_is_in_the_sigma() -> None:
    block = turns(7, np.eye(3))
    half = np.arange(len(block)) > 0.4 * len(block)
    little = block.with_columns({"mag_x": block["mag_x"] + 0.6 * half})
    model, _ = found(little)
    before, after = np.abs(model.hard_iron[0] - HARD[0]), np.abs(model.hard_iron[0] - HARD[0] - 0.6)
    assert max(before, after) < 3.0 * model.hard_iron_sd[0]
    assert model.hard_iron_sd[0] > 5.0 * found(block)[0].hard_iron_sd[0]
    with pytest.raises(ImumonError, match="are known to"):
        found(block.with_columns({"mag_x": block["mag_x"] + 4.0 * half}))


def test_a_field_in_another_unit_is_reported() -> None:
    block = turns(8, np.eye(3))
    fit = fit_magnetometer([block], "uT", "test")
    assert doubts(fit.model, None, "test") == []
    gauss = {f"mag_{a}": block[f"mag_{a}"] / 100.0 for a in "xyz"}
    weak, other = (fit_magnetometer([block.with_columns(gauss)], unit, "test").model for unit in ("uT", "1"))
    assert "is the unit right" in doubts(weak, None, "test")[0]
    assert doubts(other, None, "test") == []
