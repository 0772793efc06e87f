"""The loop closed: a unit whose gyros lag is diagnosed, and with the model found the filter errs less."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock, join
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.runs import Run, collect
from imumon.models.model import BiasModel
from imumon.pipeline import Estimator
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.scenario import Scenario
from tests.estimation.gyro_bias.records import GIVEN

RATE_HZ, SECONDS = 5.0, 1700
LAG_S = 90.0
GYRO = ("gyro_x", "gyro_y", "gyro_z")


def scenario(*ends_degc: float) -> Scenario:
    base = load_scenario("crs05-ramp-lag")
    steps = [{"hold_s": 300}, *({"to_degc": end, "rate_degc_per_min": 3, "hold_s": 300} for end in ends_degc)]
    chamber = {**base.chamber.model_dump(), "start_degc": 25.0, "steps": steps}
    unit = {**base.unit.model_dump(), "gyro_lag_s": LAG_S}
    said = {**base.model_dump(), "rate_hz": RATE_HZ, "duration_s": SECONDS, "chamber": chamber, "unit": unit}
    return Scenario.model_validate(said)


def samples(seed: int, *ends_degc: float) -> tuple[SampleBlock, SampleBlock]:
    unit = SimulatedUnit(scenario(*ends_degc), seed=seed)
    return unit.run(int(SECONDS * RATE_HZ))


def as_run(seed: int, *ends_degc: float) -> Run:
    return collect([samples(seed, *ends_degc)[0]], f"run {seed}")[0]


@pytest.fixture(scope="module")
def models() -> dict[str, BiasModel]:
    train, test = [as_run(1, 40.0, 15.0), as_run(2, 12.0, 35.0)], [as_run(3, 38.0, 14.0)]
    found = extended_model(diagnose(train, test, "polynomial 5", sensors=("gyro",)))
    bare = {name: channel.model_copy(update={"effects": []}) for name, channel in found.channels.items()}
    return {"extended": found, "curve alone": found.model_copy(update={"channels": bare})}


@pytest.fixture(scope="module")
def other() -> tuple[SampleBlock, SampleBlock]:
    """Another power-on, and its truth."""
    return samples(9, 37.0, 16.0)


def through(sent: SampleBlock, size: int, *stages: Estimator) -> SampleBlock:
    """Return samples behind stages, in blocks; zero-velocity updates are in the first 250 s alone."""
    rest = (sent["device_time_ns"] - sent["device_time_ns"][0] < 250e9).astype(np.int64)
    block = sent.with_columns({"at_rest": rest})
    parts = []
    for at in range(0, len(block), size):
        part = block.rows(at, min(at + size, len(block)))
        for stage in stages:
            part = part.with_columns(stage.process(part))
        parts.append(part)
    return join(parts)


def bias_of(block: SampleBlock) -> FloatArray:
    return np.column_stack([block[f"gyro_bias_{axis}"] for axis in "xyz"])


@pytest.fixture(scope="module")
def biases(models: dict[str, BiasModel], other: tuple[SampleBlock, SampleBlock]) -> dict[str, FloatArray]:
    """What the pipeline says of the bias with each model."""
    sent = through(other[0], 2000, TemperatureRate())
    return {
        name: bias_of(through(sent, 2000, RestAndBias(GIVEN, model=model, mode="thermal")))
        for name, model in models.items()
    }


@pytest.mark.long
def test_every_gyro_is_found_to_lag(models: dict[str, BiasModel]) -> None:
    for name in GYRO:
        effects = models["extended"].channels[name].effects
        assert "thermal_lag" in [effect.name for effect in effects]


@pytest.mark.long
def test_the_bias_in_motion_errs_much_less_with_the_extended_model(
    biases: dict[str, FloatArray], other: tuple[SampleBlock, SampleBlock]
) -> None:
    known = np.column_stack([other[1][f"gyro_bias_{axis}"] for axis in "xyz"])
    ramp = slice(int(400 * RATE_HZ), None)
    errors = {name: np.sqrt(np.mean((bias - known)[ramp] ** 2, axis=0)) for name, bias in biases.items()}
    # x and y have the steeper curves: the lag matters most there.
    assert (errors["extended"] < np.array([0.2, 0.3, 0.8]) * errors["curve alone"]).all()


@pytest.mark.long
def test_the_division_into_blocks_does_not_matter(
    models: dict[str, BiasModel], biases: dict[str, FloatArray], other: tuple[SampleBlock, SampleBlock]
) -> None:
    short = other[0].rows(0, int(600 * RATE_HZ))
    found = through(
        short, 37, TemperatureRate(), RestAndBias(GIVEN, model=models["extended"], mode="thermal")
    )
    np.testing.assert_array_equal(bias_of(found), biases["extended"][: len(short)])


def test_an_unknown_start_widens_the_bias_until_it_is_forgotten(
    models: dict[str, BiasModel], other: tuple[SampleBlock, SampleBlock]
) -> None:
    moving = int(60 * RATE_HZ)
    sent = other[0].rows(0, moving + 1)
    sd = {}
    for name, model in models.items():
        stage = RestAndBias(GIVEN, model=model, mode="thermal")
        rest = (np.arange(len(sent)) < 20 * RATE_HZ).astype(np.int64)
        found = stage.process(sent.with_columns({"at_rest": rest}))
        sd[name] = found["gyro_bias_sd_x"]
    assert sd["extended"][moving] > 1.1 * sd["curve alone"][moving]
