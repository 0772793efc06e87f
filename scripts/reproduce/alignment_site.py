"""The alignment on a real site beside plain and Hann-weighted mean of the gyros: errors and sigmas."""

from __future__ import annotations

import argparse
import math

import numpy as np
from alignment_runs import ACCEL_BIAS_UG
from alignment_site_scenes import CREEPS, SCENES, Scene, mean_heading, record

from imumon.blocks import FloatArray
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment

AT_S = (20, 60, 600)
FROM_S = 60
"""From then on a heading must be shown, and as good as that of the means."""
RATIO, RMS_Z, MAX_Z, SHOWN = 1.5, 1.8, 5.0, 0.9
"""Bars: error over that of the better mean, error over sigma, and how often there must be a heading."""


def off_deg(heading: float, truth: float) -> float:
    """Return the difference of two headings in rad, as degrees."""
    return math.degrees(math.remainder(heading - truth, 2.0 * math.pi))


def rms(values: FloatArray) -> float:
    """Return the root of the mean square of what is known."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


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
        found = math.degrees(off[n]), math.degrees(out["heading_sd"][n])
        rows.append([*found, *(off_deg(mean, rec.heading[n]) for mean in means)])
    return np.array(rows), (off / out["heading_sd"])[:: round(scene.rate_hz)]


def row(scene: Scene, seeds: range) -> tuple[float, str]:
    """Return by how much a scene is worse than the bars, and its row of the table."""
    outcomes = [outcome(scene, seed) for seed in seeds]
    found, always = np.array([rows for rows, _ in outcomes]), np.abs([z for _, z in outcomes])
    cells, worse = [scene.name], 0.0
    for k, second in enumerate(AT_S):
        error, sd, plain, hann = found[:, k].T
        shown = np.isfinite(error)
        z = error / sd
        ratio = rms(error) / min(rms(plain), rms(hann))
        largest = float(np.abs(z[shown]).max()) if shown.any() else math.nan
        past = [rms(z) / RMS_Z, largest / MAX_Z]
        if second >= FROM_S:
            past += [ratio / RATIO, SHOWN / max(float(shown.mean()), 0.01)]
        worse = max([worse, *(value for value in past if math.isfinite(value))])
        cells += [
            f"{rms(error):.4f}", f"{ratio:.2f}", f"{np.median(sd):.4f}", f"{100 * shown.mean():.0f} %",
            f"{rms(z):.2f}", f"{largest:.1f}",
        ]  # fmt: skip
    known = always[np.isfinite(always)]
    largest, lies = (float(known.max()), float(np.mean(known > MAX_Z))) if len(known) else (math.nan, 0.0)
    return worse, f"| {' | '.join(cells)} | {largest:.1f} | {100 * lies:.1f} % |"


def main() -> None:
    """Print the tables, the worst row first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="?", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", default="", help="part of a scene's name")
    given = parser.parse_args()
    names = ["rms error °", "over the better mean", "σ", "shown", "rms z", "max z"]
    heads = [f"{name}, {second} s" for second in AT_S for name in names]
    seeds = range(given.first, given.first + given.runs)
    for title, scenes in (("site", SCENES), ("creep about the vertical", CREEPS)):
        rows = [row(scene, seeds) for scene in scenes if given.only in scene.name]
        if rows:
            print(f"| {title} | {' | '.join(heads)} | max z, any second | beyond 5 σ |")
            print("|---" * (3 + len(heads)) + "|")
            print("\n".join(text for _, text in sorted(rows, reverse=True)), flush=True)


if __name__ == "__main__":
    main()
