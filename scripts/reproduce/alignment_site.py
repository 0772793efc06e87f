"""The alignment on a real site beside plain and Hann-weighted mean of the gyros: errors and sigmas."""

from __future__ import annotations

import argparse
import math

import numpy as np
from alignment_site_scenes import SCENES, Scene, mean_heading, record

from imumon.blocks import FloatArray
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment

AT_S = (20, 60, 600)
RATIO, RMS_Z, MAX_Z, SHOWN = 1.5, 1.8, 5.0, 0.9
"""Bars: error over that of the better mean, error over sigma, and how often there must be a heading."""


def off_deg(heading: float, truth: float) -> float:
    """Return the difference of two headings in rad, as degrees."""
    return math.degrees(math.remainder(heading - truth, 2.0 * math.pi))


def rms(values: FloatArray) -> float:
    """Return the root of the mean square of what is known."""
    known = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else math.nan


def outcome(scene: Scene, seed: int) -> FloatArray:
    """Return error, sigma, error of the plain and of the Hann mean, degrees, at each time, (2, 4)."""
    rec = record(scene, max(AT_S) + 1.0, seed)
    stage = Alignment(AlignmentParameters.model_validate(scene.parameters), scene.latitude_deg, None if scene.any_attitude else "FRD")
    out = stage.process(rec.block)
    rows = []
    for second in AT_S:
        n = round(second * scene.rate_hz)
        heading, sd = float(out["heading"][n]), math.degrees(out["heading_sd"][n])
        means = [mean_heading(rec.level_rate[:n], weights) for weights in (np.ones, np.hanning)]
        rows.append([off_deg(heading, rec.heading), sd, *(off_deg(mean, rec.heading) for mean in means)])
    return np.array(rows)


def row(scene: Scene, seeds: range) -> tuple[float, str]:
    """Return by how much a scene is worse than the bars, and its row of the table."""
    found = np.array([outcome(scene, seed) for seed in seeds])
    cells, worse = [scene.name], 0.0
    for k in range(len(AT_S)):
        error, sd, plain, hann = found[:, k].T
        shown = np.isfinite(error)
        z = error / sd
        best = min(rms(plain), rms(hann))
        ratio = rms(error) / best
        largest = float(np.abs(z[shown]).max()) if shown.any() else math.nan
        past = (ratio / RATIO, rms(z) / RMS_Z, largest / MAX_Z, SHOWN / max(float(shown.mean()), 0.01))
        worse = max(worse, *(value for value in past if math.isfinite(value)))
        cells += [
            f"{rms(error):.4f}", f"{rms(plain):.4f}", f"{rms(hann):.4f}", f"{ratio:.2f}",
            f"{np.median(sd):.4f}", f"{100 * shown.mean():.0f} %", f"{rms(z):.2f}", f"{largest:.1f}",
        ]  # fmt: skip
    return worse, f"| {' | '.join(cells)} |"


def main() -> None:
    """Print the table, the worst row first."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="?", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument("--only", default="", help="part of a scene's name")
    given = parser.parse_args()
    names = ["rms error °", "plain", "Hann", "over the better", "σ", "shown", "rms z", "max z"]
    print("| site | " + " | ".join(f"{name}, {second} s" for second in AT_S for name in names) + " |")
    print("|---" * (1 + len(AT_S) * len(names)) + "|")
    seeds = range(given.first, given.first + given.runs)
    rows = [row(scene, seeds) for scene in SCENES if given.only in scene.name]
    for _, text in sorted(rows, reverse=True):
        print(text)


if __name__ == "__main__":
    main()
