from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray
from imumon.lab.calibration.mounting import WAYS, Mounting, named

FIELD = np.array([0.4, 0.1, -0.9])


def turned(way: FloatArray, seed: int, count: int = 200, noise: float = 0.02) -> Mounting:
    """What a magnetometer tells whose field is `way` away from the gyros' axes, over turns of 0.5 rad."""
    rng = np.random.default_rng(seed)
    turns = Rotation.from_rotvec(0.3 * rng.normal(size=(count, 3)))
    after = rng.normal(size=(count, 3)) * noise + Rotation.random(count, rng=rng).apply(FIELD)
    before = turns.apply(after)
    told = Mounting()
    told.add(before @ way, after @ way, turns.as_matrix())
    return told


def test_there_are_24_ways_and_the_first_is_as_declared() -> None:
    assert WAYS.shape == (24, 3, 3)
    np.testing.assert_array_equal(WAYS[0], np.eye(3))
    np.testing.assert_allclose(np.linalg.det(WAYS), 1.0)
    assert len({way.tobytes() for way in WAYS + 0.0}) == 24


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_every_way_is_found_whatever_the_sign(sign: float) -> None:
    for k, way in enumerate(WAYS):
        told = turned(sign * way, k)
        assert told.left().argmin() == k
        assert told.found == k


def test_little_turned_and_turns_about_one_axis_are_not_told() -> None:
    assert turned(WAYS[5], 1, count=3).found == 0
    about_z = Rotation.from_rotvec(np.array([[0.0, 0.0, 0.5]] * 400))
    after = np.tile(FIELD, (400, 1))
    told = Mounting()
    quarter = Rotation.from_rotvec([0.0, 0.0, np.pi / 2]).as_matrix()
    told.add(about_z.apply(after) @ quarter, after @ quarter, about_z.as_matrix())
    assert told.found == 0


def test_iron_on_a_unit_that_turns_about_one_axis_is_no_other_way() -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0.0, 20.0, 200), [0.0, 0.0, 1.0]))
    field = turns.inv().apply(FIELD) + np.array([0.9, 0.4, 0.3])
    told = Mounting()
    told.add(field[:-1], field[1:], (turns[:-1].inv() * turns[1:]).as_matrix())
    assert told.found == 0


def test_a_way_is_named_with_its_reverse() -> None:
    swapped = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
    assert named(swapped) == "+y, +x, -z or -y, -x, +z"
