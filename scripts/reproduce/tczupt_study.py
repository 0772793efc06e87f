"""ZUPT and TCZUPT as published, at equal terms, and beside the stage of imumon: errors of the bias, deg/h."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from dense_record import dense_filter
from samples import crs05_curves, crs05_model, crs05_slopes
from study import Options, Study, Table, matrix

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import Mode, RestAndBias
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.geodesy import DEG_PER_H
from imumon.papers.dense_zupt import DenseSettings
from imumon.papers.fir import FirRate, Params
from imumon.simulation.unit.scenario import load_scenario
from imumon.simulation.unit.unit import SimulatedUnit

RATE_HZ = 100
LATITUDE_DEG = 40.93
ZEROING = 60 * RATE_HZ
STEP = 10
"""Samples to a step of the filter: as good as one, see tests/papers/test_dense_zupt.py."""
THRESHOLD = 1.00e-5 / DEG_PER_H
"""Convergence of the paper, deg/h, held for `HELD` samples."""
HELD = 5 * RATE_HZ
RESIDUAL = 15.0
"""Error of the start, deg/h."""
UP = np.array([0.0, 0.0, -1.0])
ARW = 0.28
"""deg/√h."""
COVERED = 15.0
"""Start covariance that covers the residual, deg/h."""
FIRST_S = 30.0
DESCENT_S, PREDICTED_S = 264, (66, 204)
"""Where the descent begins, and how long it is predicted without updates."""
EFFECTS = {"none": "crs05-ramp", "hysteresis": "crs05-ramp-hysteresis", "lag 30 s": "crs05-ramp-lag"}
"""What the curve lacks, and the scenario that has it."""
MODES: tuple[Mode, ...] = ("standard", "learned", "thermal")


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """A run of the simulated unit: samples at 100 Hz and the truth, rad/s and degC, (n, 3) and (n,)."""

    block: SampleBlock
    gyro: FloatArray
    accel: FloatArray
    temperature: FloatArray
    bias: FloatArray
    earth: FloatArray

    @property
    def seconds(self) -> FloatArray:
        """Time after the zeroing, s."""
        return (np.arange(len(self.gyro)) - ZEROING + 1) / RATE_HZ


def simulate(scenario: str, seed: int) -> Record:
    """Play a scenario."""
    played = load_scenario(scenario)
    sent, truth = SimulatedUnit(played, seed).run(played.samples)
    vectors = matrix(sent, "gyro"), matrix(sent, "accel"), truth["temperature"], matrix(truth, "gyro_bias")
    return Record(sent.with_columns({"at_rest": truth["at_rest"]}), *vectors, matrix(truth, "rate")[0])


@dataclass(frozen=True, slots=True)
class Filter:
    """One filter of the comparison: K in deg/h/sqrt(s), p0 in deg/h.

    `thermal` is None (raw data as they are), calibrated, rate (published form), fir (the same with the rate
    from the reading), increments, or reading (increments of the curve at the reading).
    """

    thermal: str | None
    k: float = 0.1
    p0: float = 2.2


def run(record: Record, chosen: Filter, residual: float = 0.0) -> FloatArray:
    """Return the error of the bias after the zeroing, deg/h, (n, 3)."""
    at = record.block["temperature"] if chosen.thermal == "reading" else record.temperature
    thermal = crs05_curves(at)
    subtracted = thermal if chosen.thermal == "calibrated" else np.zeros_like(thermal)
    gyro, drift = record.gyro - subtracted, None
    if chosen.thermal in ("increments", "reading"):
        drift = np.diff(thermal, axis=0)[ZEROING - 1 :]
    elif chosen.thermal in ("rate", "fir"):
        rate = fir_rate(record) if chosen.thermal == "fir" else np.gradient(record.temperature) * RATE_HZ
        drift = (crs05_slopes(record.temperature) * rate[:, np.newaxis] / RATE_HZ)[ZEROING:]
    start = (gyro[:ZEROING] - record.earth).mean(0) + residual * DEG_PER_H
    part = slice(ZEROING, None)
    settings = replace(
        DenseSettings(1.0 / RATE_HZ), bias_random_walk=chosen.k * DEG_PER_H, bias_sd=chosen.p0 * DEG_PER_H
    )
    result = dense_filter(settings, gyro[part], record.accel[part], start, drift, UP, STEP)
    return np.asarray((result.bias + (subtracted - record.bias)[part]) / DEG_PER_H)


def fir_rate(record: Record) -> FloatArray:
    """Return the rate by the published estimator (window 300 s, constant 180 s, 90 measurements), degC/s."""
    time_ns, segment = record.block["device_time_ns"], record.block["segment"]
    result = FirRate(Params(0.05)).process(time_ns, segment, record.block["temperature"])
    return np.nan_to_num(result.rate)


def convergence_s(error: FloatArray) -> FloatArray:
    """Return when each axis is within the threshold for the first time for 5 s, s, (3,); infinity: never."""
    times = np.full(3, np.inf)
    for j in range(3):
        inside = np.concatenate([[0], np.cumsum(np.abs(error[:, j]) < THRESHOLD)])
        whole = np.flatnonzero(inside[HELD:] - inside[:-HELD] == HELD)
        if len(whole):
            times[j] = (whole[0] + 1) / RATE_HZ
    return times


def three(values: FloatArray, digits: int = 2) -> str:
    """Write x, y, z."""
    return " ".join(f"{value:.{digits}f}" for value in values)


def rms(errors: Sequence[FloatArray], stop_s: float | None = None) -> FloatArray:
    """Return the root mean square over all records, deg/h, (3,)."""
    stop = None if stop_s is None else round(stop_s * RATE_HZ)
    return np.asarray(np.sqrt(np.mean(np.concatenate([error[:stop] for error in errors]) ** 2, axis=0)))


def averages(records: Sequence[Record]) -> Table:
    """Table 5: the centred moving average of 30 s that the paper takes for the truth."""
    width, found = 30 * RATE_HZ, []
    for record in records:
        total = np.cumsum(np.vstack([np.zeros(3), record.gyro - record.earth]), axis=0)
        n = np.arange(len(record.gyro))
        low, high = (np.clip(n + sign * width // 2, 0, len(n)) for sign in (-1, 1))
        found.append((total[high] - total[low]) / (high - low)[:, np.newaxis])
    off = [(mean - r.bias)[ZEROING:] / DEG_PER_H for mean, r in zip(found, records, strict=True)]
    raw = [
        (r.gyro - r.earth - mean)[ZEROING:].mean(0) / DEG_PER_H
        for mean, r in zip(found, records, strict=True)
    ]
    heads = ["mean residual about it", "its rms error against the truth", "60 ARW/√(30 s)"]
    cells = [three(np.mean(raw, axis=0), 3), three(rms(off)), f"{60 * ARW / np.sqrt(30):.2f}"]
    return Table("Table 5: the moving average of 30 s, deg/h, x y z", heads, [cells])


def comparison(records: Sequence[Record]) -> Table:
    """All filters at equal K and p0; as published, ZUPT has a K of 0.1, TCZUPT of 0.5, and p0 is 2.2."""
    entered = {"ZUPT": "calibrated", "TCZUPT": "rate", "TCZUPT by increments": "increments"}
    rows = []
    for (k, p0), (name, thermal) in product(product((0.1, 0.5), (2.2, COVERED)), entered.items()):
        cells = [name, f"{k}", f"{p0}"]
        for residual in (0.0, RESIDUAL):
            errors = [run(record, Filter(thermal, k, p0), residual) for record in records]
            cells += [three(rms(errors, FIRST_S)), three(rms(errors))]
        times = np.array([convergence_s(error) for error in errors])
        rows.append(
            [*cells, three(np.median(times, axis=0), 0), " ".join(map(str, np.isfinite(times).sum(0)))]
        )
    limit = ", ".join(f"{60 * ARW / np.sqrt(t):.2f} after {t} s" for t in (10, 30, 60, 120, 300))
    heads = ["filter", "K", "p0", "residual 0: 30 s", "all", "residual 15: 30 s", "all"]
    return Table(
        "Tables 6, 7 and 12 (ZUPT with K 0.1, TCZUPT with 0.5, p0 2.2), and equal terms: rms, deg/h, x y z",
        [*heads, "converged, s", "records"],
        rows,
        f"Information limit of the noise alone, 60 ARW/√t: {limit}.",
    )


def stage_error(record: Record, mode: Mode) -> FloatArray:
    """Return the error of the stage after the zeroing, deg/h, (n, 3)."""
    model = crs05_model() if mode == "thermal" else None
    added = SampleBlock(
        RestAndBias(GyroBiasParameters(assume_at_rest=True), model, mode, LATITUDE_DEG, 0.0).process(
            record.block
        )
    )
    return np.asarray((matrix(added, "gyro_bias") - record.bias)[ZEROING:] / DEG_PER_H)


def thermal_terms(count: int) -> Table:
    """Where the thermal term pays, and what it does to effects that the curve lacks."""
    terms = {
        "raw, no thermal term": None,
        "ZUPT": "calibrated",
        "TCZUPT by increments": "increments",
        "increments of the reading (0.05 degC steps)": "reading",
        "slope x FIR rate": "fir",
    }
    rows = []
    for effect, scenario in EFFECTS.items():
        records = [simulate(scenario, seed) for seed in range(count)]
        for name, thermal in terms.items():
            errors = [[run(r, Filter(thermal, k, COVERED)) for r in records] for k in (0.1, 0.5)]
            rows.append([effect, name, *(three(rms(each)) for each in errors)])
        for mode in MODES:
            rows.append([effect, f"imumon {mode}", three(rms([stage_error(r, mode) for r in records])), ""])
    title = f"Thermal terms, p0 15, {count} records: rms, deg/h, x y z; imumon finds K by itself"
    return Table(title, ["effect beside the curve", "thermal term", "K 0.1", "K 0.5"], rows)


def predicted(record: Record) -> Table:
    """What the bias of y moves by without updates in the descent, and what predictions of that err by."""
    rows = []
    begin = ZEROING + DESCENT_S * RATE_HZ
    thermal, reading = (
        crs05_curves(t)[:, 1] / DEG_PER_H for t in (record.temperature, record.block["temperature"])
    )
    by_rate = np.cumsum(crs05_slopes(record.temperature)[:, 1] * fir_rate(record)) / RATE_HZ / DEG_PER_H
    for seconds in PREDICTED_S:
        stop = min(begin + seconds * RATE_HZ, len(record.gyro) - 1)
        truth = thermal[stop] - thermal[begin]
        errors = (-truth, by_rate[stop] - by_rate[begin] - truth, reading[stop] - reading[begin] - truth)
        rows.append([f"{seconds} s", *(f"{error:.1f}" for error in errors)])
    heads = ["for", "held", "slope x FIR rate", "increments of the reading"]
    return Table("Predicted without updates, descent, y axis: error, deg/h", heads, rows)


def tables(given: Options) -> Iterator[Table]:
    """Yield all tables."""
    records = [simulate("crs05-ramp", seed) for seed in given.seeds]
    yield averages(records)
    if not given.quick:
        yield comparison(records)
        yield thermal_terms(min(len(records), 4))
    yield predicted(records[0])


STUDY = Study(tables, seeds=8, page="appendix/tczupt-results.md")
