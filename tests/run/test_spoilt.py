"""Streams with everything that a line and a device do to them, through all stages; warnings are errors."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from imumon.blocks import NO_INT, ColumnArray, SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel, MagnetometerModel
from imumon.pipeline import Pipeline
from imumon.run import PUBLISHED
from imumon.run.setup import Setup
from imumon.run.stages import estimators

RATE_HZ = 25
SENSORS = ("gyro", "accel", "mag", "temperature")
FIELD = np.array([0.0, 20.0, -40.0])
TIMES = ("device_time_ns", "segment")

Fault = Callable[[dict[str, ColumnArray], slice, np.random.Generator], None]


def stream(n: int, rng: np.random.Generator) -> dict[str, ColumnArray]:
    """Rests, turns and knocks of a unit with a magnetometer that warms up."""
    edges = np.sort(rng.choice(n, 8))
    turning = np.zeros((n, 3))
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        turning[start:stop] = rng.standard_normal(3) * 10.0 ** rng.uniform(-3.0, 0.5)
    body = Rotation.identity()
    up, field = np.empty((n, 3)), np.empty((n, 3))
    for i in range(n):
        body = body * Rotation.from_rotvec(turning[i] / RATE_HZ)
        up[i], field[i] = body.inv().apply(np.stack([[0.0, 0.0, STANDARD_GRAVITY], FIELD]))
    noise = 10.0 ** rng.uniform(-6.0, -2.0)
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.arange(n) * (1_000_000_000 // RATE_HZ),
        "segment": np.zeros(n, np.int64),
    }
    parts = {"gyro": turning + 1e-3, "accel": up, "mag": field}
    for name, values in parts.items():
        noisy = values + noise * rng.standard_normal((n, 3))
        columns |= {f"{name}_{axis}": noisy[:, j] for j, axis in enumerate("xyz")}
    columns["temperature"] = 25.0 + 1e-3 * np.arange(n) / RATE_HZ + noise * rng.standard_normal(n)
    return columns


def of(columns: dict[str, ColumnArray], rng: np.random.Generator) -> list[str]:
    """Return the columns of a sensor, or one of them."""
    sensor = str(rng.choice(SENSORS))
    names = [name for name in columns if name.startswith(sensor)]
    return names if rng.random() < 0.5 else [str(rng.choice(names))]


def missing(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    for name in of(columns, rng):
        columns[name][where] = np.nan


def constant(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    for name in of(columns, rng):
        columns[name][where] = columns[name][where.start]


def zero(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    for name in of(columns, rng):
        columns[name][where] = 0.0


def far(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    for name in of(columns, rng):
        columns[name][where] *= 10.0 ** rng.uniform(-3.0, 12.0)


def outliers(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    for name in of(columns, rng):
        some = rng.random(where.stop - where.start) < 0.1
        columns[name][where][some] = rng.choice([np.inf, -np.inf, 0.0, 1e3, -200.0])


def coarse(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    for name in of(columns, rng):
        step = 10.0 ** rng.uniform(-3.0, 1.0)
        columns[name][where] = np.round(columns[name][where] / step) * step


def gap(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    columns["device_time_ns"][where.start :] += round(10.0 ** rng.uniform(7.0, 14.0))


def restart(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    """Anew from any time, mostly with a segment of its own."""
    columns["device_time_ns"][where] -= round(10.0 ** rng.uniform(7.0, 12.0))
    if rng.random() < 0.7:
        columns["segment"][where.start :] += 1


def undated(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    del rng
    columns["device_time_ns"][where] = NO_INT


def repeated(columns: dict[str, ColumnArray], where: slice, rng: np.random.Generator) -> None:
    """Rows of one time."""
    del rng
    dated = columns["device_time_ns"][where]
    dated[:] = dated[0]


FAULTS: tuple[Fault, ...] = (
    missing, constant, zero, far, outliers, coarse, gap, restart, restart, undated, repeated,
)  # fmt: skip


def spoilt(n: int, seed: int) -> tuple[SampleBlock, list[int]]:
    """Return a stream with up to eight faults, and where it is cut into blocks."""
    rng = np.random.default_rng(seed)
    columns = stream(n, rng)
    for _ in range(rng.integers(9)):
        start = int(rng.integers(n))
        where = slice(start, min(n, start + 1 + round(n ** rng.uniform(0.0, 1.0))))
        FAULTS[rng.integers(len(FAULTS))](columns, where, rng)
    left_out = rng.choice([*SENSORS, "none"], p=[0.05, 0.1, 0.2, 0.1, 0.55])
    kept = {name: values for name, values in columns.items() if not name.startswith(left_out)}
    return SampleBlock(kept), sorted({0, n, *rng.integers(1, n, 12).tolist()})


def setups() -> list[Setup]:
    """Return where nothing is known, and where nearly everything is."""
    magnetometer = MagnetometerModel(
        unit="uT", hard_iron=[0.0] * 3, hard_iron_sd=[0.05] * 3, soft_iron=np.eye(3).tolist(),
        soft_iron_sd=np.full((3, 3), 1e-3).tolist(), field=44.7, residual_sd=0.1, coverage=1.0,
    )  # fmt: skip
    curve = PolynomialCurve(center_degc=20.0, half_width_degc=15.0, coefficients=[1e-3, 3e-5])
    channel = ChannelModel(
        unit="rad/s", temperature_column="temperature", temperature_range_degc=[5.0, 35.0], residual_sd=1e-5,
        curve=curve,
    )  # fmt: skip
    channels = {f"gyro_{axis}": channel for axis in "xyz"}
    model = BiasModel(
        made_by="a test", created="2026-01-01T00:00:00Z", channels=channels, magnetometer=magnetometer
    )
    return [
        Setup(),
        Setup(latitude_deg=45.0, heading_deg=10.0, model=model),
        Setup(latitude_deg=45.0, published=list(PUBLISHED)),
    ]


def run(seed: int, seconds: int) -> None:
    """Run a stream; whatever is known has a standard deviation."""
    block, edges = spoilt(seconds * RATE_HZ, seed)
    pipeline = Pipeline(None, estimators(None, setups()[seed % 3]))
    for start, stop in pairwise(edges):
        pipeline.push(block.rows(start, stop))
    pipeline.finish()
    found = pipeline.take()
    assert all(isinstance(text, str) for text in pipeline.warnings())
    assert all(isinstance(state.text, str) for state in pipeline.lanes().values())
    assert all(chart.title for chart in pipeline.charts())
    for name, values in found.columns.items():
        assert name in block or values.dtype != np.float64 or not np.isinf(values).any(), name
    for name in [name for name in found.columns if "_sd" in name]:
        sd = found[name]
        assert (sd[np.isfinite(sd)] >= 0.0).all(), name


# In the last two accelerometers that say zero made the rest detector and the attitude stumble.
@pytest.mark.parametrize("seed", [0, 1, 2, 3, 1171, 1187])
def test_no_stage_stumbles_over_a_spoilt_stream(seed: int) -> None:
    run(seed, 60)
