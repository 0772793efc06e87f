"""Errors of gyro bias estimators on a warm-up with rests, and on a unit that temperature does not touch."""

from __future__ import annotations

import argparse
import sys
import time
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

from imumon.blocks import FloatArray, SampleBlock
from imumon.lab.calibration.calibration import calibrate
from imumon.lab.calibration.record import record_of
from imumon.models.model import BiasModel
from imumon.simulation.unit.scenario import Chamber, Scenario, Step, load_scenario
from imumon.simulation.unit.unit import SimulatedUnit

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
    unit = SimulatedUnit(scenario, SOAK_SEED)

    def blocks() -> Iterator[SampleBlock]:
        left = scenario.samples
        while left > 0:
            yield unit.run(min(left, 50_000))[0]
            left -= 50_000

    record = record_of(blocks(), "soak", "0" * 64, axes=scenario.axes)
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


def methods(scenario: str, model: BiasModel) -> dict[str, Method]:
    """Return the competitors for a scenario."""
    run = simulate(scenario_of(scenario), TUNING_SEED)
    tuned_fusion, tuned_vqf = best(FUSION_GRID, run), best(VQF_GRID, run)
    print(f"Tuned: imufusion {tuned_fusion}; VQF {tuned_vqf}\n", flush=True)
    entered: dict[str, Method] = {
        "mean of each rest": averaging,
        **DEFAULTS,
        "imufusion Bias, tuned": FUSION_GRID[tuned_fusion],
        "VQF, tuned": VQF_GRID[tuned_vqf],
        "imumon standard, place unknown": imumon("standard", None, False),
        "imumon standard": imumon("standard", None, True),
        "imumon learned": imumon("learned", None, True),
    }
    if scenario != ATHERMAL:
        entered["imumon standard, model"] = imumon("standard", model, True)
        entered["imumon thermal"] = imumon("thermal", model, True)
        entered["imumon learned, model"] = imumon("learned", model, True)
        entered["imumon thermal, place unknown"] = imumon("thermal", model, False)
    return entered


def main() -> None:
    """Print the tables and whether the bars are met."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce/bias_race", description=__doc__)
    parser.add_argument("--seeds", type=int, default=10, help="runs of each scene (default: %(default)s)")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    given = parser.parse_args()
    seeds = given.seeds
    if given.quick:
        run = simulate(scenario_of(ATHERMAL), 0)
        print(f"imumon learned: {score(run, imumon('learned', None, True)(run))[0]:.1f} deg/h")
        return
    begun = time.monotonic()
    model = calibrated()
    print(f"Model from the soak test ({time.monotonic() - begun:.0f} s).\n", file=sys.stderr)
    results: dict[tuple[str, str], FloatArray] = {}
    for scenario, title in TITLES.items():
        print(f"## {title}\n")
        entered = methods(scenario, model)
        scores: dict[str, list[tuple[float, ...]]] = {name: [] for name in entered}
        for seed in range(seeds):
            run = simulate(scenario_of(scenario), seed)
            for name, method in entered.items():
                scores[name].append(score(run, method(run)))
        print(f"{seeds} seeds; deg/h after the third rest\n")
        print("| method | rms | worst seed | rms at the ends of rests | rms while it moves | largest |")
        print("|---|---|---|---|---|---|")
        for name, rows in scores.items():
            table = results[scenario, name] = np.array(rows)
            rms = np.sqrt((table[:, :3] ** 2).mean(0))
            numbers = f"{rms[0]:.1f} | {table[:, 0].max():.1f} | {rms[1]:.1f} | {rms[2]:.1f}"
            print(f"| {name} | {numbers} | {table[:, 3].max():.0f} |", flush=True)
        print(flush=True)
    for scenario in (WARM_UP, RAMP):
        worst = results[scenario, "imumon thermal"][:, 0].max()
        print(f"Thermal, {scenario}, worst of the seeds: {worst:.1f} deg/h (bar {BAR_DEG_PER_H:.0f}).")
    ratio = results[ATHERMAL, "imumon learned"][:, 0] / results[ATHERMAL, "imumon standard"][:, 0]
    print(f"Learned over standard without thermal effect: mean {ratio.mean():.3f}, ", end="")
    print(f"worst {ratio.max():.3f} (bar {BAR_RATIO}).")


if __name__ == "__main__":
    main()
