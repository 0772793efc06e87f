"""Tables of the alignment: closed forms, seeded runs, disturbances."""

from __future__ import annotations

import argparse
import math
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from alignment_figures import bound_free, bound_known, draw_all
from alignment_loop import Loop, comparisons, short_heading, simulate
from alignment_runs import CASES, ESTIMATORS, EVENTS, TURNED, Case, Run, align, plan, runs, within_from

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures" / "alignment"
CHECKED_S = (60, 120, 180, 300)
TAU_S = 150.0


def table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table."""
    print(f"\n{title}\n\n| {' | '.join(headings)} |\n|{'---|' * len(headings)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


LOOPS = {
    "200 Hz": Loop(),
    "2000 Hz": Loop(rate_hz=2000.0),
    "2000 Hz, and 0.01 °/h of gyro bias": Loop(rate_hz=2000.0, gyro_deg_per_h=0.01),
}


def closed_forms(loops: Mapping[str, Loop]) -> None:
    """Equations 10 to 22 beside the loop of imumon; the two check values."""
    found = [comparisons(loop) for loop in loops.values()]
    rows = [
        [parts[0][0], *(f"{100 * value:.3f} %" for _, value in parts)] for parts in zip(*found, strict=True)
    ]
    table(
        "Largest difference between closed form and simulation, of the largest (bar: 1 %; 30 µg, 300 s)",
        ["equation", *loops],
        rows,
    )
    course, seconds = simulate(Loop(), 61.0), (30.0, 60.0)
    simulated = [1e3 * abs(course.at(course.control[0], s)) / Loop().level for s in seconds]
    full = simulate(Loop(vertical=True), 61.0)
    whole = [1e3 * abs(full.at(full.control[0], s)) / Loop().level for s in seconds]
    said = [1e3 * value for value in short_heading(Loop(), np.array(seconds))]
    table(
        "Heading error at 30 and 60 s, mrad (check values 1.53 and 1.39)",
        ["", "30 s", "60 s"],
        [
            ["equation 22", *(f"{value:.3f}" for value in said)],
            ["simulated", *(f"{value:.3f}" for value in simulated)],
            ["simulated with the vertical earth rate", *(f"{value:.3f}" for value in whole)],
        ],
    )


def statistics(case: Case, found: Sequence[Run]) -> None:
    """Times to settle, and errors over sigmas, of all estimators."""
    rows = []
    for name in (*ESTIMATORS, "shown"):
        times = np.array([within_from(run.error[name]) for run in found])
        ratios = [[run.error[name][s - 1] / run.sd[name][s - 1] for run in found] for s in CHECKED_S]
        consistent = [_rms(part) for part in ratios]
        error = math.sqrt(np.nanmean([run.error[name][179] ** 2 for run in found]))
        median, late = np.quantile(times, [0.5, 0.9], method="higher")
        shown = [f"{value:.0f}" if math.isfinite(value) else "> 300" for value in (median, late)]
        rows.append([name.replace("_", " "), *shown, f"{error:.4f}", *consistent])
    table(
        f"{len(found)} runs, {case.name}: s until the error stays within 0.05°, rms error at 180 s in °, "
        "and rms of error / sigma",
        ["estimator", "median", "90 %", "rms at 180 s", *(f"at {s} s" for s in CHECKED_S)],
        rows,
    )
    settled = np.array([run.status.settled_s or math.inf for run in found])
    chosen = sorted({"none" if run.status.shown is None else "joint" for run in found})
    median, last = np.median(settled), settled.max()
    print(f"\nSettled by its own sigma: median {median:.1f} s, last {last:.1f} s after the first sample")
    print(f"Shown at the end: {', '.join(chosen)}")
    at = np.array([150.0])
    known, free = bound_known(at)[0], bound_free(36.0, at + 36.0, TAU_S, 83.7)[0]
    print(
        f"Cramér-Rao bound after 150 s: {known:.4f}° with the level seen, {free:.3f}° by control rates alone"
    )


def _rms(ratios: Sequence[float]) -> str:
    known = np.array(ratios)[np.isfinite(ratios)]
    if not len(known):
        return "-"
    return f"{math.sqrt(np.mean(known**2)):.2f}" + (f" ({len(known)})" if len(known) < len(ratios) else "")


def disturbances(seeds: int) -> None:
    """What happens to each event: what is said, what is shown."""
    rows = []
    for name, motion in EVENTS.items():
        found = [
            align(plan(CASES[-1], TAU_S, 30.0, 300.0, motion), seed, CASES[-1].parameters)
            for seed in range(seeds)
        ]
        truth = TURNED.get(name, 0.0)
        errors = [abs((run.error["shown"][-1] - truth + 180.0) % 360.0 - 180.0) for run in found]
        ratio = max(error / run.sd["shown"][-1] for error, run in zip(errors, found, strict=True))
        left = sum(any("left out" in text for text in run.notices) for run in found)
        anew = sum(any("anew" in text for text in run.notices) for run in found)
        tilting = sum(run.status.tilt_probability > 0.5 for run in found)
        states = ", ".join(sorted({run.status.phase for run in found}))
        rows.append(
            [
                name, f"{left}/{seeds}", f"{anew}/{seeds}", f"{tilting}/{seeds}", states.replace("_", " "),
                f"{max(errors):.3f}", f"{max(run.sd['shown'][-1] for run in found):.3f}", f"{ratio:.1f}",
            ]
        )  # fmt: skip
    table(
        "Disturbances: how often left out, begun anew, called a tilt; at 300 s the state, the largest error "
        "and sigma in °, and the largest error over sigma",
        ["event", "left out", "anew", "tilt", "at 300 s", "error", "sigma", "ratio"],
        rows,
    )


def main() -> None:
    """Print the tables and draw the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="?", type=int, default=50)
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    given = parser.parse_args()
    count = given.runs
    closed_forms(dict(list(LOOPS.items())[:1]) if given.quick else LOOPS)
    if given.quick:
        statistics(CASES[0], list(runs(CASES[0], 1)))
        return
    for case in CASES:
        statistics(case, list(runs(case, count)))
    disturbances(max(count // 5, 1))
    draw_all(FIGURES)
    print(f"\nFigures: {FIGURES.relative_to(FIGURES.parents[2])}")


if __name__ == "__main__":
    main()
