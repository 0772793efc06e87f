"""Gyro bias and heading of simulated sessions, forward and smoothed: errors, over sigma, residual r."""

from collections.abc import Iterator

import numpy as np
from alignment_site_scenes import ACCEL_BIAS_UG
from samples import play
from study import Cell, Options, Study, Table, largest, rms

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.smoothing.stage import Record as Forward
from imumon.estimation.smoothing.stage import Recorder, SmoothedEstimates, backward, still_heading
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.simulation.unit import load_scenario

CASES = (
    ("self-heating", 300),
    ("self-heating", 1200),
    ("self-heating", 7200),
    ("athermal-ramp", 600),
    ("crs05-ramp", 900),
    ("crs05-ramp-hysteresis", 1800),
    ("warm-up", 900),
)
"""Scenario and seconds."""
RATE_HZ = 100
HEADINGS = 4
"""Sessions of the alignment for one of the others: they are short."""
HEADS = ("error over sigma, rms", "largest", "residual r")


def tables(given: Options) -> Iterator[Table]:
    """Yield the bias of each scenario, and the heading."""
    rows = []
    for name, seconds in CASES[: 1 if given.quick else None]:
        found = np.array([measured(name, seconds, seed) for seed in given.seeds])
        cells = [_three(found[:, :, k].mean(0)) for k in (0, 1, 2)]
        apart = f"{found[:, :, 4].min():.2f} to {found[:, :, 4].max():.2f}"
        rows.append([f"{name}, {seconds / 60:g} min", *cells, f"{found[:, :, 3].max():.1f}", apart])
    yield Table("", ["scenario", "forward [°/h]", "smoothed [°/h]", *HEADS], rows)
    count = len(given.seeds) * (1 if given.quick else HEADINGS)
    seeds = range(given.seeds[0], given.seeds[0] + count)
    error, z, live, apart_by = np.array([heading(seed) for seed in seeds]).T
    apart = f"{apart_by.min():.2f} to {apart_by.max():.2f}"
    row: list[Cell] = ["alignment, 5 min", rms(live), rms(error), rms(z), largest(z), apart]
    heads = ["heading", "forward, median [°]", "smoothed [°]", *HEADS]
    yield Table("", heads, [row], formats=("", ".4f", ".4f", ".2f", ".1f"))


def smoothed(name: str, seconds: int, seed: int) -> tuple[Forward, SmoothedEstimates, dict[str, FloatArray]]:
    """Simulate and smooth a scenario.

    Returns the forward record, what smoothed it, and at its slots the smoothed columns, `at_rest`, and as
    `true` the bias with the earth rate of the latest rest, (n, 3).
    """
    scenario = load_scenario(name).played(RATE_HZ, "FRD")
    n = seconds * RATE_HZ
    made = play(scenario, seed, (TemperatureRate(), RestAndBias(mode="learned")), n)
    recorder = Recorder()
    recorder.add(made.samples)
    forward = recorder.finish()
    stage = SmoothedEstimates(forward, backward(forward, TemperatureRate(), RestAndBias(mode="learned")))
    rows = np.minimum(forward.stop - 1, n - 1)
    columns = {key: values[rows] for key, values in stage.process(SampleBlock({"row": np.arange(n)})).items()}
    columns |= {"true": (made.bias + made.earth)[rows], "at_rest": made.samples["at_rest"][rows]}
    return forward, stage, columns


def measured(name: str, seconds: int, seed: int) -> FloatArray:
    """Return for each gyro: rms error forward and smoothed, °/h, rms and largest z, r, (3, 5)."""
    forward, stage, columns = smoothed(name, seconds, seed)
    result = []
    for j, axis in enumerate("xyz"):
        true = columns["true"][:, j]
        before, error = (
            forward.columns[f"gyro_bias_{axis}"] - true,
            columns[f"gyro_bias_smoothed_{axis}"] - true,
        )
        z = error / columns[f"gyro_bias_smoothed_sd_{axis}"]
        errors = [rms(before) / DEG_PER_H, rms(error) / DEG_PER_H]
        result.append([*errors, rms(z), largest(z), stage.residuals[f"gyro_bias_{axis}"]])
    return np.array(result)


def heading(seed: int) -> tuple[float, float, float, float]:
    """Return error of the smoothed heading, °, also over sigma, that forward, °, and the residual r."""
    scenario, recorder = load_scenario("alignment").played(RATE_HZ, "FRD"), Recorder()
    block = play(scenario, seed, ()).samples
    latitude_deg, true = scenario.latitude_deg or 0.0, np.radians(scenario.attitude.heading_deg)
    declared = AlignmentParameters(accel_bias_sd_ug=ACCEL_BIAS_UG)
    stage = Alignment(declared, latitude_deg, "FRD")
    block = block.with_columns({"at_rest": np.ones(len(block), np.int64)})
    recorder.add(block.with_columns(stage.process(block)))
    record = recorder.finish()
    found = still_heading(record, stage.finish())
    middle = len(found.value) // 2
    off = np.degrees(np.remainder(record.columns["heading"] - true + np.pi, 2.0 * np.pi) - np.pi)
    error = float(np.degrees(np.remainder(found.value[middle] - true + np.pi, 2.0 * np.pi) - np.pi))
    live = float(np.nanmedian(np.abs(off)))
    return error, error / float(np.degrees(found.sd[middle])), live, found.residual


def _three(values: FloatArray) -> str:
    return ", ".join(f"{value:.3g}" if value >= 10 else f"{value:.2f}" for value in values)


STUDY = Study(tables, seeds=5, first=100)
