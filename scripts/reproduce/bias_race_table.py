"""Errors of gyro bias estimators on a warm-up with rests, and on a unit that temperature does not touch."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import numpy.typing as npt
from bias_race_runners import (
    DEFAULTS,
    DEG_PER_H,
    FUSION_GRID,
    VQF_GRID,
    Method,
    Run,
    averaging,
    imumon,
    simulate,
)
from study import Options, Study, Table
from thermal_calibration_study import simulated_soak

from imumon.blocks import FloatArray
from imumon.lab.calibration.calibration import calibrate
from imumon.models.model import BiasModel
from imumon.simulation.unit.scenario import Chamber, Scenario, Step, load_scenario

WARM_UP, RAMP, ATHERMAL = "warm-up", "ramp", "warm-up-athermal"
TITLES = {
    WARM_UP: "Self-heating from 25 to 45 °C with a time constant of 400 s",
    RAMP: "25 to 45 °C at a steady 2 °C/min",
    ATHERMAL: "Without thermal effect",
}
THIRD_REST_ENDS_S = 250.0
TUNING_SEED = 1000
SOAK_SEED = 2000
BAR_DEG_PER_H, BAR_RATIO = 10.0, 1.1


def scenario_of(name: str) -> Scenario:
    """Return one of the scenarios; the ramp is the warm-up with its temperature rising evenly."""
    if name != RAMP:
        return load_scenario(name)
    base = load_scenario(WARM_UP)
    chamber = Chamber(start_degc=25.0, steps=[Step(to_degc=45.0, rate_degc_per_min=2.0)])
    unit = base.unit.model_copy(update={"self_heating": None})
    return base.model_copy(update={"unit": unit, "chamber": chamber, "duration_s": 600.0})


def calibrated() -> BiasModel:
    """Return the model that `imumon calibrate` makes of the soak test of the same unit, with other noise."""
    scenario = load_scenario("crs05-soak")
    record = simulated_soak(SOAK_SEED).record
    return calibrate([record], scenario.latitude_deg, scenario.attitude.heading_deg).model


def score(run: Run, estimate: FloatArray) -> tuple[float, float, float, float]:
    """Return errors in deg/h from the end of the third rest: rms over all time and axes; rms at the last
    second of the rests; rms while it moves; the largest of an axis."""
    error = (estimate - run.bias - run.earth) / DEG_PER_H
    late = run.time_s > THIRD_REST_ENDS_S
    rest = run.rest & late
    soon = np.append(run.rest[100:], np.zeros(100, bool))
    ends = rest & ~soon

    def rms(rows: npt.NDArray[np.bool_]) -> float:
        return float(np.sqrt(np.mean(error[rows] ** 2)))

    return rms(late), rms(ends), rms(late & ~run.rest), float(np.abs(error[late]).max())


def best(grid: Mapping[str, Method], run: Run) -> str:
    """Return the name of the settings with the least rms error: tuned on another seed."""
    errors = {name: score(run, method(run))[0] for name, method in grid.items()}
    return min(errors, key=lambda name: errors[name])


def tuned(run: Run) -> dict[str, str]:
    """Return the settings of the others with the least error in a run."""
    return {"imufusion": best(FUSION_GRID, run), "VQF": best(VQF_GRID, run)}


def with_settings(names: Mapping[str, str]) -> dict[str, Method]:
    """Return the others with settings that `tuned` has found."""
    return {
        "imufusion Bias, tuned": FUSION_GRID[names["imufusion"]],
        "VQF, tuned": VQF_GRID[names["VQF"]],
    }


OWN = {
    "imumon standard, place unknown": imumon("standard", None, False),
    "imumon standard": imumon("standard", None, True),
    "imumon learned": imumon("learned", None, True),
}


def with_model(model: BiasModel) -> dict[str, Method]:
    """Return imumon's with the model of a calibration."""
    return {
        "imumon standard, model": imumon("standard", model, True),
        "imumon thermal": imumon("thermal", model, True),
        "imumon learned, model": imumon("learned", model, True),
        "imumon thermal, place unknown": imumon("thermal", model, False),
    }


HEADS = ("method", "rms", "worst seed", "rms at the ends of rests", "rms while it moves", "largest")
FORMATS = ("", ".1f", ".1f", ".1f", ".1f", ".0f")


def tables(given: Options) -> Iterator[Table]:
    """Yield a table for each scenario, and whether the bars are met."""
    model = None if given.quick else calibrated()
    rms_of: dict[tuple[str, str], FloatArray] = {}
    for scenario, title in TITLES.items():
        if given.quick and scenario != ATHERMAL:
            continue
        entered: dict[str, Method] = {"mean of each rest": averaging, **DEFAULTS}
        if model is not None:
            names = tuned(simulate(scenario_of(scenario), TUNING_SEED))
            title += f"\n\nTuned: imufusion {names['imufusion']}; VQF {names['VQF']}"
            entered |= with_settings(names)
        entered |= OWN
        if model is not None and scenario != ATHERMAL:
            entered |= with_model(model)
        scores: dict[str, list[tuple[float, ...]]] = {name: [] for name in entered}
        for seed in given.seeds:
            run = simulate(scenario_of(scenario), seed)
            for name, method in entered.items():
                scores[name].append(score(run, method(run)))
        rows = []
        for name, found in scores.items():
            table = np.array(found)
            rms_of[scenario, name] = table[:, 0]
            whole, ends, moving = np.sqrt((table[:, :3] ** 2).mean(0))
            rows.append([name, whole, table[:, 0].max(), ends, moving, table[:, 3].max()])
        yield Table(
            f"### {title}\n\n{len(given.seeds)} seeds; deg/h after the third rest",
            HEADS,
            rows,
            formats=FORMATS,
        )
    lines = [
        f"Thermal, {scenario}, worst of the seeds: {found.max():.1f} deg/h (bar {BAR_DEG_PER_H:.0f})."
        for (scenario, name), found in rms_of.items()
        if name == "imumon thermal"
    ]
    ratio = rms_of[ATHERMAL, "imumon learned"] / rms_of[ATHERMAL, "imumon standard"]
    means = f"mean {ratio.mean():.3f}, worst {ratio.max():.3f} (bar {BAR_RATIO})"
    yield Table("", (), (), "\n".join([*lines, f"Learned over standard without thermal effect: {means}."]))


STUDY = Study(tables, seeds=10, page="bias-race.md")
