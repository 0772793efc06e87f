"""Whether errors that add up for long, and sensors that fall silent or lie, are in the sigma."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from imumon.blocks import BoolArray, ColumnArray, FloatArray, SampleBlock
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from tests.estimation.attitude.scenes import matrices, wrapped
from tests.estimation.attitude.test_stage import CALIBRATED, Q, spun
from tests.lanes import texts

HZ = 20.0
FIELD = np.array([0.0, 20.0, -43.0])
GIVEN = AttitudeParameters(gyro_scale=1e-3, accel_bias_m_per_s2=0.05)


def sent(rest: BoolArray, error: FloatArray | float = 0.0, bias_sd: FloatArray | float = 1e-6) -> SampleBlock:
    """A unit that has been tilted by 45° and back and is level from 15 s on, (n,): its gyros are confirmed.

    `error`, rad/s, (n, 3) is that of the gyros, and `bias_sd` the sigma of their bias.
    """
    n = len(rest)
    t = np.arange(1, n + 1) / HZ
    angle = np.radians(45.0) * np.interp(t, [5.0, 6.0, 11.0, 12.0], [0.0, 1.0, 1.0, 0.0])
    accel = STANDARD_GRAVITY * np.column_stack([np.zeros(n), np.sin(angle), np.cos(angle)])
    gyro = error + np.outer(np.diff(angle, prepend=0.0) * HZ, [1.0, 0.0, 0.0])
    columns = {
        "device_time_ns": np.round(t * 1e9).astype(np.int64),
        "segment": np.zeros(n, np.int64),
        "at_rest": (rest & (np.diff(angle, prepend=0.0) == 0.0)).astype(np.int64),
        **{f"gyro_bias_sd_{axis}": np.zeros(n) + bias_sd for axis in "xyz"},
    }
    block = with_vectors(with_vectors(SampleBlock(columns), "gyro", gyro), "gyro_corrected", gyro)
    return with_vectors(block, "accel", accel)


def with_vectors(block: SampleBlock, name: str, values: FloatArray) -> SampleBlock:
    return block.with_columns({f"{name}_{axis}": values[:, j] for j, axis in enumerate("xyz")})


def heading(found: Mapping[str, ColumnArray]) -> tuple[FloatArray, FloatArray]:
    """Its change since it has a sigma, rad, and that."""
    sd = found["attitude_estimate_heading_sd"]
    value = found["attitude_estimate_heading"]
    return wrapped(value - value[np.flatnonzero(np.isfinite(sd))[0]]), sd


def motions(many: int, motion_s: float, rest_s: float, first_s: float = 20.0) -> BoolArray:
    """At rest for a while, and then so many motions with a rest behind each."""
    one = np.repeat([False, True], [round(motion_s * HZ), round(rest_s * HZ)])
    return np.concatenate([np.ones(round(first_s * HZ), bool), np.tile(one, many)])


def test_the_earth_turns_the_heading_by_one_sign_in_all_motions() -> None:
    rest = motions(60, 10.0, 2.0)
    late = np.arange(len(rest)) > 15.0 * HZ
    earth = np.outer(late, [0.0, 0.0, EARTH_RATE * np.sin(np.radians(48.0))])
    error, sd = heading(AttitudeEstimate(GIVEN, "FLU", latitude_deg=48.0).process(sent(rest, earth)))
    assert abs(error[-1]) == pytest.approx(np.radians(1.87), rel=0.02)
    assert sd[-1] == pytest.approx(abs(error[-1]), rel=0.1)


@pytest.mark.parametrize(("kept", "expected"), [(1.0, 500.0), (0.1, 10.0 * 50.0**0.5)])
def test_a_rest_that_measures_no_bias_makes_no_new_error(kept: float, expected: float) -> None:
    """Rests of a second leave the bias as it was; those that lower its sigma tenfold find another error."""
    rest = motions(50, 10.0, 1.0)
    sd = np.where(rest, 1e-4 * kept, 1e-4)
    found = AttitudeEstimate(GIVEN, "FLU").process(sent(rest, bias_sd=sd))
    assert heading(found)[1][-1] == pytest.approx(1e-4 * expected, rel=0.25)


def test_a_field_that_comes_no_more_corrects_nothing() -> None:
    rest = motions(1, 600.0, 0.0)
    drift, t = np.radians(0.03), np.arange(len(rest)) / HZ
    mag = np.where((t > 40.0)[:, np.newaxis], np.nan, FIELD)
    block = with_vectors(sent(rest, np.outer(t > 15.0, [0.0, 0.0, drift]), drift), "mag", mag)
    error, sd = heading(AttitudeEstimate(GIVEN, "FLU", CALIBRATED).process(block))
    assert np.degrees(abs(error[-1])) > 15.0
    assert np.abs(error / sd)[t > 40.0].max() < 2.0


def test_a_strong_magnet_that_is_rejected_makes_no_narrow_sigma() -> None:
    block, body = spun(75.0)
    near = np.arange(len(block)) >= 80.0 * 50.0
    room = np.where(near[:, np.newaxis], [0.0, 200.0, -43.0], FIELD)
    block = with_vectors(block, "mag", np.einsum("nji,nj->ni", body, room))
    stage = AttitudeEstimate(axes="FLU", magnetometer=CALIBRATED)
    found = stage.process(block)
    error = wrapped(found["attitude_estimate_heading"] - np.arctan2(body[:, 0, 0], body[:, 1, 0]))[near]
    sd = found["attitude_estimate_heading_sd"][near]
    assert texts(stage) == {"attitude": "disturbed: magnetic field"}
    assert np.degrees(np.abs(error).max()) > 5.0
    assert np.abs(error / sd).max() < 2.0


@pytest.mark.parametrize("rest_behind", [False, True])
def test_without_accelerometers_the_tilt_has_no_sigma_until_the_filter_follows_them_again(
    rest_behind: bool,
) -> None:
    rest = motions(1, 100.0, 0.0)
    rest[round(60.0 * HZ) :] = rest_behind
    t = np.arange(len(rest)) / HZ
    drift = np.radians(0.2)
    block = sent(rest, np.outer((t > 20.0) & ~rest, [drift, 0.0, 0.0]), drift)
    silent = np.where(((t >= 30.0) & (t < 60.0))[:, np.newaxis], np.nan, np.asarray(block.accel))
    found = AttitudeEstimate(GIVEN, "FLU").process(with_vectors(block, "accel", silent))
    up = matrices(np.column_stack([found[name] for name in Q]))[:, 2]
    tilt, sd = np.hypot(up[:, 0], up[:, 1])[t > 15.0], found["attitude_estimate_tilt_sd"][t > 15.0]
    assert np.degrees(tilt.max()) > 4.0
    assert np.nanmax(tilt / sd) < 4.0
    assert np.isfinite(sd[-1])
    relative = found["attitude_estimate_heading_sd"]
    assert relative[-1] > 0.9 * drift * np.count_nonzero(~rest) / HZ


def test_accelerometers_slower_than_the_slots_keep_their_sigma() -> None:
    block = sent(np.ones(round(60.0 * HZ), bool))
    accel = np.asarray(block.accel).copy()
    seldom = np.arange(len(accel)) % 11 > 0  # a reading in 0.55 s
    accel[seldom & (np.arange(len(accel)) > 20.0 * HZ)] = np.nan
    found = AttitudeEstimate(GIVEN, "FLU").process(with_vectors(block, "accel", accel))
    for name in ("tilt", "heading"):
        assert np.isfinite(found[f"attitude_estimate_{name}_sd"][round(15.0 * HZ) :]).all()
