"""The alignment on a real site beside plain and Hann-weighted mean of the gyros: errors and sigmas."""

import math
from collections.abc import Iterator

import numpy as np
from alignment_site_scenes import ACCEL_BIAS_UG, CREEPS, SCENES, Scene, mean_heading, record
from study import Cell, Cells, Options, Study, Table, largest, worst_first
from study import rms as rms

from imumon.blocks import FloatArray
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment

AT_S = (20, 60, 600)
FROM_S = 60
"""From then on a heading must be shown, and as good as that of the means."""
RATIO, RMS_Z, MAX_Z, SHOWN = 1.5, 1.8, 5.0, 0.9
"""Bars: error over that of the better mean, error over sigma, and how often there must be a heading."""


def outcome(scene: Scene, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return error, sigma, error of the plain and of the Hann mean, degrees, at each time, (3, 4), and all z.

    These are the ratios of error and sigma once in a second, NaN where nothing is shown.
    """
    rec = record(scene, max(AT_S) + 1.0, seed)
    parameters = AlignmentParameters.model_validate({"accel_bias_sd_ug": ACCEL_BIAS_UG, **scene.parameters})
    stage = Alignment(parameters, scene.latitude_deg, None if scene.any_attitude else "FRD")
    out = stage.process(rec.block)
    # What is shown with a sample is that of the slots that ended before it.
    truth = np.concatenate([rec.heading[:1], rec.heading[:-1]])
    off = np.remainder(out["heading"] - truth + math.pi, 2.0 * math.pi) - math.pi
    rows = []
    for second in AT_S:
        n = round(second * scene.rate_hz)
        means = [mean_heading(rec.level_rate[:n], weights) for weights in (np.ones, np.hanning)]
        by_means = [math.remainder(mean - rec.heading[n], 2.0 * math.pi) for mean in means]
        rows.append([off[n], out["heading_sd"][n], *by_means])
    return np.degrees(rows), (off / out["heading_sd"])[:: round(scene.rate_hz)]


NAMES = ("rms error °", "over the better mean", "σ", "shown", "rms z", "max z")
HEADS = (*(f"{name}, {second} s" for second in AT_S for name in NAMES), "max z, any second", "beyond 5 σ")
FORMATS = ("", *(".4f", ".2f", ".4f", "", ".2f", ".1f") * len(AT_S), ".1f", "")


def row(scene: Scene, seeds: range) -> tuple[float, Cells]:
    """Return by how much a scene is worse than the bars, and its row of the table."""
    outcomes = [outcome(scene, seed) for seed in seeds]
    found, always = np.array([rows for rows, _ in outcomes]), np.array([z for _, z in outcomes])
    cells: list[Cell] = [scene.name]
    past = []
    for k, second in enumerate(AT_S):
        error, sd, plain, hann = found[:, k].T
        shown, z = float(np.isfinite(error).mean()), error / sd
        ratio = rms(error) / min(rms(plain), rms(hann))
        past += [rms(z) / RMS_Z, largest(z) / MAX_Z]
        if second >= FROM_S:
            past += [ratio / RATIO, SHOWN / max(shown, 0.01)]
        cells += [rms(error), ratio, float(np.median(sd)), f"{100 * shown:.0f} %", rms(z), largest(z)]
    known = always[np.isfinite(always)]
    beyond = float(np.mean(np.abs(known) > MAX_Z)) if len(known) else 0.0
    return float(np.nanmax(past)), [*cells, largest(known), f"{100 * beyond:.1f} %"]


def tables(given: Options) -> Iterator[Table]:
    """Yield the tables, the worst row first."""
    for title, scenes in (("site", SCENES), ("creep about the vertical", CREEPS)):
        chosen = [scene for scene in scenes if given.only in scene.name][: 1 if given.quick else None]
        if chosen:
            rows = worst_first(row(scene, given.seeds) for scene in chosen)
            yield Table("", [title, *HEADS], rows, formats=FORMATS)


STUDY = Study(tables, seeds=10)
