from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray
from imumon.lab.calibration.magnetometer import AXIS_MAPS, axis_map_as_text, fitted_axes

FIELD = np.array([0.4, 0.1, -0.9])


def nearest(way: FloatArray, seed: int, count: int = 200, noise: float = 0.02) -> int:
    """Which way is found of a field that is `way` away from the gyros' axes, over turns of 0.5 rad."""
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(0.3 * rng.normal(size=(count, 3)))
    after = rng.normal(size=(count, 3)) * noise + Rotation.random(count, rng=rng).apply(FIELD)
    before, still = turns.apply(after), np.zeros((count, 2, 3))
    by_bias = np.broadcast_to(0.5 * np.eye(3), (count, 3, 3))
    field = np.stack([before @ way, after @ way], axis=1)
    return fitted_axes(field, still, turns.as_matrix(), by_bias, noise).nearest


def test_there_are_24_ways_and_the_first_is_as_declared() -> None:
    assert AXIS_MAPS.shape == (24, 3, 3)
    np.testing.assert_array_equal(AXIS_MAPS[0], np.eye(3))
    np.testing.assert_allclose(np.linalg.det(AXIS_MAPS), 1.0)
    assert len({way.tobytes() for way in AXIS_MAPS + 0.0}) == 24


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_way_is_found_whatever_the_sign(sign: float) -> None:
    for k, way in enumerate(AXIS_MAPS):
        assert nearest(sign * way, k) == k


def test_turns_about_one_axis_with_iron_left_over_are_evidence_of_no_axes() -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.0, 20.0, 200), [0.0, 0.0, 1.0]))
    field = turns.inv().apply(FIELD) + np.array([0.09, 0.04, 0.03])
    relative, still = (turns[:-1].inv() * turns[1:]).as_matrix(), np.zeros((199, 2, 3))
    by_bias = np.broadcast_to(0.5 * np.eye(3), (199, 3, 3))
    both = np.stack([field[:-1], field[1:]], axis=1)
    assert not fitted_axes(both, still, relative, by_bias, 0.02).is_significant


def test_a_way_is_named_with_its_reverse() -> None:
    swapped = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert axis_map_as_text(swapped) == "+y, +x, -z or -y, -x, +z"
