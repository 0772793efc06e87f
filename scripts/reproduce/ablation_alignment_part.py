"""Ablations of the alignment: some sites of `alignment_site`."""

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import alignment_site
import numpy as np
from ablations import Change, Outcome, ablation, changed
from alignment_site_scenes import CREEPS, SCENES, Record, Scene
from alignment_site_scenes import record as record_of
from study import rms

from imumon.blocks import FloatArray
from imumon.estimation.alignment import aligner, fit, posterior
from imumon.estimation.alignment.parameters import ANY_WARM_UP
from imumon.estimation.alignment.position import PositionFit


def _best(*given: Any) -> PositionFit | None:
    """Return the fit of a position by its most likely hypothesis alone."""
    found = fit.fit_position(*given)
    if found is None:
        return None
    best = [int(np.argmax(found.log_weight))]
    return found._replace(
        log_weight=found.log_weight[best], rate=found.rate[best], variance=found.variance[best]
    )


def _tilts(neighbours: int) -> FloatArray:
    """Return the sizes of the exponentials of tripods that settle by some neighbouring ones of one size."""
    k = np.arange(len(fit.TILT_TAU_S))
    first = np.arange(len(k) - neighbours + 1)[:, None]
    chosen = (k >= first) & (k < first + neighbours)
    return np.concatenate([sd * chosen for sd in fit.TILT_SD])


VARIANTS: Mapping[str, Change] = {
    "cells: 48 alone": [(fit, "CELLS", (48,))],
    "cells: also 48 and 12": [(fit, "CELLS", (96, 48, 24, 12, 6))],
    "rejection of knocks": [(fit, "KNOCK", 1e9)],
    "sway": [(fit, "LEFT_SHARE", -1.0)],
    "sway with fewer than 5 periods": [(fit, "MIN_PERIODS", 5.0)],
    "the record of a creep is halved": [(fit, "CREEP_ANGLE", math.inf)],
    "warm-up": [(fit, "ANY_WARM_UP", (0.0, ANY_WARM_UP[1]))],
    "settling": [(fit, "P_TILTS", 1e-9)],
    "settling: one exponential": [(fit, "TILTS", _tilts(1))],
    "settling: all exponentials": [(fit, "TILTS", _tilts(8))],
    "settling: prior of 0.03": [(fit, "P_TILTS", 0.03)],
    "averaging: the best hypothesis": [(aligner, "fit_position", _best)],
    "gyros worse than the others": [(posterior, "P_WORSE", 1e-12)],
    "sigma of a heading that moves from fit to fit": [(aligner, "RECENT_SHARE", 0.0)],
}
"""What is left out or set otherwise."""


def _knock(t: FloatArray, rng: np.random.Generator) -> FloatArray:  # noqa: ARG001 - as all tilts
    return np.asarray(np.outer(np.clip(2.0 * (t - 40.0), 0.0, 1.0), [1e-4, 1e-4]))


KNOCKED = Scene("a knock that leaves 100 µrad, at 40 s", ((_knock,),))
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
    KNOCKED.name,
    "accelerometers that jump by 30 µg",
    "bias of 0.05 °/h, not declared",
    "bias of 3 °/h of the gyro that points east",
    "3° in 200 s",
    "3° in 200 s, biases of 0.5 °/h",
    "3° in 280 s, half a turn, 3° in 280 s, biases of 2 °/h",
)


TITLE = (
    "Alignment, ° at 20, 60 and 600 s on simulated sites; a heading that is not shown is as wrong as its "
    "sigma, and by 5° at the most."
)
HIDDEN_DEG, FLOOR_DEG = 5.0, 0.005
_RECORDS: dict[tuple[str, int], Record] = {}


def _recorded(scene: Scene, seconds: float, seed: int) -> Record:
    """Return the record of a scene, made once."""
    if (scene.name, seed) not in _RECORDS:
        _RECORDS[scene.name, seed] = record_of(scene, seconds, seed)
    return _RECORDS[scene.name, seed]


def outcomes(seeds: range, data: Path) -> Iterator[Outcome]:
    """Yield the outcome of every scene and time; there are no measured data."""
    del data
    scenes = {scene.name: scene for scene in (*SCENES, *CREEPS, KNOCKED)}
    for name in CHOSEN:
        with changed([(alignment_site, "record", _recorded)]):
            found = np.array([alignment_site.outcome(scenes[name], seed)[0] for seed in seeds])
        for k, second in enumerate(alignment_site.AT_S):
            error, sd = found[:, k, :2].T
            wrong = np.where(np.isfinite(error), error, np.fmin(sd, HIDDEN_DEG))
            ratio = (error / sd)[np.isfinite(error)]
            z, largest = float(np.nan_to_num(rms(ratio))), float(np.abs(ratio).max(initial=0.0))
            yield Outcome(f"{name}, {second} s", rms(wrong), FLOOR_DEG, z, largest)


STUDY = ablation(TITLE, VARIANTS, outcomes)
