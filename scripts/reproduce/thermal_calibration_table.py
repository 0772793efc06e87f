"""Write docs/appendix/thermal-calibration-results.md and its figures."""

from __future__ import annotations

import argparse
import os
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
import thermal_calibration_figures as figures
from thermal_calibration_data import AXES, DEG_H, INSIDE, Soak, chamber_cycle, simulated_soak, two_levels
from thermal_calibration_measured import Row, TwoLevels, fit_first_test_rest, two_levels_study
from thermal_calibration_study import (
    RESTARTS,
    SizeRow,
    beyond_the_range,
    on_level_means,
    polynomial_leak,
    published,
    rms,
    size_study,
    slope_methods,
    slope_size_study,
)

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs" / "figures" / "thermal-calibration"
OUT = ROOT / "docs" / "appendix" / "thermal-calibration-results.md"
SEED = 1
SHARES = (0.42, 0.6, 0.8)
DISTANCES = np.array([0.5, 1.0, 2.0, 3.0, 3.5])
NOTED = {
    "derivative of the published b(T) network": "0.28 / 0.25 / 1.04",
    "network on differences of levels": "1.5 / 0.6 / 9.6",
    "network on differences of 30 s means": "5 / 8 / 11",
    "cubic spline through the level means": "0.42 / 0.45 / 0.64",
}
"""The slope errors that an earlier study of the same curves gave."""


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Return the lines of a Markdown table."""
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    return [*lines, *(f"| {' | '.join(map(str, row))} |" for row in rows), ""]


def sizes_text(rows: Sequence[SizeRow]) -> list[str]:
    head = ["neurons", *figures.PARTS, "levels left out", "against the truth"]
    return table(
        head,
        (
            [row.neurons, *(f"{v:.2f}" for v in row.by_sample),
             f"{row.levels_left_out:.1f}" if np.isfinite(row.levels_left_out) else "", f"{row.truth:.2f}"]
            for row in rows
        ),
    )  # fmt: skip


def simulated(soak: Soak) -> list[str]:
    levels_only, slopes = size_study(soak), slope_size_study(soak)
    figures.sizes(levels_only, "Figure 7: networks on b(T)", "°/h", FIGURES / "figure-07.png")
    figures.sizes(slopes, "Figure 8: networks on db/dT", "°/h/°C", FIGURES / "figure-08.png")
    methods = [slope_methods(soak, axis) for axis in range(3)]
    figures.slope_errors(soak, methods, FIGURES / "slopes.png")
    text = [
        "## Size of the network, and what a split by sample hides", "",
        "Scenario crs05-soak, 30 s means at the levels, 65/20/15 % of the samples at random, as published;",
        "S_r is the rms over the three axes, °/h.  The three parts agree whatever happens in between.", "",
        *sizes_text(levels_only), "![Figure 7](../figures/thermal-calibration/figure-07.png)", "",
        "The same on db/dT from differences of levels, °/h/°C: 14 of them, 9 for training.", "",
        *sizes_text(slopes), "![Figure 8](../figures/thermal-calibration/figure-08.png)", "",
        "## Error of the slope", "",
        "rms from -20.53 to 48.08 °C against the truth, °/h/°C.", "",
    ]  # fmt: skip
    rows = []
    for name in methods[0]:
        errors = [rms(methods[axis][name](INSIDE) - soak.slope[:, axis]) / DEG_H for axis in range(3)]
        rows.append([name, *(f"{error:.2f}" for error in errors), NOTED.get(name, "")])
    text += table(["method", *AXES, "noted before"], rows)
    return [*text, "![Slopes](../figures/thermal-calibration/slopes.png)", "", *traps(soak)]


def traps(soak: Soak) -> list[str]:
    bad = [published(soak.halfminutes(axis), 2, 1).bad for axis in range(3)]
    means = [on_level_means(soak, axis) for axis in range(3)]
    leak = polynomial_leak(soak)
    tangent, hold = beyond_the_range(soak, DISTANCES)
    text = [
        "## Restarts, and 15 level means alone", "",
        f"Of {RESTARTS} starts of the 1-2-2-1 network {bad[0]} / {bad[1]} / {bad[2]} (x / y / z) ended with",
        "more than 1.5 times the validation error of the best.  Trained on the 15 level means alone, the",
        f"network errs by up to {_list(n for n, _ in means)} °/h between them, a cubic spline through them",
        f"by {_list(s for _, s in means)}.", "",
        "A polynomial of order 12 on the levels alone, split by sample: rms residual of training, validation",
        f"and test {_list(leak[:3])} °/h; its error between the levels {leak[3] / DEG_H:.1f} °/h (z).", "",
        "## Outside the calibrated range", "",
        "Spline fitted to levels 2 to 14; rms error over axes and both ends, °/h.", "",
    ]  # fmt: skip
    rows = [
        ["tangent", *(f"{v / DEG_H:.1f}" for v in tangent)],
        ["held", *(f"{v / DEG_H:.1f}" for v in hold)],
    ]
    return text + table(["", *(f"{d:g} °C" for d in DISTANCES)], rows)


def _list(values: Iterable[float]) -> str:
    return " / ".join(f"{value / DEG_H:.1f}" for value in values)


def chamber_text(share: float, rows: Sequence[Row]) -> list[str]:
    keys = list(rows[0].errors)
    head = ["axis", *keys, "what was chosen", "promised", "inside", "noise of a block"]
    lines = table(
        head,
        (
            [row.axis, *(f"{np.rad2deg(row.errors[key]):.3f}" for key in keys), row.chosen,
             f"{np.rad2deg(row.promised):.3f}", f"{row.inside:.0%}", f"{np.rad2deg(row.floor):.4f}"]
            for row in rows
        ),
    )  # fmt: skip
    return [f"Fitted to the first {share:.0%} of the time:", "", *lines]


def two_levels_text(found: TwoLevels) -> list[str]:
    (a, b), (c, d) = found.temperatures
    rows = [
        [axis, *(f"{np.rad2deg(v):.3f}" for v in (before, after, floor))]
        for axis, before, after, floor in found.rows
    ]
    return [
        "### two-levels", "",
        f"{a:.1f} to {b:.1f} °C and {c:.1f} to {d:.1f} °C, remounted between.  `imumon calibrate` refuses: "
        f"{found.refusal}.", "",
        "A straight line through the first 60 % of each level, tested on the rest of each; °/s:", "",
        *table(["axis", "constant", "line", "noise of a block"], rows),
    ]  # fmt: skip


def measured(data: Path) -> list[str]:
    with tempfile.TemporaryDirectory() as scratch:
        record = chamber_cycle(data, Path(scratch))
        levels = two_levels(data, Path(scratch))
    figures.chamber(record, 0.6, FIGURES / "chamber-cycle.png")
    text = [
        "## Measured recordings: before and after", "",
        "### chamber-cycle", "",
        "rms error of the bias in the part of the recording after the fit, where its temperature is in the",
        "fitted range, °/s; `constant` is before: the mean of the fitted part.  `promised` is the",
        "`residual_sd` of the model.", "",
    ]  # fmt: skip
    for share in SHARES:
        text += chamber_text(share, fit_first_test_rest(record, share))
    picture = "![Chamber cycle](../figures/thermal-calibration/chamber-cycle.png)"
    text += ["Curve chosen from the first 60 %:", "", picture, ""]
    return text + two_levels_text(two_levels_study(levels))


def main() -> None:
    default = os.environ.get("IMUMON_DATA", str(ROOT.parent / "shared" / "data"))
    parser = argparse.ArgumentParser(prog="scripts/reproduce/thermal_calibration", description=__doc__)
    parser.add_argument("data", nargs="?", default=default, help="folder of the measured recordings")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    given = parser.parse_args()
    if given.quick:
        soak = simulated_soak(SEED)
        print("\n".join(f"- {name}" for name in slope_methods(soak, 0)))
        return
    data = Path(given.data)
    FIGURES.mkdir(parents=True, exist_ok=True)
    text = ["# Thermal calibration: results", "", "Made by scripts/reproduce/thermal_calibration.", ""]
    text += simulated(simulated_soak(SEED))
    if (data / "chamber-cycle").is_dir():
        text += measured(data)
    else:
        print(f"no measured data in {data}: those tables are left out", file=sys.stderr)
    OUT.write_text("\n".join(text).rstrip() + "\n", encoding="utf-8")
    print("\n".join(text))


if __name__ == "__main__":
    main()
