"""Gyro bias by imumon, VQF and imufusion on the same records: what a sample costs and how wrong it is."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping, Sequence
from time import perf_counter
from types import MappingProxyType

import numpy as np
from bias_race_runners import DEFAULTS, Method, Run, imumon, simulate, with_rests
from bias_race_table import ATHERMAL, RAMP, TUNING_SEED, WARM_UP, scenario_of, score, tuned, with_settings

from benchmarks.measure import Table
from benchmarks.peers import faster, named

SCENES = {WARM_UP: "self-heating", RAMP: "2 °C/min", ATHERMAL: "no thermal effect"}
SEEDS = 3
OWN = {
    "imumon, place unknown": imumon("standard", None, False),
    "imumon, place known": imumon("standard", None, True),
    "imumon learned, place known": imumon("learned", None, True),
}
FIRST = next(iter(OWN))
"""What the others are compared with: it knows what they know."""


def table(
    scenes: Sequence[str] = tuple(SCENES),
    seeds: int = SEEDS,
    tune: bool = True,
    changes: Mapping[str, float] = MappingProxyType({}),
) -> Table:
    """Measure the defaults of the others, what was best for them on another seed, and imumon.

    changes: of the scenes, for a shorter run.
    """
    costs, errors = defaultdict[str, list[float]](list), defaultdict[tuple[str, str], list[float]](list)
    for scene in scenes:
        scenario = scenario_of(scene).model_copy(update=dict(changes))
        entered = DEFAULTS | (with_settings(tuned(simulate(scenario, TUNING_SEED))) if tune else {}) | OWN
        for seed in range(seeds):
            run = simulate(scenario, seed)
            for name, method in entered.items():
                cost, error = timed(method, run, name in OWN)
                costs[name].append(cost)
                errors[name, scene].append(error)
    result = Table(
        "Gyro bias",
        ["method", "µs a sample", "faster", *(f"{SCENES[scene]}, °/h" for scene in scenes), "better"],
    )
    own_us = min(costs[FIRST])
    rms = {key: float(np.sqrt(np.mean(np.square(values)))) for key, values in errors.items()}
    for name, measured in costs.items():
        figures = [rms[name, scene] for scene in scenes]
        against = ["", ""] if name in OWN else [
            faster(min(measured), own_us), better(figures, [rms[FIRST, scene] for scene in scenes])
        ]  # fmt: skip
        row = [
            name,
            f"{min(measured):.2f}",
            against[0],
            *(f"{figure:.1f}" for figure in figures),
            against[1],
        ]
        result.rows.append(row)
    versions = ", ".join(filter(None, map(named, ("vqf", "imufusion"))))
    result.notes.append(
        f"{versions}. The records of [the bias race](../bias-race.md), {seeds} seeds each: rms error after "
        "the third rest; the best time of all records. The others are given rates and specific forces, and "
        "have no sigma; VQF gives an attitude as well. imumon is given the temperature too; its time holds "
        "its temperature rate, its rest detector, and the bias with its sigma. "
        f"*Faster* and *better* are against “{FIRST}”."
    )
    return result


def timed(method: Method, run: Run, own: bool) -> tuple[float, float]:
    """Return the µs that a sample costs and the rms error in deg/h; imumon's pays for finding its rests."""
    begun = perf_counter()
    if own:
        with_rests(run.samples)
    estimate = method(run)
    return (perf_counter() - begun) / len(run.time_s) * 1e6, score(run, estimate)[0]


def better(other: list[float], imumon: list[float]) -> str:
    """Return in how many of the scenes the other has the smaller error, and by how much at most."""
    ratios = [mine / theirs for theirs, mine in zip(other, imumon, strict=True)]
    ahead = [ratio for ratio in ratios if ratio > 1.0]
    if not ahead:
        return f"imumon, by {1.0 / max(ratios):.2f} to {1.0 / min(ratios):.2f} ×"
    return f"**the other in {len(ahead)} of {len(ratios)}, by up to {max(ahead):.2f} ×**"
