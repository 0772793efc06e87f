"""The competitors: each takes a run and returns its bias estimate at every sample, rad/s, (n, 3)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import imufusion
import numpy as np
import numpy.typing as npt
from study import matrix
from vqf import VQF

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.parameters import GyroBiasParameters
from imumon.estimation.gyro_bias.stage import GyroBias, Mode, RestDetector
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.models.model import BiasModel
from imumon.simulation.unit.scenario import Scenario
from imumon.simulation.unit.unit import SimulatedUnit

DEG_PER_H = np.pi / 180.0 / 3600.0
BLOCK = 10_000
LEAST_MEAN_S = 3.0


@dataclass(frozen=True, slots=True, eq=False)
class Run:
    """What a unit sent, with the columns of temperature and rest, and the truth.

    bias and earth (n, 3) in rad/s; earth is the rate of the unit in its attitude at the last rest, which an
    estimator without latitude and heading cannot tell from bias.
    """

    scenario: Scenario
    samples: SampleBlock
    bias: FloatArray
    earth: FloatArray
    time_s: FloatArray
    rest: npt.NDArray[np.bool_]


Method = Callable[[Run], FloatArray]


def with_rests(samples: SampleBlock) -> SampleBlock:
    """Return what was sent with temperature and rest estimated, as imumon's bias takes it."""
    for stage in (TemperatureRate(), RestDetector()):
        samples = samples.with_columns(stage.process(samples))
    return samples


def simulate(scenario: Scenario, seed: int) -> Run:
    """Return a run of a scenario, with temperature and rest estimated."""
    samples, truth = SimulatedUnit(scenario, seed).run(scenario.samples)
    samples = with_rests(samples)
    rest = truth["at_rest"] == 1
    rate = np.column_stack([truth[f"rate_{axis}"] for axis in "xyz"])
    last = np.maximum.accumulate(np.where(rest, np.arange(len(rest)), 0))
    bias = np.column_stack([truth[f"gyro_bias_{axis}"] for axis in "xyz"])
    return Run(scenario, samples, bias, rate[last], samples["device_time_ns"] * 1e-9, rest)


def averaging(run: Run) -> FloatArray:
    """Return the mean rate of each rest, from its third second on, held until the next has lasted as long.

    Rests are those that `RestDetector` finds.
    """
    at_rest = run.samples["at_rest"] == 1
    gyro, result = matrix(run.samples, "gyro"), np.full((len(at_rest), 3), np.nan)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_rest.view(np.int8), [0]])))
    least = int(LEAST_MEAN_S * run.scenario.rate_hz)
    known = np.zeros(len(at_rest), np.int64)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        means = np.cumsum(gyro[begin:end], 0) / np.arange(1, end - begin + 1)[:, np.newaxis]
        result[begin + least : end] = means[least:]
        known[begin + least : end] = np.arange(begin + least, end)
    return result[np.maximum.accumulate(known)]


def fusion(**settings: float) -> Method:
    """Return imufusion's `Bias` with a threshold, deg/s, and a period, s; it takes and returns deg/s."""

    def method(run: Run) -> FloatArray:
        bias = imufusion.Bias()
        chosen = settings["threshold"], settings["period"]
        bias.set_settings(imufusion.BiasSettings(run.scenario.rate_hz, *chosen))
        result = np.empty((len(run.time_s), 3))
        for i, rate in enumerate(np.rad2deg(matrix(run.samples, "gyro"))):
            bias.update(rate)
            result[i] = bias.get_offset()
        return np.deg2rad(result)

    return method


def vqf(**settings: float) -> Method:
    """Return VQF's bias with these of its settings."""

    def method(run: Run) -> FloatArray:
        filter_ = VQF(1.0 / run.scenario.rate_hz, **settings)
        state = filter_.updateBatchFullState(matrix(run.samples, "gyro"), matrix(run.samples, "accel"))
        return np.asarray(state["bias"], np.float64)

    return method


def grid(make: Callable[..., Method], **choices: Sequence[float]) -> dict[str, Method]:
    """Return a method with each combination of settings, by their text."""
    every = [dict(zip(choices, values, strict=True)) for values in product(*choices.values())]
    return {", ".join(f"{name} {value}" for name, value in one.items()): make(**one) for one in every}


FUSION_GRID = grid(fusion, threshold=(0.3, 1.0, 3.0), period=(0.25, 1.0, 3.0))
VQF_GRID = grid(
    vqf,
    restThGyr=(0.3, 2.0),
    restMinT=(0.5, 1.5),
    biasForgettingTime=(10.0, 100.0, 1000.0),
    biasSigmaRest=(0.01, 0.03),
    motionBiasEstEnabled=(True, False),
)
DEFAULTS = {
    "imufusion Bias, its defaults": fusion(threshold=3.0, period=3.0),
    "VQF, its defaults": vqf(),
}


def imumon(mode: Mode, model: BiasModel | None, knows_place: bool) -> Method:
    """Return imumon's bias; with latitude and heading the earth rate is not in it, and is added here."""

    def method(run: Run) -> FloatArray:
        latitude = run.scenario.latitude_deg if knows_place else None
        heading = run.scenario.attitude.heading_deg if knows_place else None
        stage = GyroBias(GyroBiasParameters(), model, mode, latitude, heading)
        parts = [
            matrix(SampleBlock(stage.process(run.samples.rows(begin, begin + BLOCK))), "gyro_bias")
            for begin in range(0, len(run.time_s), BLOCK)
        ]
        bias = np.concatenate(parts)
        return bias + run.earth if knows_place else bias

    return method
