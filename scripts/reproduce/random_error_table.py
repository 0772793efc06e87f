"""What the methods of Shi Gang et al. do to noise, drift and rotation, whatever "compensated" means."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path

import allantools
import numpy as np
from random_error_figures import draw_all
from random_error_methods import (
    DELTAS,
    FITTED,
    PRETENDED,
    PUBLISHED,
    SOFTENING,
    Output,
    default,
    exponential,
    fit_record,
    fitted_noise,
    published,
    slow,
)
from random_error_records import (
    RATE_HZ,
    THERMAL_RAMP,
    VARIANCE,
    Record,
    measured,
    simulate,
    without_temperature,
)

from imumon.blocks import FloatArray
from imumon.papers.linear import LinearFilter, ModelL
from imumon.papers.local_level import fit_local_level, means_of
from imumon.papers.sigma_points import PHI, ModelNL, SigmaPointFilter

ROOT = Path(__file__).resolve().parents[2]
HOUR = 3600.0
MINUTE_SEEDS, HOUR_SEEDS, JOURNEY_SEEDS = 48, 8, 24
TAUS_S = (0.02, 0.1, 1.0, 10.0)
TURN, TURN_FROM, TURN_TO = 0.5, 20, 40
"""deg/s, and s: a true rotation by 10 deg."""


def main() -> None:
    """Write tables to standard output and figures to docs/figures/random-error."""
    default = os.environ.get("IMUMON_DATA", str(ROOT.parent / "shared" / "data"))
    parser = argparse.ArgumentParser(prog="scripts/reproduce/random_error", description=__doc__)
    parser.add_argument("data", nargs="?", default=default, help="folder of the measured recordings")
    parser.add_argument("--quick", action="store_true", help="a few seconds: the first of everything")
    given = parser.parse_args()
    if given.quick:
        compensated([simulate(60.0, 0)])
        return
    folder = Path(given.data)
    minutes = [simulate(60.0, seed) for seed in range(MINUTE_SEEDS)]
    print(f"Simulated MTi-28A noise at {RATE_HZ} Hz; R = {VARIANCE} (deg/s)². Allan deviations in °/h.\n")
    compensated(minutes)
    hours = [simulate(HOUR, 100 + seed) for seed in range(HOUR_SEEDS)]
    against_truth(hours)
    rotation(minutes[:4])
    journey()
    thermal(minutes, [simulate(60.0, seed, THERMAL_RAMP) for seed in range(MINUTE_SEEDS)])
    fitted()
    records = measured(folder)
    if records:
        on_measured(records)
    else:
        print(f"No measured records in {folder}.")
    endurance()
    out = ROOT / "docs" / "figures" / "random-error"
    out.mkdir(parents=True, exist_ok=True)
    for path in draw_all(out, records):
        print(path.relative_to(ROOT), file=sys.stderr)


def heading(title: str, columns: Sequence[str]) -> None:
    """Print a title and the head of a Markdown table."""
    print(f"\n{title}\n\n| {' | '.join(columns)} |\n|{'---|' * len(columns)}", flush=True)


def row(name: str, cells: Iterable[object]) -> None:
    """Print a row of a Markdown table."""
    print(f"| {name} | {' | '.join(str(cell) for cell in cells)} |", flush=True)


def rms(values: Sequence[float] | FloatArray) -> float:
    """Return the root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def allan(values: FloatArray, rate: float, taus: Sequence[float]) -> FloatArray:
    """Return overlapping Allan deviations at these averaging times in °/h."""
    _, deviations, _, _ = allantools.oadev(values, rate=rate, data_type="freq", taus=list(taus))
    return np.asarray(deviations) * HOUR


def compensated(records: Sequence[Record]) -> None:
    """Print Allan deviations and the angle after a minute, of (a) raw less x_k|k-1 and (b) x_k|k."""
    columns = ["", *(f"δ¹ {delta:g}" for delta in PRETENDED)]
    heading("Compensated, 60 s: oadev at 0.02/0.1/1/10 s in °/h; rms angle after 60 s in deg", columns)
    row("raw", [_cell([r.reading for r in records])] * len(PRETENDED))
    for meaning in "ab":
        for name in PUBLISHED:
            cells = []
            for delta in PRETENDED:
                outputs = [published(name, r.reading, delta) for r in records]
                if meaning == "a":
                    series = [r.reading - o.predicted for r, o in zip(records, outputs, strict=True)]
                else:
                    series = [o.estimate for o in outputs]
                cells.append(_cell(series))
            row(f"{name} ({meaning})", cells)
    row("exponential 1 s (b)", [_cell([exponential(r.reading, 1.0) for r in records])] * len(PRETENDED))


def _cell(series: Sequence[FloatArray]) -> str:
    deviations = np.mean([allan(values, RATE_HZ, TAUS_S) for values in series], axis=0)
    angle = rms([float(np.sum(values)) / RATE_HZ for values in series])
    return "/".join(f"{value:.3g}" for value in deviations) + f", {angle:.3f}"


def against_truth(records: Sequence[Record]) -> None:
    """Print rms errors against the true drift over an hour, and whether the standard deviations are true."""
    heading(
        f"Against the true drift, 1 h after the first minute, {len(records)} seeds",
        ["method", "rms °/h", "of seeds", "rms error / sd"],
    )
    methods: dict[str, Callable[[Record], Output]] = {}
    for delta in DELTAS:
        for name in ("KF", *PUBLISHED):
            methods[f"{name}, δ¹ {delta:g}"] = partial(_published, name, delta)
    for name in ("drift", "exponential 85 s", "exponential 200 s", "hold 60 s"):
        methods[name] = partial(slow, name)
    for name, method in methods.items():
        errors, normalised = [], []
        for record in records:
            output = method(record)
            error = (output.estimate - record.drift)[60 * RATE_HZ :]
            errors.append(rms(error) * HOUR)
            normalised.append(rms(error / output.sd[60 * RATE_HZ :]))
        row(name, [f"{rms(errors):.1f}", f"{min(errors):.0f} to {max(errors):.0f}", f"{rms(normalised):.2f}"])


def _published(name: str, delta: float, record: Record) -> Output:
    return published(name, record.reading, delta)


def rotation(records: Sequence[Record]) -> None:
    """Print what is lost of a turn by 10 deg in 20 s under (a), and the gain of slow sines under (b)."""
    heading(
        "True rotation: 0.5 deg/s for 20 s, lost under (a); gain of a sine under (b)",
        ["method", "lost, deg", "false rate after, deg/s", "gain at 0.1 Hz", "gain at 1 Hz"],
    )
    n = len(records[0].reading)
    t = np.arange(n) / RATE_HZ
    turn = np.where((t >= TURN_FROM) & (t < TURN_TO), TURN, 0.0)
    for delta in DELTAS:
        for name in PUBLISHED:
            lost, after, gains = [], [], []
            for record in records:
                still = published(name, record.reading, delta)
                moved = published(name, record.reading + turn, delta)
                taken = moved.predicted - still.predicted
                lost.append(np.sum(taken[TURN_FROM * RATE_HZ : TURN_TO * RATE_HZ]) / RATE_HZ)
                after.append(-taken[TURN_TO * RATE_HZ + 1])
                gains.append([_gain(name, record, delta, f, still.estimate) for f in (0.1, 1.0)])
            low, high = np.mean(gains, axis=0)
            cells = [f"{np.mean(lost):.2f}", f"{np.mean(after):.2f}", f"{low:.3f}", f"{high:.3f}"]
            row(f"{name}, δ¹ {delta:g}", cells)
    lost = []
    for record in records:
        moving = Record(record.name, record.rate_hz, record.reading + turn, record.drift, record.temperature)
        rest = np.where(turn == 0.0, 1.0, 0.0)
        taken = slow("drift", moving, rest).estimate - slow("drift", record, rest).estimate
        lost.append(np.nansum(taken[TURN_FROM * RATE_HZ : TURN_TO * RATE_HZ]) / RATE_HZ)
    row("drift, told when it is at rest", [f"{np.mean(lost):.2f}", "0.00", "-", "-"])


def _gain(name: str, record: Record, delta: float, hertz: float, still: FloatArray) -> float:
    t = np.arange(len(still)) / RATE_HZ
    wave = TURN * np.sin(2 * np.pi * hertz * t)
    answer = published(name, record.reading + wave, delta).estimate - still
    late = t >= 20.0
    basis = np.column_stack([np.sin(2 * np.pi * hertz * t), np.cos(2 * np.pi * hertz * t)])[late]
    return float(np.hypot(*np.linalg.lstsq(basis, answer[late], rcond=None)[0]) / TURN)


def journey() -> None:
    """Print what the angle errs by after a minute of motion that follows ten minutes at rest."""
    heading(
        f"Angle error after 60 s in motion, 600 s at rest before, {JOURNEY_SEEDS} seeds, deg",
        ["subtracted", "rms", "of which drift"],
    )
    records = [simulate(660.0, 300 + seed) for seed in range(JOURNEY_SEEDS)]
    still = np.repeat([1.0, 0.0], [600 * RATE_HZ, 60 * RATE_HZ])
    moving = slice(600 * RATE_HZ, None)
    for name in ("nothing", "drift", "exponential 85 s", "hold 60 s", "the truth"):
        whole, slowly = [], []
        for record in records:
            known = record.drift if name == "the truth" else np.zeros(len(record.drift))
            if name not in ("nothing", "the truth"):
                known = slow(name, record, still).estimate
            whole.append(np.sum((record.reading - known)[moving]) / RATE_HZ)
            slowly.append(np.sum((record.drift - known)[moving]) / RATE_HZ)
        row(name, [f"{rms(whole):.3f}", f"{rms(slowly):.3f}"])


def thermal(calm: Sequence[Record], warming: Sequence[Record]) -> None:
    """Print errors of x_k|k when the bias rises by 0.05 deg/s with the temperature."""
    columns = ["method", "with the ramp, against drift and ramp", "ramp removed, against drift"]
    heading("With a thermal ramp of 0.05 deg/s in 60 s: rms error of x_k|k, °/h", columns)
    for delta in DELTAS:
        cells = []
        for records in (warming, calm):
            ramp = THERMAL_RAMP * np.linspace(0, 1, len(calm[0].reading)) if records is warming else 0.0
            errors = [published("SR-UKF", r.reading, delta).estimate - r.drift - ramp for r in records]
            cells.append(f"{rms(np.concatenate(errors)) * HOUR:.0f}")
        row(f"SR-UKF, δ¹ {delta:g}", cells)


def fitted() -> None:
    """Print what a likelihood fit finds, by length."""
    heading(
        "Fits (true: white 127 °/h/√Hz, flicker B 14.0 °/h)",
        ["length", "δ¹ deg/s, by seed", "seeds that show a walk", "white °/h/√Hz", "flicker B °/h"],
    )
    for length, seeds in ((60.0, 12), (600.0, 6), (7200.0, 2)):
        levels, noises = [], []
        for seed in range(seeds):
            record = simulate(length + 1, 200 + seed)
            time_ns = np.arange(len(record.reading), dtype=np.int64) * (1_000_000_000 // RATE_HZ)
            means = means_of(time_ns, np.radians(record.reading))
            levels.append(fit_local_level(means))
            noises.append(fitted_noise(means))
        deltas = [np.degrees(level.best.delta1(1 / RATE_HZ)) for level in levels]
        white = [np.degrees(noise.white) * HOUR for noise in noises]
        flicker = [np.degrees(noise.instability) * HOUR for noise in noises]
        shown = sum(level.identified for level in levels)
        row(
            f"{length:.0f} s",
            [
                f"{min(deltas):.1e} to {max(deltas):.1e}",
                f"{shown} of {seeds}",
                f"{min(white):.0f} to {max(white):.0f}",
                f"{min(flicker):.0f} to {max(flicker):.0f}",
            ],
        )


def on_measured(records: Sequence[Record]) -> None:
    """Print Allan deviations of measured recordings: raw, without temperature, and compensated."""
    names = ["raw", "less cubic in T", "less drift", *(f"{n} {m}" for m in "ab" for n in PUBLISHED)]
    heading(
        "Measured, static: oadev at 2, 10, 100 intervals, °/h; δ¹ and R fitted to the record less the cubic",
        ["record", "rms innovation / sd", "δ¹ deg/s", *names],
    )
    for record in records:
        reading = without_temperature(record)
        delta, noise = fit_record(record, reading)
        series = [record.reading, reading]
        still = Record(record.name, record.rate_hz, reading, record.drift, record.temperature)
        series.append(reading - np.nan_to_num(slow("drift", still).estimate))
        outputs = [published(name, reading, delta, noise) for name in PUBLISHED]
        series += [reading - output.predicted for output in outputs]
        series += [output.estimate for output in outputs]
        taus = [m / record.rate_hz for m in (2, 10, 100)]
        cells = ["/".join(f"{v:.3g}" for v in allan(values, record.rate_hz, taus)) for values in series]
        row(record.name, [f"{innovations(still):.2f}", f"{delta:.1e}", *cells])


def innovations(record: Record) -> float:
    """Return the rms of the normalised innovations of the default estimate."""
    found = default(record)["zupt_innovation_x"]
    return rms(found[np.isfinite(found)])


def endurance() -> None:
    """Run ten million samples of noise, constant input, steps, gaps and motion; say what came out."""
    rng = np.random.default_rng(9)
    total, bad = 0, 0
    linear = LinearFilter(ModelL(0.0, FITTED, 0.0, (0.0, 0.0), (1e-3, 1e-3), VARIANCE), SOFTENING)
    model = ModelNL((0.0, 0.0, 0.0, 1e-2, 0.0), (1e-3, 1e-3, 0.01, 1e-6, 1e-6), VARIANCE)
    filters = {
        f"2μ(R + q) {share:g}, φ {'free' if np.isinf(limit) else 'clamped'}": SigmaPointFilter(
            model, (share / (2 * (VARIANCE + 1e-4)), 0, 0, 0, 0), limit
        )
        for share in (0.0, 0.5, 0.95)
        for limit in (0.9, np.inf)
    }
    for part in range(10):
        z = np.sqrt(VARIANCE) * rng.standard_normal(1_000_000)
        k = np.arange(100_000)
        z[100_000:200_000] += 50 * np.sin(2 * np.pi * 2 * k / RATE_HZ)
        z[300_000:400_000] += 20.0 * ((k // 100) % 2)
        z[500_000:600_000] = 0.25
        z[700_000 + rng.integers(0, 100_000, 30_000)] = np.nan
        z[800_000:900_000] += (part - 5) * k / RATE_HZ
        total += z.size
        outputs = [linear.process(z).estimate]
        for filtered in filters.values():
            result = filtered.process(z)
            outputs += [result.estimate, result.sd, result.phi, result.phi_sd]
        bad += sum(int(np.count_nonzero(~np.isfinite(values))) for values in outputs)
    print(f"\nEndurance: {total:.0e} samples through {len(filters) + 1} filters, {bad} values not finite.")
    heading("Steps", ["filter", "risk made smaller", "φ held back", "φ at the end"])
    for name, filtered in filters.items():
        row(name, [filtered.shrunk_steps, filtered.clamped_steps, f"{filtered.state.mean[PHI]:.2f}"])


if __name__ == "__main__":
    main()
