from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from imumon.blocks import FloatArray, SampleBlock, join
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.smoothing.stage import Recorder, SmoothedEstimates, backward
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.simulation.unit.scenario import Scenario
from imumon.simulation.unit.unit import SimulatedUnit
from tests.estimation.gyro_bias.records import GIVEN
from tests.estimation.rest.scenes import block as noisy
from tests.estimation.rest.scenes import flicker, noise
from tests.estimation.rest.test_wander import TAUS_S

RATE_HZ = 50


def recorded(seed: int, latitude_deg: float | None = None, **changes: Any) -> tuple[SampleBlock, SampleBlock]:
    """Samples behind the stages, and the truth: a rest, a minute of handling, and a rest in the same pose."""
    given = {
        "format": "imumon-scenario/1",
        "unit": "athermal",
        "rate_hz": RATE_HZ,
        "duration_s": 260.0,
        "latitude_deg": 40.0,
        "chamber": {"start_degc": 25.0},
        "motion": [
            {"kind": "handling", "at_s": 100.0, "rounds": 1, "every_s": 80.0, "rest_s": 10.0,
             "swing_deg": [20.0, 15.0, 30.0], "heading_deg": 0.0}
        ],
    }  # fmt: skip
    scenario = Scenario.model_validate(given | changes)
    sent, truth = SimulatedUnit(scenario, seed).run(scenario.samples)
    own = {"roll", "pitch", "yaw", *(f"q_{part}" for part in "wxyz"), *(f"mag_{axis}" for axis in "xyz")}
    block = SampleBlock({name: values for name, values in sent.columns.items() if name not in own})
    for stage in (TemperatureRate(), RestAndBias(mode="learned", latitude_deg=latitude_deg)):
        block = block.with_columns(stage.process(block))
    return block, truth


def smooth(block: SampleBlock, latitude_deg: float | None = None) -> SmoothedEstimates:
    recorder = Recorder()
    recorder.add(block)
    record = recorder.finish()
    south = None if latitude_deg is None else -latitude_deg
    bias = RestAndBias(mode="learned", latitude_deg=south)
    return SmoothedEstimates(record, backward(record, TemperatureRate(), bias))


def true_bias(truth: SampleBlock, vertical: float) -> FloatArray:
    """The bias, with the earth rate that the filter cannot tell from it: that of the latest rest."""
    rate, bias = truth.vector("rate"), truth.vector("gyro_bias")
    assert rate is not None
    assert bias is not None
    latest = np.maximum.accumulate(np.where(truth["at_rest"] == 1, np.arange(len(truth)), 0))
    turned = rate[latest]
    turned[:, 2] -= vertical
    return np.asarray(bias + turned)


@pytest.mark.long
@pytest.mark.parametrize(
    "chamber",
    [
        {"start_degc": 25.0},
        {"start_degc": 20.0, "lag_s": 60.0, "steps": [{"to_degc": 30.0, "rate_degc_per_min": 4.0}]},
    ],
)
def test_the_smoothed_bias_errs_less_and_as_its_sigma_states(chamber: dict[str, Any]) -> None:
    errors: dict[str, list[FloatArray]] = {"forward": [], "smoothed": [], "z": []}
    for seed in range(2):
        block, truth = recorded(seed, chamber=chamber, unit="crs05" if "steps" in chamber else "athermal")
        stage = smooth(block)
        found = SampleBlock(dict(stage.process(block)))
        true = true_bias(truth, 0.0)
        for j, axis in enumerate("xyz"):
            known = np.isfinite(block[f"gyro_bias_{axis}"])
            error = found[f"gyro_bias_smoothed_{axis}"] - true[:, j]
            errors["forward"].append((block[f"gyro_bias_{axis}"] - true[:, j])[known])
            errors["smoothed"].append(error[known])
            errors["z"].append(error / found[f"gyro_bias_smoothed_sd_{axis}"])
            assert np.isfinite(error).all()  # what comes later fills the beginning
            assert stage.residuals[f"gyro_bias_{axis}"] < 2.0
    forward, smoothed, z = (np.concatenate(parts) for parts in errors.values())
    assert np.sqrt(np.mean(smoothed**2)) < 0.95 * np.sqrt(np.mean(forward**2))
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.8
    assert np.abs(z).max() < 5.0


@pytest.mark.long
def test_the_temperature_has_no_lag_left() -> None:
    chamber = {"start_degc": 20.0, "lag_s": 60.0, "steps": [{"to_degc": 30.0, "rate_degc_per_min": 4.0}]}
    late = slice(10 * RATE_HZ, None)
    errors: dict[str, list[FloatArray]] = {
        name: [] for name in ("before", "after", "rate before", "rate after")
    }
    z = []
    for seed in range(2):
        block, truth = recorded(seed, chamber=chamber, duration_s=240.0, motion=[])
        found = SampleBlock(dict(smooth(block).process(block)))
        true, rate = truth["temperature"], np.gradient(truth["temperature"]) * RATE_HZ
        errors["before"].append((block["temperature_estimate"] - true)[late])
        errors["after"].append((found["temperature_estimate_smoothed"] - true)[late])
        errors["rate before"].append((block["temperature_rate"] - rate)[late])
        errors["rate after"].append((found["temperature_rate_smoothed"] - rate)[late])
        z.append(errors["after"][-1] / found["temperature_estimate_smoothed_sd"][late])
    rms = {name: float(np.sqrt(np.mean(np.concatenate(parts) ** 2))) for name, parts in errors.items()}
    assert rms["after"] < 0.95 * rms["before"]
    assert rms["rate after"] < 0.8 * rms["rate before"]
    assert np.sqrt(np.mean(np.concatenate(z) ** 2)) < 1.8
    # Where the chamber stops, the filter itself is six sigma off for a moment, in either direction.
    assert np.quantile(np.abs(np.concatenate(z)), 0.99) < 4.0


@pytest.mark.long
def test_the_earth_turns_the_other_way_backward() -> None:
    block, truth = recorded(5, latitude_deg=40.0)
    stage = smooth(block, 40.0)
    found = SampleBlock(dict(stage.process(block)))
    vertical = -7.292115e-5 * np.sin(np.radians(40.0))  # about the axis that points down
    true = true_bias(truth, vertical)
    z = (found["gyro_bias_smoothed_z"] - true[:, 2]) / found["gyro_bias_smoothed_sd_z"]
    assert np.abs(z).max() < 5.0
    assert stage.residuals["gyro_bias_z"] < 2.0


@pytest.mark.long
def test_a_jump_that_the_model_lacks_shows_in_the_disagreement() -> None:
    block, _ = recorded(6, motion=[])
    jump = np.where(np.arange(len(block)) > 150 * RATE_HZ, np.radians(0.3), 0.0)
    raw = {name: values for name, values in block.columns.items() if not name.startswith(("gyro_", "turn"))}
    raw |= {f"gyro_{axis}": block[f"gyro_{axis}"] + jump for axis in "xyz"} | {
        "at_rest": np.ones(len(block), np.int64)
    }
    jumped = SampleBlock(raw)
    added = RestAndBias(GIVEN, mode="learned").process(jumped)
    jumped = jumped.with_columns({name: added[name] for name in added if not name.startswith("turn")})
    stage = smooth(jumped)
    r = [stage.residuals[f"gyro_bias_{axis}"] for axis in "xyz"]
    assert r == pytest.approx([5.8, 9.6, 13.1], abs=0.1)  # as docs/smoothing.md has it, as what follows
    found = SampleBlock(dict(stage.process(jumped)))
    sd = np.column_stack([found[f"gyro_bias_smoothed_sd_{axis}"] for axis in "xyz"]) / DEG_PER_H
    assert sd.max() == pytest.approx(540.0, abs=5.0)
    assert np.median(sd, axis=0) == pytest.approx([8.3, 6.1, 4.4], abs=0.1)
    assert any("contradict each other in gyro_bias_x" in text for text in stage.notices())


@pytest.mark.long
def test_a_slow_turn_that_is_taken_for_rest_is_doubted_in_both_directions() -> None:
    """0.05 °/s for 8 min: at its end a filter that runs backward sees a mean as steady as that of a bias."""
    t, gyro, accel = noise(780.0, 10.0, gyro_sd=4e-4)
    gyro += flicker(gyro, 10.0, 20.0 * DEG_PER_H, 2, TAUS_S)
    still = noise(780.0, 10.0, gyro_sd=0.0)[1] + flicker(gyro, 10.0, 20.0 * DEG_PER_H, 2, TAUS_S)
    gyro[:, 2] += 180.0 * DEG_PER_H * np.clip(np.minimum(t - 150.0, 640.0 - t) / 10.0, 0.0, 1.0)
    samples = noisy(t, gyro, accel)
    for stage in (TemperatureRate(), RestAndBias()):
        samples = samples.with_columns(stage.process(samples))
    found = smooth(samples).process(samples)
    z = (found["gyro_bias_smoothed_z"] - still[:, 2]) / found["gyro_bias_smoothed_sd_z"]
    assert samples["at_rest"].mean() > 0.7
    assert (np.abs(z) > 5.0).mean() < 0.01


def test_the_result_does_not_depend_on_the_blocks() -> None:
    block, _ = recorded(7, duration_s=120.0, motion=[])
    half = len(block) // 2
    segment = (np.arange(len(block)) >= half).astype(np.int64)
    block = block.with_columns({"segment": segment})
    whole = smooth(block)
    cuts = np.unique(np.random.default_rng(3).integers(1, len(block), 40)).tolist()
    recorder = Recorder()
    parts = [block.rows(a, b) for a, b in pairwise([0, *cuts, len(block)])]
    for part in parts:
        recorder.add(part)
    record = recorder.finish()
    assert record.run[0] == 1
    assert record.run[-1] == 2
    pieces = SmoothedEstimates(record, backward(record, TemperatureRate(), RestAndBias(mode="learned")))
    expected = whole.process(block)
    got = join([SampleBlock(dict(pieces.process(part))) for part in parts])
    assert {column.name for column in whole.columns} == set(expected)
    for name, values in expected.items():
        np.testing.assert_array_equal(got[name], values, err_msg=name)


def test_a_recording_without_sensors_has_nothing_to_smooth() -> None:
    empty = SampleBlock({"device_time_ns": np.arange(50) * 10_000_000, "segment": np.zeros(50, np.int64)})
    stage = smooth(empty)
    assert stage.process(empty) == {}
    assert stage.residuals == {}
    nothing = SampleBlock({"device_time_ns": np.empty(0, np.int64), "segment": np.empty(0, np.int64)})
    assert smooth(nothing).process(nothing) == {}
