from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from imumon.geodesy import EARTH_RATE, earth_rate_along
from imumon.simulation.unit.unit import body_rates, reported, to_body

ANGLE = st.floats(-np.pi, np.pi)


@given(roll=ANGLE, pitch=ANGLE, heading=ANGLE)
@settings(max_examples=60, deadline=None)
def test_vectors_turn_as_scipy_turns_them(roll: float, pitch: float, heading: float) -> None:
    rotation = Rotation.from_euler("ZYX", [heading, pitch, roll])
    vectors = np.array([[1.0, 2.0, -3.0], [0.0, 0.5, 9.8]])
    angles = np.tile([roll, pitch, heading], (2, 1))
    np.testing.assert_allclose(to_body(angles, vectors), rotation.inv().apply(vectors), atol=1e-12)
    np.testing.assert_allclose(
        to_body(angles[:1], vectors[0])[0], rotation.inv().apply(vectors[0]), atol=1e-12
    )


@given(roll=ANGLE, pitch=ANGLE, heading=ANGLE)
@settings(max_examples=60, deadline=None)
def test_the_reported_attitude_takes_gravity_to_down_or_up(roll: float, pitch: float, heading: float) -> None:
    angles = np.array([[roll, pitch, heading]])
    up = to_body(angles, np.array([0.0, 0.0, -1.0]))
    north = to_body(angles, np.array([1.0, 0.0, 0.0]))
    flip = np.array([1.0, -1.0, -1.0])
    ned, enu = reported(angles, "FRD"), reported(angles, "FLU")
    to_ned = Rotation.from_quat([ned[f"q_{c}"][0] for c in "xyzw"])
    to_enu = Rotation.from_quat([enu[f"q_{c}"][0] for c in "xyzw"])
    np.testing.assert_allclose(to_ned.apply(up), [[0, 0, -1]], atol=1e-9)
    np.testing.assert_allclose(to_ned.apply(north), [[1, 0, 0]], atol=1e-9)
    np.testing.assert_allclose(to_enu.apply(up * flip), [[0, 0, 1]], atol=1e-9)
    np.testing.assert_allclose(to_enu.apply(north * flip), [[0, 1, 0]], atol=1e-9)


def test_rates_of_angles_become_rates_of_the_body() -> None:
    """Against the difference of two attitudes a microsecond apart."""
    random = np.random.default_rng(1)
    angles, rates, step = random.uniform(-1.4, 1.4, (50, 3)), random.normal(0, 1, (50, 3)), 1e-6
    before = Rotation.from_euler("ZYX", angles[:, ::-1])
    after = Rotation.from_euler("ZYX", (angles + rates * step)[:, ::-1])
    numeric = (before.inv() * after).as_rotvec() / step
    np.testing.assert_allclose(body_rates(angles, rates), numeric, atol=1e-5)


@pytest.mark.parametrize(
    ("latitude", "north", "down"), [(0.0, 1.0, 0.0), (90.0, 0.0, -1.0), (-30.0, np.sqrt(0.75), 0.5)]
)
def test_the_earth_turns_about_its_axis(latitude: float, north: float, down: float) -> None:
    ahead, _, below = np.eye(3)
    rate = earth_rate_along(-below, ahead, np.deg2rad(latitude))
    np.testing.assert_allclose(rate / EARTH_RATE, [north, 0.0, down], atol=1e-12)
