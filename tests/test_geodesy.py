from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon import geodesy
from imumon.blocks import FloatArray

ANGLES = [(0.0, 0.0, 200.0), (30.0, -50.0, 75.0), (180.0, 0.0, 10.0), (-95.0, 20.0, 300.0)]
"""Roll, pitch, heading of forward-right-down axes, degrees."""


def _matrix(angles: tuple[float, float, float]) -> FloatArray:
    return np.asarray(Rotation.from_euler("ZYX", angles[::-1], degrees=True).as_matrix())


@pytest.mark.parametrize("angles", ANGLES)
def test_the_attitude_is_that_of_the_euler_angles(angles: tuple[float, float, float]) -> None:
    matrix = _matrix(angles)
    found = geodesy.body_to_ned(-matrix[2], math.radians(angles[2]))
    np.testing.assert_allclose(found, matrix, atol=1e-12)


@pytest.mark.parametrize("angles", ANGLES)
@pytest.mark.parametrize("latitude_deg", [-90.0, -20.0, 36.0])
def test_the_earth_rate_turns_into_the_body(angles: tuple[float, float, float], latitude_deg: float) -> None:
    matrix, latitude = _matrix(angles), math.radians(latitude_deg)
    expected = matrix.T @ np.array([math.cos(latitude), 0.0, -math.sin(latitude)]) * geodesy.EARTH_RATE
    up = -matrix[2]
    found = geodesy.earth_rate_along(up, geodesy.north_in_body(up, math.radians(angles[2])), latitude)
    np.testing.assert_allclose(found, expected, atol=1e-18)


@pytest.mark.parametrize("pitch_deg", [0.0, 80.0, 89.0, 90.0, -90.0])
@pytest.mark.parametrize("heading_deg", [0.0, 40.0, -170.0])
def test_a_heading_comes_back_also_where_x_is_vertical(pitch_deg: float, heading_deg: float) -> None:
    up, heading = -_matrix((20.0, pitch_deg, 0.0))[2], math.radians(heading_deg)
    north = geodesy.north_in_body(up, heading)
    assert abs(north @ up) < 1e-12
    assert geodesy.heading_of(up, 3.0 * north + 5.0 * up) == pytest.approx(heading)


def test_minus_z_has_the_heading_where_x_is_vertical() -> None:
    # x points up, -z to the east.
    north = geodesy.north_in_body(np.array([1.0, 0.0, 0.0]), math.radians(90.0))
    east = np.cross(north, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(east, [0.0, 0.0, -1.0], atol=1e-12)
