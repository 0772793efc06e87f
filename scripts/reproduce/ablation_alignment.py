"""What each mechanism of the alignment is worth: sites of `alignment_site` without it."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any
from unittest.mock import patch

import numpy as np
from alignment_site import AT_S, outcome
from alignment_site_scenes import CREEPS, SCENES

from imumon.blocks import FloatArray
from imumon.estimation.alignment import aligner, cells, hypotheses, posterior, prior, record, sway

VARIANTS: Mapping[str, Sequence[tuple[Any, str, Any]]] = {
    "cells: 48 alone": [(cells, "CELLS", (48,))],
    "guard of smoother cells": [(cells, "UNSURE", 1.0)],
    "robust weights": [(cells, "HUBER", 1e9), (cells, "OUTLYING", 1e9)],
    "sways": [(sway, "LINES", 0)],
    "knocks of the accelerometers": [(record, "KNOCK", math.inf)],
    "creep about the vertical": [(cells, "CREEPS", math.inf)],
    "warm-up": [(aligner, "DRIFTS", (hypotheses.Drift(1.0, 1e-7, 0.0),))],
    "jump of an accelerometer": [(aligner, "DRIFTS", hypotheses.DRIFTS[:2])],
    "settling": [(hypotheses, "P_SETTLES", 1e-9)],
    "settling: one exponential": [(hypotheses, "NEIGHBOURS", 1)],
    "settling: prior of 0.3": [(hypotheses, "P_SETTLES", 0.3)],
    "tempering": [(hypotheses, "TEMPER", 1.0)],
    "averaging: the best hypothesis": [(posterior, "LIKELY", -1e-9)],
    "one gyro worse than the others": [(prior, "P_SOME_WORSE", 1e-12)],
    "all gyros worse than their class": [(prior, "P_ALL_WORSE", 1e-12)],
}
"""What is left out: constants and what they are instead."""
CHOSEN = (
    "quiet",
    "warm-up 83.7 µg, 150 s",
    "sway 200 µrad at 0.07 Hz",
    "sway 200 µrad at 0.05 Hz",
    "wind, 20 µrad at 0.25 Hz",
    "footsteps of 20 µrad every 3 s",
    "settling 50 µrad, 60 s",
    "settling 200 µrad, 20 s, warm-up",
    "sway, footsteps, settling 50 µrad, warm-up",
    "a door slams, 100 µrad, at 30 s",
    "accelerometers that jump by 30 µg",
    "bias of 0.05 °/h, not declared",
    "bias of 3 °/h of the gyro that points east",
    "3° in 200 s",
    "3° in 280 s, half a turn, 3° in 280 s, biases of 2 °/h",
)


@dataclass(frozen=True, slots=True)
class Found:
    """Rms error, degrees, and rms of error over sigma of each scene and time, (scenes, times)."""

    error: FloatArray
    ratio: FloatArray


def found(seeds: range, without: Sequence[tuple[Any, str, Any]] = ()) -> Found:
    """Return what the alignment makes of the chosen sites, with constants replaced."""
    scenes = {scene.name: scene for scene in (*SCENES, *CREEPS)}
    with ExitStack() as stack:
        for module, name, value in without:
            stack.enter_context(patch.object(module, name, value))
        rows = np.array([[outcome(scenes[name], seed)[0] for seed in seeds] for name in CHOSEN])
    error, sd = rows[..., 0], rows[..., 1]
    # A heading that is not shown is as wrong as its sigma, for the comparison of errors.
    wrong = np.where(np.isfinite(error), error, np.minimum(sd, 5.0))
    with np.errstate(invalid="ignore"):
        ratio = np.sqrt(np.nanmean((error / sd) ** 2, axis=1)) if np.isfinite(error).any() else error[:, 0]
    return Found(np.sqrt(np.nanmean(wrong**2, axis=1)), ratio)


def rows(seeds: range) -> Iterator[tuple[str, ...]]:
    """Yield what is left out, the error against the whole, the worst scene, and how honest sigma is."""
    whole = found(seeds)
    yield "nothing", "1.00", "", *_honesty(whole)
    for name, without in VARIANTS.items():
        one = found(seeds, without)
        times = one.error / whole.error
        scene, at = np.unravel_index(np.argmax(np.nan_to_num(times)), times.shape)
        worst = f"{CHOSEN[scene]}, {AT_S[at]} s: x {times[scene, at]:.1f}"
        yield name, f"{math.exp(float(np.nanmean(np.log(times)))):.2f}", worst, *_honesty(one)


def _honesty(one: Found) -> tuple[str, str]:
    known = one.ratio[np.isfinite(one.ratio)]
    return f"{np.sqrt(np.mean(known**2)):.2f}", f"{np.sum(known > 1.8)} of {len(known)}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=400)
    given = parser.parse_args()
    heads = ["left out", "error, times", "worst", "rms error/σ", "rms above 1.8"]
    print("| " + " | ".join(heads) + " |\n" + "|---" * len(heads) + "|", flush=True)
    for row in rows(range(given.first, given.first + given.seeds)):
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
