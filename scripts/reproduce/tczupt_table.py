"""Tables of the published comparison of ZUPT and TCZUPT, of that at equal terms, and of what lies beyond."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from dense_record import dense_filter
from tczupt_chain import Chain, calibration_errors, run_chain
from tczupt_figures import draw_all
from tczupt_records import (
    DPH,
    RATE_HZ,
    RESIDUAL,
    STEP,
    ZEROING,
    Filter,
    Record,
    convergence_s,
    curves,
    fir_rate,
    moving_average,
    run,
    simulate,
    slopes,
    true_model,
)
from thermal_calibration_study import RESTARTS

from imumon.blocks import FloatArray
from imumon.estimation.gyro_bias.stage import GyroBias, Mode
from imumon.papers.dense_zupt import DenseSettings

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures" / "tczupt"
ZUPT, TCZUPT = Filter("calibrated"), Filter("rate", k=0.5)
COVERED = 15.0
SOAKS = 1000
"""Seed of the first soak: its noise is not that of the ramp."""


def table(title: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a Markdown table."""
    print(f"\n{title}\n\n| {' | '.join(headings)} |\n|{'---|' * len(headings)}")
    for row in rows:
        print(f"| {' | '.join(row)} |")


def three(values: FloatArray, digits: int = 2) -> str:
    """Write x, y, z."""
    return " ".join(f"{value:.{digits}f}" for value in values)


def rms(
    errors: Sequence[FloatArray] | FloatArray, start_s: float = 0.0, stop_s: float | None = None
) -> FloatArray:
    """Return the root mean square over all records, deg/h, (3,)."""
    stop = None if stop_s is None else round(stop_s * RATE_HZ)
    parts = [error[round(start_s * RATE_HZ) : stop] for error in errors]
    return np.asarray(np.sqrt(np.mean(np.concatenate(parts) ** 2, axis=0)))


Rows = dict[str, list[Filter]]
"""For each filter of a table its setting for each record: a soak has its own error of calibration."""


def published(records: Sequence[Record], chains: list[Chain]) -> None:
    """Tables 5 to 12: each filter with its own bias instability, start covariance from the zeroing."""
    off = [(moving_average(r) - r.bias)[ZEROING:] / DPH for r in records]
    raw = [(r.gyro - r.earth - moving_average(r))[ZEROING:].mean(0) / DPH for r in records]
    table(
        "Table 5: the moving average, deg/h, x y z",
        ["mean residual about it", "its rms error against the truth", "60 ARW/sqrt(30 s)"],
        [[three(np.mean(raw, axis=0), 3), three(rms(off)), f"{60 * 0.28 / np.sqrt(30):.2f}"]],
    )
    settings: Rows = {
        "ZUPT, true curve": [ZUPT] * len(records),
        "TCZUPT, true curve": [TCZUPT] * len(records),
        **{f"{name}, whole chain": [one.filters[name] for one in chains] for name in chains[0].filters},
    }
    rows = {
        (name, residual): [run(r, one, residual)[0] for r, one in zip(records, chosen, strict=True)]
        for residual in (0.0, RESIDUAL)
        for name, chosen in settings.items()
    }
    for number, residual in ((6, 0.0), (7, RESIDUAL)):
        lines = []
        for name in settings:
            errors = rows[name, residual]
            against = [e - o for e, o in zip(errors, off, strict=True)]
            lines.append([name, *(three(rms(x, 0, t)) for x in (errors, against) for t in (30.0, None))])
        table(
            f"Table {number}: rms with a residual of {residual:.0f} deg/h, deg/h, x y z",
            ["filter", "truth: 30 s", "truth: all", "average: 30 s", "average: all"],
            lines,
        )
    for numbers, residual in (("8 and 9", 0.0), ("10 and 11", RESIDUAL)):
        lines = []
        for name in settings:
            sets = np.array([rms([e], 0.0, 300.0) for e in rows[name, residual][:5]])
            lines.append([name, *map(three, sets), three(sets.mean(0)), three(sets.std(0, ddof=1))])
        table(
            f"Tables {numbers}: five sets of 5 min, residual {residual:.0f} deg/h, rms, deg/h, x y z",
            ["filter", "1", "2", "3", "4", "5", "mean", "sd"],
            lines,
        )
    times = {name: [convergence_s(e) for e in rows[name, RESIDUAL]] for name in settings}
    # A record that never converges is at the end of the order, not left out of it.
    middle = {name: np.median(np.nan_to_num(all_of, nan=np.inf), axis=0) for name, all_of in times.items()}
    table(
        "Table 12: time until within 1.00e-5 rad/s for 5 s, median, s, x y z; how many records get there",
        ["filter", "s", "records"],
        [
            [name, three(middle[name], 0), " ".join(map(str, np.isfinite(times[name]).sum(0)))]
            for name in settings
        ],
    )
    claims(rows, middle)


def claims(rows: dict[tuple[str, float], list[FloatArray]], middle: dict[str, FloatArray]) -> None:
    """What the text of the paper says of its tables, as ratios of TCZUPT to ZUPT."""
    lines = []
    for part in ("true curve", "whole chain"):
        zupt, tczupt = f"ZUPT, {part}", f"TCZUPT, {part}"
        for claim, residual, stop in (
            ("nominal: alike, all", 0.0, None),
            ("15 deg/h: smaller rms in the first 30 s", RESIDUAL, 30.0),
            ("15 deg/h: smaller rms over all", RESIDUAL, None),
        ):
            ratio = rms(rows[tczupt, residual], 0, stop) / rms(rows[zupt, residual], 0, stop)
            lines.append([claim, part, three(ratio)])
        lines.append(["15 deg/h: converges sooner", part, three(middle[tczupt] / middle[zupt])])
    table("What the text of the paper says: TCZUPT over ZUPT, x y z", ["claim", "with", "ratio"], lines)


def calibrated(chains: list[Chain]) -> None:
    """What the networks of the soaks got wrong, which the filters of the whole chain have to live with."""
    residual = np.sqrt(np.mean(np.square([[t.residual for t in one.bias] for one in chains]), axis=0)) / DPH
    bad = np.sum([[t.bad for t in one.bias] for one in chains], axis=0)
    print(
        f"\nWhole chain: {len(chains)} soaks of their own noise, {chains[0].samples} settled means of 30 s;"
        f" rms residual of training, validation and test means, deg/h: "
        f"{'; '.join(f'{axis} {three(row)}' for axis, row in zip('xyz', residual, strict=True))}; "
        f"starts that ended badly: {' '.join(map(str, bad))} of {RESTARTS * len(chains)}."
    )
    rows = calibration_errors(chains)
    table("Errors of the calibration between 27.28 and 34.08 degC, rms", ["error", "x", "y", "z"], rows)


def equal_in_the_chain(records: Sequence[Record], chains: list[Chain]) -> None:
    """Both filters of the whole chain at the same K and p0."""
    lines = []
    for k, p0 in ((0.1, 2.2), (0.5, 2.2), (0.1, COVERED), (0.5, COVERED)):
        for name in ("ZUPT", "TCZUPT"):
            chosen = [replace(one.filters[name], k=k, p0=p0) for one in chains]
            cells = []
            for residual in (0.0, RESIDUAL):
                errors = [run(r, one, residual)[0] for r, one in zip(records, chosen, strict=True)]
                cells += [three(rms(errors, 0, 30)), three(rms(errors))]
            lines.append([name, f"{k}", f"{p0}", *cells])
    table(
        "The whole chain at equal K and p0: rms, deg/h, x y z",
        ["filter", "K", "p0", "nominal: 30 s", "nominal: all", "15: 30 s", "15: all"],
        lines,
    )


def responses() -> None:
    """What a residual does, without noise: K and p0 decide, and nothing else."""
    n, seconds = 40000, (10, 30, 60, 120, 240)
    lines = []
    for k, p0 in ((0.0, 2.2), (0.1, 2.2), (0.5, 2.2), (0.1, 15.0), (0.5, 15.0)):
        settings = replace(DenseSettings(1.0 / RATE_HZ), bias_random_walk=k * DPH, bias_sd=p0 * DPH)
        latitude = np.radians(40.93)
        earth = 7.292115e-5 * np.array([np.cos(latitude), 0.0, -np.sin(latitude)])
        accel = np.tile([0.0, 0.0, -9.80665], (n, 1))
        start = np.array([RESIDUAL * DPH, 0.0, 0.0])
        result = dense_filter(settings, np.tile(earth, (n, 1)), accel, start, every=STEP)
        left = result.bias[:, 0] / DPH
        below = (np.flatnonzero(left < 1e-5 / DPH)[0] + 1) / RATE_HZ
        lines.append([f"{k}", f"{p0}", *(f"{left[t * RATE_HZ - 1]:.2f}" for t in seconds), f"{below:.1f} s"])
    headings = ["K", "p0", *(f"{t} s" for t in seconds), "below 2.063 at"]
    table("Response of either filter to 15 deg/h, x axis, deg/h, no noise", headings, lines)


def honest(records: Sequence[Record]) -> None:
    """Both filters at the same K and p0, in both forms of the thermal term."""
    lines = []
    limit = 60 * 0.28
    for k, p0 in ((0.1, 2.2), (0.5, 2.2), (0.1, COVERED), (0.5, COVERED)):
        results = {}
        for name, thermal in (
            ("ZUPT", "calibrated"),
            ("TCZUPT", "rate"),
            ("TCZUPT, increments", "increments"),
        ):
            chosen = Filter(thermal, k=k, p0=p0)
            nominal = [run(r, chosen)[0] for r in records]
            errors = results[name] = [run(r, chosen, RESIDUAL)[0] for r in records]
            times = np.nanmedian([convergence_s(e) for e in errors], axis=0)
            lines.append(
                [name, f"{k}", f"{p0}", three(rms(nominal)), three(rms(errors, 0, 30)), three(rms(errors)),
                 three(times, 0)]
            )  # fmt: skip
        apart = max(
            float(np.abs(a - b).max())
            for a, b in zip(results["ZUPT"], results["TCZUPT, increments"], strict=True)
        )
        print(f"\nK {k}, p0 {p0}: ZUPT and TCZUPT with increments differ by at most {apart:.1e} deg/h")
    table(
        "At equal K and p0: rms, deg/h, x y z",
        ["filter", "K", "p0", "nominal, all", "15: first 30 s", "15: all", "15: converged, s"],
        lines,
    )
    after_s = (10, 30, 60, 120, 300)
    table(
        "Information limit of the noise alone, 60 ARW/sqrt(t), deg/h",
        [f"{t} s" for t in after_s],
        [[f"{limit / np.sqrt(t):.2f}" for t in after_s]],
    )


def raw_streams(records: Sequence[Record]) -> None:
    """Where the thermal term pays: raw data, against the truth."""
    lines = []
    few = records[:4]
    cases: dict[str, Filter] = {
        "raw, no thermal term": Filter(None),
        "increments, true temperature": Filter("increments"),
        "increments, reading (0.05 degC steps)": Filter("increments", temperature="reading"),
        "slope x FIR rate": Filter("fir"),
    }
    for name, chosen in cases.items():
        cells = [three(rms([run(r, replace(chosen, k=k, p0=COVERED))[0] for r in few])) for k in (0.1, 0.5)]
        lines.append([name, *cells])
    table("Raw data, p0 15: rms, deg/h, x y z", ["thermal term", "K 0.1", "K 0.5"], lines)
    lines = []
    begin = ZEROING + 264 * RATE_HZ
    for seconds in (66, 204):
        record = records[0]
        stop = min(begin + seconds * RATE_HZ, len(record.gyro) - 1)
        thermal = curves(record.temperature)[:, 1] / DPH
        truth = thermal[stop] - thermal[begin]
        slope = slopes(record.temperature)[:, 1]
        by_rate = float(np.sum(slope[begin:stop] * fir_rate(record)[begin:stop])) / RATE_HZ / DPH
        reading = curves(record.block["temperature"])[:, 1] / DPH
        lines.append(
            [
                f"{seconds} s",
                f"{-truth:.1f}",
                f"{by_rate - truth:.1f}",
                f"{reading[stop] - reading[begin] - truth:.1f}",
            ]
        )
    table(
        "Predicted without updates, descent, y axis: error, deg/h",
        ["for", "held", "slope x FIR rate", "increments of the reading"],
        lines,
    )


def lacking(runs: int) -> None:
    """Effects that the curve lacks: hysteresis, and gyros that lag their thermometers."""
    lines = []
    for name, scenario in (
        ("none", "crs05-ramp"),
        ("hysteresis", "crs05-ramp-hysteresis"),
        ("lag 30 s", "crs05-ramp-lag"),
    ):
        records = [simulate(scenario, seed) for seed in range(runs)]
        for filter_name, thermal in (("ZUPT", "calibrated"), ("TCZUPT", "increments")):
            cells = [
                three(rms([run(r, Filter(thermal, k=k, p0=COVERED))[0] for r in records])) for k in (0.1, 0.5)
            ]
            lines.append([name, filter_name, *cells])
        stage = three(rms([stage_error(r, "thermal") for r in records]))
        lines.append([name, "stage, noise and wander learned", stage, stage])
    table("Effects that the curve lacks: rms, deg/h, x y z", ["effect", "filter", "K 0.1", "K 0.5"], lines)


def stage_error(record: Record, mode: Mode) -> FloatArray:
    """Return the error of the stage after the zeroing, deg/h, (n, 3)."""
    model = true_model() if mode == "thermal" else None
    latitude = 40.93
    added = GyroBias(None, model, mode, latitude, 0.0).process(record.block)
    bias = np.column_stack([added[f"gyro_bias_{axis}"] for axis in "xyz"])
    return np.asarray((bias - record.bias)[ZEROING:] / DPH)


def production(records: Sequence[Record]) -> None:
    """The stage of imumon, nothing told but place and model."""
    modes: tuple[tuple[str, Mode], ...] = (
        ("standard, raw", "standard"),
        ("learned, raw", "learned"),
        ("thermal", "thermal"),
    )
    lines = []
    for name, mode in modes:
        errors = [stage_error(r, mode) for r in records]
        lines.append([name, three(rms(errors, 0, 30)), three(rms(errors))])
    table("The stage on the ramp: rms, deg/h, x y z", ["mode", "first 30 s", "all"], lines)


def main() -> None:
    """Print all tables, and draw the figures."""
    parser = argparse.ArgumentParser(prog="scripts/reproduce/tczupt")
    parser.add_argument("--runs", type=int, default=8, help="records of the ramp test, at least 5")
    parser.add_argument("--no-figures", action="store_true")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    options = parser.parse_args()
    if options.quick:
        responses()
        return
    records = [simulate("crs05-ramp", seed) for seed in range(max(5, options.runs))]
    print("# ZUPT and TCZUPT: tables\n\nMade by `scripts/reproduce/tczupt`;", end=" ")
    print(f"{len(records)} records of the ramp test.")
    chains = [run_chain(SOAKS + seed, record.earth) for seed, record in enumerate(records)]
    sections: list[Callable[[], None]] = [
        lambda: calibrated(chains),
        lambda: published(records, chains),
        lambda: equal_in_the_chain(records, chains),
        responses,
        lambda: honest(records),
        lambda: raw_streams(records),
        lambda: lacking(4),
        lambda: production(records),
    ]
    for section in sections:
        section()
    if not options.no_figures:
        draw_all(FIGURES, records[0])


if __name__ == "__main__":
    main()
