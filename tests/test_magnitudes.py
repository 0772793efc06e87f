from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.intake import LONG_S, Intake, SpecificForce, rate_doubts
from imumon.protocols.ranges import Ranges


def moved(factor: float, seconds: float = 300.0, rate_hz: float = 10.0, shakes: float = 0.3) -> SampleBlock:
    """A unit that is shaken by a share of gravity, in a unit that is off by a factor."""
    rng = np.random.default_rng(1)
    n = int(seconds * rate_hz)
    force = factor * STANDARD_GRAVITY * (np.array([0.0, 0.6, 0.8]) + shakes * rng.normal(size=(n, 3)))
    columns = {f"accel_{a}": force[:, j] for j, a in enumerate("xyz")}
    time_ns = np.round(np.arange(n) / rate_hz * 1e9).astype(np.int64) + 1_700_000_000_123_000_000
    return SampleBlock({**columns, "device_time_ns": time_ns, "segment": np.zeros(n, np.int64)})


def found(block: SampleBlock, size: int = 10**6, least_s: float = LONG_S) -> str | None:
    force = SpecificForce()
    for start in range(0, len(block), size):
        force.look(block.rows(start, min(start + size, len(block))))
    return force.doubt(least_s)


@pytest.mark.parametrize(("factor", "told"), [(1000.0, "1e+03"), (9.80665, "9.9"), (1 / 9.80665, "0.1")])
def test_a_specific_force_in_another_unit_is_reported_in_motion(factor: float, told: str) -> None:
    text = found(moved(factor, shakes=0.1))
    assert text is not None
    assert "of the specific force readings are not within 0.3 to 3 times gravity" in text
    assert f"but {told} in the mean" in text
    assert found(moved(factor, shakes=0.1), 7) == text
    assert found(moved(factor, seconds=200.0)) is None


@pytest.mark.parametrize("shakes", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("factor", [0.7, 1.0, 1.5])
def test_motion_in_the_declared_unit_is_not(factor: float, shakes: float) -> None:
    assert found(moved(factor, shakes=shakes)) is None


def test_what_a_rocket_does_for_two_minutes_and_what_is_missing_are_not_reported() -> None:
    block = moved(1.0, 900.0)
    t = np.arange(len(block)) / 10.0
    burns = np.where((t % 300.0) < 110.0, 5.0, 1.0)
    assert found(block.with_columns({f"accel_{a}": block[f"accel_{a}"] * burns for a in "xyz"})) is None
    burn = np.where(t < 115.0, 5.0, 1.0)
    flight = block.with_columns({f"accel_{a}": block[f"accel_{a}"] * burn for a in "xyz"})
    assert all(found(flight.rows(0, n)) is None for n in range(100, len(flight), 100))
    assert found(block.with_columns({"accel_x": np.full(len(block), np.nan)})) is None


def test_another_unit_is_reported_at_the_end_of_a_short_run_of_five_seconds() -> None:
    for seconds, count in ((4.0, 0), (8.0, 1)):
        intake = Intake(Ranges())
        intake.process(moved(0.001, seconds, rate_hz=50.0))
        assert intake.notices() == []
        assert len(intake.notices(ended=True)) == count
        assert intake.notices(ended=True) == []


def test_what_falls_or_is_thrown_for_less_than_half_of_a_short_run_is_not_reported() -> None:
    block = moved(1.0, 20.0, rate_hz=50.0, shakes=0.1)
    for factor in (0.01, 8.0):
        some = np.where(np.arange(len(block)) < 0.45 * len(block), factor, 1.0)
        thrown = block.with_columns({f"accel_{a}": block[f"accel_{a}"] * some for a in "xyz"})
        assert found(thrown, least_s=5.0) is None


def test_gaps_and_restarts_are_no_time_of_samples() -> None:
    time_ns = np.repeat(np.arange(3) * 10**12, 100) + np.tile(np.arange(100), 3) * 10**6
    columns = {f"accel_{a}": np.full(300, 100.0) for a in "xyz"}
    block = SampleBlock({**columns, "device_time_ns": time_ns, "segment": np.repeat([0, 1, 1], 100)})
    assert found(block, least_s=5.0) is None
    assert found(block, least_s=0.2) is not None


def test_the_intake_reports_it_once() -> None:
    intake = Intake(Ranges())
    intake.process(moved(1000.0))
    assert "1e+03 in the mean" in intake.notices()[0]
    assert intake.notices() == []
    assert intake.left_out == 0


@pytest.mark.parametrize(("rate_hz", "count"), [(0.05, 1), (5e4, 1), (0.2, 0), (32e3, 0), (np.nan, 0)])
def test_rates_of_no_inertial_sensor_are_reported(rate_hz: float, count: int) -> None:
    assert len(rate_doubts(rate_hz)) == count
