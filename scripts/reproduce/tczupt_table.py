"""ZUPT and TCZUPT as published, at equal terms, and beside the stage of imumon: errors of the bias, deg/h."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import product

import numpy as np
from study import Options, Study, Table
from tczupt_chain import Chain, calibration_errors, run_chain
from tczupt_figures import draw
from tczupt_records import (
    DPH,
    LATITUDE_DEG,
    RATE_HZ,
    RESIDUAL,
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

ARW = 0.28
"""deg/√h."""
COVERED = 15.0
"""Start covariance that covers the residual, deg/h."""
FIRST_S = 30.0
SOAKS = 1000
"""Seed of the first soak: its noise is not that of the ramp."""
DESCENT_S = 264
PREDICTED_S = (66, 204)
EFFECTS = {"none": "crs05-ramp", "hysteresis": "crs05-ramp-hysteresis", "lag 30 s": "crs05-ramp-lag"}
"""What the curve lacks, and the scenario that has it."""
MODES: Mapping[str, Mode] = {"standard": "standard", "learned": "learned", "thermal": "thermal"}
HEADS = (
    "filter", "K", "p0", "residual 0: 30 s", "all", "residual 15: 30 s", "all", "converged, s", "records",
)  # fmt: skip


def three(values: FloatArray, digits: int = 2) -> str:
    """Write x, y, z."""
    return " ".join(f"{value:.{digits}f}" for value in values)


def rms(errors: Sequence[FloatArray], stop_s: float | None = None) -> FloatArray:
    """Return the root mean square over all records, deg/h, (3,)."""
    stop = None if stop_s is None else round(stop_s * RATE_HZ)
    return np.asarray(np.sqrt(np.mean(np.concatenate([error[:stop] for error in errors]) ** 2, axis=0)))


def compared(name: str, records: Sequence[Record], chosen: Sequence[Filter]) -> list[str]:
    """Return the row of a filter, which has a setting for each record: a soak has its own calibration.

    Converged is within 1.00e-5 rad/s for 5 s, the median over the records and how many of them get there.
    """
    cells = [name, f"{chosen[0].k}", f"{chosen[0].p0}"]
    for residual in (0.0, RESIDUAL):
        errors = [run(record, one, residual) for record, one in zip(records, chosen, strict=True)]
        cells += [three(rms(errors, FIRST_S)), three(rms(errors))]
    times = np.array([convergence_s(error) for error in errors])
    middle = np.median(np.nan_to_num(times, nan=np.inf), axis=0)
    return [*cells, three(middle, 0), " ".join(map(str, np.isfinite(times).sum(0)))]


def comparison(records: Sequence[Record], chains: Sequence[Chain]) -> Table:
    """All filters at equal K and p0; as published, ZUPT has a K of 0.1, TCZUPT of 0.5, and p0 is 2.2."""
    entered = {
        f"{name}, true curve": [Filter(thermal)] * len(records)
        for name, thermal in (
            ("ZUPT", "calibrated"),
            ("TCZUPT", "rate"),
            ("TCZUPT by increments", "increments"),
        )
    }
    entered |= {
        f"{name}, whole chain": [one.filters[name] for one in chains]
        for name in (chains[0].filters if chains else ())
    }
    rows = []
    for (k, p0), (name, chosen) in product(product((0.1, 0.5), (2.2, COVERED)), entered.items()):
        rows.append(compared(name, records, [replace(one, k=k, p0=p0) for one in chosen]))
    apart = max(
        float(
            np.abs(
                run(record, Filter("calibrated"), RESIDUAL) - run(record, Filter("increments"), RESIDUAL)
            ).max()
        )
        for record in records
    )
    limit = ", ".join(f"{60 * ARW / np.sqrt(t):.2f} after {t} s" for t in (10, 30, 60, 120, 300))
    note = (
        f"At equal K and p0 ZUPT and TCZUPT by increments differ by at most {apart:.1e} deg/h.  Information"
        f" limit of the noise alone, 60 ARW/√t: {limit}."
    )
    return Table(
        "Tables 6, 7 and 12 (ZUPT with K 0.1, TCZUPT with 0.5, p0 2.2), and equal terms: rms, deg/h, x y z",
        HEADS,
        rows,
        note,
    )


def averages(records: Sequence[Record]) -> Table:
    """Table 5: the moving average that the paper takes for the truth."""
    off = [(moving_average(r) - r.bias)[ZEROING:] / DPH for r in records]
    raw = [(r.gyro - r.earth - moving_average(r))[ZEROING:].mean(0) / DPH for r in records]
    heads = ["mean residual about it", "its rms error against the truth", "60 ARW/√(30 s)"]
    cells = [three(np.mean(raw, axis=0), 3), three(rms(off)), f"{60 * ARW / np.sqrt(30):.2f}"]
    return Table("Table 5: the moving average of 30 s, deg/h, x y z", heads, [cells])


def calibrated(chains: Sequence[Chain]) -> Table:
    """What the networks of the soaks got wrong, which the filters of the whole chain have to live with."""
    residual = np.sqrt(np.mean(np.square([[t.residual for t in one.bias] for one in chains]), axis=0)) / DPH
    bad = np.sum([[t.bad for t in one.bias] for one in chains], axis=0)
    rows = "; ".join(f"{axis} {three(row)}" for axis, row in zip("xyz", residual, strict=True))
    note = (
        f"{len(chains)} soaks of their own noise, {chains[0].samples} settled means of 30 s; rms residual of"
        f" training, validation and test means, deg/h: {rows}; starts that ended badly:"
        f" {' '.join(map(str, bad))} of {RESTARTS * len(chains)}."
    )
    title = "Errors of the calibration between 27.28 and 34.08 degC, rms"
    return Table(title, ["error", "x", "y", "z"], calibration_errors(chains), note)


def stage_error(record: Record, mode: Mode) -> FloatArray:
    """Return the error of the stage after the zeroing, deg/h, (n, 3)."""
    model = true_model() if mode == "thermal" else None
    added = GyroBias(None, model, mode, LATITUDE_DEG, 0.0).process(record.block)
    bias = np.column_stack([added[f"gyro_bias_{axis}"] for axis in "xyz"])
    return np.asarray((bias - record.bias)[ZEROING:] / DPH)


def thermal_terms(count: int) -> Table:
    """Where the thermal term pays, and what it does to effects that the curve lacks."""
    terms = {
        "raw, no thermal term": Filter(None),
        "ZUPT": Filter("calibrated"),
        "TCZUPT by increments": Filter("increments"),
        "increments of the reading (0.05 degC steps)": Filter("increments", temperature="reading"),
        "slope x FIR rate": Filter("fir"),
    }
    rows = []
    for effect, scenario in EFFECTS.items():
        records = [simulate(scenario, seed) for seed in range(count)]
        for name, one in terms.items():
            errors = [[run(r, replace(one, k=k, p0=COVERED)) for r in records] for k in (0.1, 0.5)]
            rows.append([effect, name, *(three(rms(each)) for each in errors)])
        for name, mode in MODES.items():
            rows.append([effect, f"imumon {name}", three(rms([stage_error(r, mode) for r in records])), ""])
    title = f"Thermal terms, p0 15, {count} records: rms, deg/h, x y z; imumon finds K by itself"
    return Table(title, ["effect beside the curve", "thermal term", "K 0.1", "K 0.5"], rows)


def predicted(record: Record) -> Table:
    """What the bias of y moves by without updates in the descent, and what predictions of that err by."""
    rows = []
    begin = ZEROING + DESCENT_S * RATE_HZ
    thermal, reading = (curves(t)[:, 1] / DPH for t in (record.temperature, record.block["temperature"]))
    by_rate = np.cumsum(slopes(record.temperature)[:, 1] * fir_rate(record)) / RATE_HZ / DPH
    for seconds in PREDICTED_S:
        stop = min(begin + seconds * RATE_HZ, len(record.gyro) - 1)
        truth = thermal[stop] - thermal[begin]
        errors = (-truth, by_rate[stop] - by_rate[begin] - truth, reading[stop] - reading[begin] - truth)
        rows.append([f"{seconds} s", *(f"{error:.1f}" for error in errors)])
    heads = ["for", "held", "slope x FIR rate", "increments of the reading"]
    return Table("Predicted without updates, descent, y axis: error, deg/h", heads, rows)


def tables(given: Options) -> Iterator[Table]:
    """Yield all tables; the quick one is without the whole chain."""
    records = [simulate("crs05-ramp", seed) for seed in given.seeds]
    yield averages(records)
    if given.quick:
        yield predicted(records[0])
        return
    chains = [
        run_chain(SOAKS + seed, record.earth) for seed, record in zip(given.seeds, records, strict=True)
    ]
    yield calibrated(chains)
    yield comparison(records, chains)
    yield thermal_terms(min(len(records), 4))
    yield predicted(records[0])


STUDY = Study(tables, seeds=8, page="appendix/tczupt-results.md", draw=draw)
