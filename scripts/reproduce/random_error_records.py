"""Records for the random-error methods: simulated noise of an MTi-28A, and static measurements; deg/s."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import butter, lfilter

from imumon.blocks import FloatArray

RATE_HZ = 100
WHITE_HZ, LOW_PASS_HZ = 1000, 40.0
WHITE = 0.05
"""deg/s/√Hz, one-sided."""
TAUS_S = (1.0, 10.0, 100.0, 1e3, 1e4)
FLICKER = 12.0 / 3600.0
"""deg/s, of each process."""
VARIANCE = 0.1103
"""(deg/s)² of a sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Record:
    """Readings and the true drift in them, (n,), deg/s; NaN where the truth is not known."""

    name: str
    rate_hz: float
    reading: FloatArray
    drift: FloatArray
    temperature: FloatArray


def simulate(seconds: float, seed: int) -> Record:
    """Return MTi-28A noise at rest: white noise through a low-pass, and flicker that starts at zero."""
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE_HZ)
    every = WHITE_HZ // RATE_HZ
    b, a = butter(2, LOW_PASS_HZ, fs=WHITE_HZ)
    warm_up = 100 * every
    fast = WHITE * np.sqrt(WHITE_HZ / 2) * rng.standard_normal(n * every + warm_up)
    white = lfilter(b, a, fast)[warm_up::every][:n]
    drift = np.zeros(n)
    for tau in TAUS_S:
        decay = np.exp(-1.0 / (tau * RATE_HZ))
        drive = FLICKER * np.sqrt(1 - decay**2) * rng.standard_normal(n)
        drift += lfilter([1.0], [1.0, -decay], drive)
    t = np.arange(n) / (n - 1)
    temperature = 37.8 + 2.3 * t
    return Record(f"simulated, {seconds:g} s", RATE_HZ, white + drift, drift, temperature)


def measured(folder: Path) -> list[Record]:
    """Return the static recordings of the data folder, axis by axis, means removed."""
    records = []
    chamber = folder / "chamber-cycle" / "cooling-heating.csv"
    if chamber.exists():
        table = np.genfromtxt(chamber, delimiter=",", names=True)
        rate = (len(table) - 1) / (table["t_s"][-1] - table["t_s"][0])
        for axis in "xyz":
            reading = np.degrees(np.asarray(table[f"gyro_{axis}"], np.float64))
            temperature = np.asarray(table["temperature"], np.float64)
            records.append(_untrue(f"chamber-cycle {axis}", rate, reading, temperature))
    for name in ("cold", "hot"):
        path = folder / "two-levels" / f"{name}.csv"
        if path.exists():
            rows = _rows(path)
            for column, axis in enumerate("xyz", start=4):
                # The file has no times; 100 Hz is assumed, and scales the averaging times only.
                records.append(_untrue(f"two-levels {name} {axis}", 100.0, rows[:, column], rows[:, 0]))
    return records


def _untrue(name: str, rate: float, reading: FloatArray, temperature: FloatArray) -> Record:
    return Record(name, rate, reading - reading.mean(), np.full(len(reading), np.nan), temperature)


def _rows(path: Path) -> FloatArray:
    """Return the lines that have all seven numbers; the rest is a terminal's banner and torn lines."""
    rows = []
    for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
        try:
            row = [float(part) for part in line.split(",")]
        except ValueError:
            continue
        if len(row) == 7:
            rows.append(row)
    table = np.array(rows)
    # A torn line can still have seven numbers: none of them is far from the others' median.
    off = np.abs(table - np.median(table, axis=0))
    return np.asarray(table[(off <= 12 * np.median(off, axis=0) + 1e-9).all(axis=1)])


def without_temperature(record: Record) -> FloatArray:
    """Return the reading less a cubic in temperature, the commonest thermal model."""
    centred = record.temperature - record.temperature.mean()
    scale = np.abs(centred).max() or 1.0
    fit = np.polynomial.polynomial.polyfit(centred / scale, record.reading, 3)
    return np.asarray(record.reading - np.polynomial.polynomial.polyval(centred / scale, fit))
