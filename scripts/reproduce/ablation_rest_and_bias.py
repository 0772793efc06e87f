"""What each mechanism of rest and gyro bias is worth: the same records with it left out.

Errors are of the bias at the ends of rests, before the next and in motion of units in hands, and in steady
turns.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import ExitStack
from functools import partial
from typing import NamedTuple
from unittest.mock import patch

import numpy as np
from bias_sigma_table import CASES, estimated, places
from rest_detector_scenes import SENSORS, measure_with_bias, steady_turn
from rest_detector_table import TURN_RATE_HZ

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias import modes, odds, table
from imumon.estimation.gyro_bias.stage import GyroBias
from imumon.estimation.rest import detector, quiet
from imumon.estimation.rest.stage import RestDetector
from imumon.geodesy import DEG_PER_H

HANDS = ("as said above", "flicker of 27 °/h beside 0.03 °/√h", "warm-up", "sensitivity 0.1 °/s/g")
TURNS = ((0.5, 10.0, 120.0, 0.0), (0.5, 10.0, 120.0, 45.0), (0.05, 10.0, 0.5, 0.0))
GRADES = (1, 3)
"""Industrial, and as an MPU-6050."""
LEFT_OUT: dict[str, list[tuple[object, str, object]]] = {
    "nothing": [],
    "levels of flicker: only 10 s": [(modes, "FLICKER_CORNERS_S", (10.0,))],
    "the level of 0.1 s": [(modes, "FLICKER_CORNERS_S", (100.0, 10.0, 1.0))],
    "the walk": [(modes, "WALK_PRIOR", 1e-6)],
    "levels of the axes tied to the unit": [(modes, "SAME_LEVEL", 0.25)],
    "the sensitivity": [(modes, "SENSITIVITIES", modes.SENSITIVITIES[:1] * 1e-6)],
    "the small sensitivity": [(modes, "SENSITIVITIES", modes.SENSITIVITIES[1:])],
    "flicker within a slot": [(modes, "FASTEST_S", 1.0)],
    "the old law of believed": [(table, "LAG_S", 1.0)],
    "the tight return": [(table, "AGAIN", table.BEYOND)],
    "gravity against a wide law": [(table, "AGAINST", 50.0)],
    "gravity as a witness": [(odds, "OBLIQUE", 1e9)],
    "changes that end a dispute with motion": [(table, "SETTLED_S", 0.0)],
    "the floor of a suspicious mean": [(quiet, "QUIET", quiet.QUIET * 1e-3)],
}


class Scores(NamedTuple):
    """rms error in °/h and rms error over sigma, share beyond 5 sigma in %, and motion called rest in %."""

    hands: float
    turns: float
    ratio: float
    beyond: float
    false_rest: float


def scores(seeds: range) -> Scores:
    """Return what the records give with the constants as they are."""
    hands, turns, ratios, false_rest = [], [], [], []
    for seed in seeds:
        for name in HANDS:
            from bias_sigma_records import simulate

            record = simulate(CASES[name], seed)
            error, sd, _ = estimated(CASES[name], record)
            where = places(record.rest)
            at = np.concatenate([where.ends, where.before, where.motion[::50]])
            hands.append(error[at].ravel())
            ratios.append((error / sd)[at].ravel())
        for turn in TURNS:
            scene = steady_turn(TURN_RATE_HZ, *turn)
            for grade in GRADES:
                samples, truth = measure_with_bias(scene, SENSORS[grade], seed)
                for stage in (RestDetector(), GyroBias()):
                    samples = samples.with_columns(stage.process(samples))
                known = slice(round(60.0 * TURN_RATE_HZ), None, round(TURN_RATE_HZ))
                bias, sd = (
                    np.column_stack([samples[f"{name}_{axis}"] for axis in "xyz"])[known]
                    for name in ("gyro_bias", "gyro_bias_sd")
                )
                turns.append((bias - truth[known]).ravel())
                ratios.append(((bias - truth[known]) / sd).ravel())
                if turn[0] >= 0.5:
                    false_rest.append(float(samples["at_rest"][~scene.rest].mean()))
    z = np.concatenate(ratios)
    z = z[np.isfinite(z)]
    root = partial(_rms)
    return Scores(
        root(np.concatenate(hands)) / DEG_PER_H, root(np.concatenate(turns)) / DEG_PER_H, root(z),
        100.0 * float(np.mean(np.abs(z) > 5.0)), 100.0 * float(np.mean(false_rest)),
    )  # fmt: skip


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def rows(seeds: range) -> Iterator[tuple[str, Scores]]:
    """Yield what is left out, and the scores without it."""
    for name, changes in LEFT_OUT.items():
        with ExitStack() as stack:
            for module, constant, value in changes:
                stack.enter_context(patch.object(module, constant, value))
            made = modes.unknown_modes((0.0, modes.SLOPE_PER_SIGMA))
            stack.enter_context(patch.object(detector, "MODES", made))
            yield name, scores(seeds)


def main() -> None:
    """Print the table."""
    seeds = range(8300, 8300 + (int(sys.argv[1]) if len(sys.argv) > 1 else 1))
    print("| left out | hands, °/h | turns, °/h | error/σ rms | beyond 5 σ, % | turns called rest, % |")
    print("|---|---|---|---|---|---|")
    for name, found in rows(seeds):
        print(f"| {name} | " + " | ".join(f"{value:.3g}" for value in found) + " |", flush=True)


if __name__ == "__main__":
    main()
