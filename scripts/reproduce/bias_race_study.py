"""Errors of gyro bias estimators on a warm-up with rests, and on a unit that temperature does not touch.

Each competitor takes a run and returns its bias estimate at every sample, rad/s, (n, 3).
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import product

import imufusion
import numpy as np
from samples import Record, play
from study import Options, Study, Table, largest, matrix, rms
from thermal_calibration_study import simulated_soak
from vqf import VQF

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import Mode, RestAndBias, RestDetector
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.lab.calibration.calibration import calibrate
from imumon.models.model import BiasModel
from imumon.simulation.unit.scenario import Chamber, Scenario, Step, load_scenario

LEAST_MEAN_S = 3.0
Method = Callable[[Record], FloatArray]


def averaging(run: Record) -> FloatArray:
    """Return the mean rate of each rest, from its third second on, held until the next has lasted as long.

    Rests are those that `RestDetector` finds.
    """
    at_rest = run.samples["at_rest"] == 1
    gyro, result = matrix(run.samples, "gyro"), np.full((len(at_rest), 3), np.nan)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], at_rest.view(np.int8), [0]])))
    least = int(LEAST_MEAN_S * run.rate_hz)
    known = np.zeros(len(at_rest), np.int64)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        means = np.cumsum(gyro[begin:end], 0) / np.arange(1, end - begin + 1)[:, np.newaxis]
        result[begin + least : end] = means[least:]
        known[begin + least : end] = np.arange(begin + least, end)
    return result[np.maximum.accumulate(known)]


def fusion(**settings: float) -> Method:
    """Return imufusion's `Bias` with a threshold, deg/s, and a period, s; it takes and returns deg/s."""

    def method(run: Record) -> FloatArray:
        bias = imufusion.Bias()
        chosen = settings["threshold"], settings["period"]
        bias.set_settings(imufusion.BiasSettings(run.rate_hz, *chosen))
        result = np.empty((len(run.time_s), 3))
        for i, rate in enumerate(np.rad2deg(matrix(run.samples, "gyro"))):
            bias.update(rate)
            result[i] = bias.get_offset()
        return np.deg2rad(result)

    return method


def vqf(**settings: float) -> Method:
    """Return VQF's bias with these of its settings."""

    def method(run: Record) -> FloatArray:
        filter_ = VQF(1.0 / run.rate_hz, **settings)
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
WARM_UP, RAMP, ATHERMAL = "warm-up", "ramp", "warm-up-athermal"
_SCENARIO = load_scenario(WARM_UP)
PLACE = _SCENARIO.latitude_deg, _SCENARIO.attitude.heading_deg
"""Latitude and heading of all three."""


def imumon(mode: Mode, model: BiasModel | None, knows_place: bool) -> Method:
    """Return imumon's bias; with latitude and heading the earth rate is not in it, and is added here."""

    def method(run: Record) -> FloatArray:
        stage = RestAndBias(
            GyroBiasParameters(assume_at_rest=True), model, mode, *(PLACE if knows_place else (None, None))
        )
        bias = matrix(SampleBlock(stage.process(run.samples)), "gyro_bias")
        return bias + run.earth if knows_place else bias

    return method


TITLES = {
    WARM_UP: "Self-heating from 25 to 45 °C with a time constant of 400 s",
    RAMP: "25 to 45 °C at a steady 2 °C/min",
    ATHERMAL: "Without thermal effect",
}
THIRD_REST_ENDS_S = 250.0
TUNING_SEED = 1000
SOAK_SEED = 2000
QUICK = {"rate_hz": 20.0, "duration_s": 380.0}
"""Three rests and one that counts."""
BAR_DEG_PER_H, BAR_RATIO = 10.0, 1.1


def scenario_of(name: str) -> Scenario:
    """Return one of the scenarios; the ramp is the warm-up with its temperature rising evenly."""
    if name != RAMP:
        return load_scenario(name)
    chamber = Chamber(start_degc=25.0, steps=[Step(to_degc=45.0, rate_degc_per_min=2.0)])
    unit = _SCENARIO.unit.model_copy(update={"self_heating": None})
    return _SCENARIO.model_copy(update={"unit": unit, "chamber": chamber, "duration_s": 600.0})


def calibrated() -> BiasModel:
    """Return the model that `imumon calibrate` makes of the soak test of the same unit, with other noise."""
    scenario = load_scenario("crs05-soak")
    record = simulated_soak(SOAK_SEED).record
    return calibrate([record], scenario.latitude_deg, scenario.attitude.heading_deg).model


def score(run: Record, estimate: FloatArray) -> tuple[float, ...]:
    """Return errors in deg/h from the end of the third rest: rms over all time and axes; rms at the last
    second of the rests; rms while it moves; the largest of an axis."""
    error = (estimate - run.bias - run.earth) / DEG_PER_H
    late = run.time_s > THIRD_REST_ENDS_S
    ends = run.rest & late & ~np.append(run.rest[100:], np.zeros(100, bool))
    return (*(rms(error[rows]) for rows in (late, ends, late & ~run.rest)), largest(error[late]))


def best(grid: Mapping[str, Method], run: Record) -> str:
    """Return the name of the settings with the least rms error: tuned on another seed."""
    errors = {name: score(run, method(run))[0] for name, method in grid.items()}
    return min(errors, key=lambda name: errors[name])


def own(model: BiasModel | None) -> dict[str, Method]:
    """Return imumon's, also with the model of a calibration where there is one."""
    found = {
        "imumon standard, place unknown": imumon("standard", None, False),
        "imumon standard": imumon("standard", None, True),
        "imumon learned": imumon("learned", None, True),
    }
    if model is not None:
        found["imumon standard, model"] = imumon("standard", model, True)
        found["imumon thermal"] = imumon("thermal", model, True)
        found["imumon learned, model"] = imumon("learned", model, True)
        found["imumon thermal, place unknown"] = imumon("thermal", model, False)
    return found


HEADS = ("method", "rms", "worst seed", "rms at the ends of rests", "rms while it moves", "largest")
FORMATS = ("", ".1f", ".1f", ".1f", ".1f", ".0f")


def tables(given: Options) -> Iterator[Table]:
    """Yield a table for each scenario, and whether the bars are met."""
    model = None if given.quick else calibrated()
    rms_of: dict[tuple[str, str], FloatArray] = {}
    for scenario, title in TITLES.items():
        if given.quick and scenario != ATHERMAL:
            continue
        played = scenario_of(scenario).model_copy(update=QUICK if given.quick else {})
        entered: dict[str, Method] = {"mean of each rest": averaging, **DEFAULTS}
        if model is not None:
            run = play(played, TUNING_SEED, (TemperatureRate(), RestDetector()))
            fusion_name, vqf_name = best(FUSION_GRID, run), best(VQF_GRID, run)
            title += f"\n\nTuned: imufusion {fusion_name}; VQF {vqf_name}"
            entered["imufusion Bias, tuned"] = FUSION_GRID[fusion_name]
            entered["VQF, tuned"] = VQF_GRID[vqf_name]
        entered |= own(None if scenario == ATHERMAL else model)
        scores: dict[str, list[tuple[float, ...]]] = {name: [] for name in entered}
        for seed in given.seeds:
            run = play(played, seed, (TemperatureRate(), RestDetector()))
            for name, method in entered.items():
                scores[name].append(score(run, method(run)))
        rows = []
        for name, found in scores.items():
            table = np.array(found)
            rms_of[scenario, name] = table[:, 0]
            whole, ends, moving = np.sqrt((table[:, :3] ** 2).mean(0))
            rows.append([name, whole, table[:, 0].max(), ends, moving, table[:, 3].max()])
        title = f"### {title}\n\n{len(given.seeds)} seeds; deg/h after the third rest"
        yield Table(title, HEADS, rows, formats=FORMATS)
    lines = [
        f"Thermal, {scenario}, worst of the seeds: {found.max():.1f} deg/h (bar {BAR_DEG_PER_H:.0f})."
        for (scenario, name), found in rms_of.items()
        if name == "imumon thermal"
    ]
    ratio = rms_of[ATHERMAL, "imumon learned"] / rms_of[ATHERMAL, "imumon standard"]
    means = f"mean {ratio.mean():.3f}, worst {ratio.max():.3f} (bar {BAR_RATIO})"
    yield Table("", (), (), "\n".join([*lines, f"Learned over standard without thermal effect: {means}."]))


STUDY = Study(tables, seeds=10, page="appendix/bias-race-results.md")
