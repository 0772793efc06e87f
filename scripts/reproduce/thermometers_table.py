"""Every kind of thermometer against constant, drifting and ramping temperatures: the worst row first."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterable

import numpy as np
from thermometer_kinds import KINDS, PER_HOUR, Kind, Profile, constant, drifting, ramp, thermostat
from thermometers_bias import bias_rows

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.filters.rates import RateMethod

STEADY_S, SETTLED_S = 1800.0, 600.0
RAMP_S, ONSET_S = 300.0, 20.0
HOLDS_S = (60.0, 300.0, 1200.0)
THERMOSTATS = {
    "0.8 °C, 4 min": thermostat(0.8, 240.0),
    "0.8 °C, 4 min, lag 1 min": thermostat(0.8, 240.0, 60.0),
    "1 °C, 15 min, lag 40 s": thermostat(1.0, 900.0, 40.0),
    "6 °C, 20 min": thermostat(6.0, 1200.0),
}
CYCLING_S = 5400.0
BLOCK_S = 10.0


def errors(
    kind: Kind,
    profile: Profile,
    seconds: float,
    seed: int,
    new_method: Callable[[], RateMethod] | None = None,
) -> dict[str, FloatArray]:
    """Return once a second: time, errors of temperature and rate (°C, °C/h), and both in units of sigma."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * kind.rate_hz)) / kind.rate_hz
    temperature, rate = profile(t, 25.0 + rng.uniform(-0.5, 0.5))
    reading = kind.read(temperature, rng)
    stage = TemperatureRate(new_method=new_method)
    time_ns = np.round(t * 1e9).astype(np.int64)
    length = max(round(BLOCK_S * kind.rate_hz), 1)
    parts = []
    for i in range(0, len(t), length):
        rows = slice(i, i + length)
        columns = {"device_time_ns": time_ns[rows], "segment": np.zeros(len(t[rows]), np.int64)}
        parts.append(stage.process(SampleBlock({**columns, "temperature": reading[rows]})))
    names = ("temperature_estimate", "temperature_rate", "temperature_estimate_sd", "temperature_rate_sd")
    each = slice(max(round(kind.rate_hz), 1) - 1, None, max(round(kind.rate_hz), 1))
    estimate, slope, sd, slope_sd = (np.concatenate([part[name] for part in parts])[each] for name in names)
    off, slope_off = estimate - temperature[each], slope - rate[each]
    return {
        "t": t[each],
        "temperature": off,
        "rate": slope_off * PER_HOUR,
        "z": off / sd,
        "rate_z": slope_off / slope_sd,
    }


def rms(x: FloatArray) -> float:
    """Return the root mean square of what there is."""
    return float(np.sqrt(np.mean(x[np.isfinite(x)] ** 2))) if np.isfinite(x).any() else np.nan


def largest(x: FloatArray) -> float:
    """Return the largest absolute value, NaN where there is none."""
    return float(np.nanmax(np.abs(x))) if np.isfinite(x).any() else np.nan


def steady_row(kind: Kind, profile: Profile, seeds: range) -> list[float]:
    """Return rms of the rate's error, rms and max of its z, max of temperature's error and of its z."""
    runs = [errors(kind, profile, STEADY_S, seed) for seed in seeds]
    late = {name: np.concatenate([run[name][run["t"] > SETTLED_S] for run in runs]) for name in runs[0]}
    return [
        rms(late["rate"]),
        rms(late["rate_z"]),
        largest(late["rate_z"]),
        largest(late["temperature"]),
        largest(late["z"]),
    ]


def thermostat_row(kind: Kind, profile: Profile, seeds: range) -> list[float]:
    """Return rms of the rate's error, rms and max of its z, the share beyond 3; max of temperature's z."""
    runs = [errors(kind, profile, CYCLING_S, seed) for seed in seeds]
    late = {name: np.concatenate([run[name][run["t"] > CYCLING_S / 3.0] for run in runs]) for name in runs[0]}
    beyond = float(np.mean(np.abs(late["rate_z"]) > 3.0))
    return [rms(late["rate"]), rms(late["rate_z"]), largest(late["rate_z"]), beyond, largest(late["z"])]


def ramp_row(kind: Kind, hold_s: float, seeds: range) -> list[float]:
    """Return the largest error of temperature after the hold; later z, the rate's, its rms."""
    worst = np.full(4, np.nan)
    for seed in seeds:
        run = errors(kind, ramp(hold_s), hold_s + RAMP_S, seed)
        after, later = run["t"] > hold_s, run["t"] > hold_s + ONSET_S + kind.refresh_s
        numbers = [
            largest(run["temperature"][after]),
            largest(run["z"][later]),
            largest(run["rate_z"][later]),
            rms(run["rate"][later]),
        ]
        worst = np.fmax(worst, numbers)
    return worst.tolist()


def main() -> None:
    """Print the four tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--kinds", default="", help="only kinds with this text in the name")
    parser.add_argument("--holds", type=float, nargs="*", default=HOLDS_S)
    parser.add_argument(
        "--part", choices=("steady", "thermostat", "ramp", "bias"), help="only one of the tables"
    )
    given = parser.parse_args()
    seeds = range(given.first, given.first + given.seeds)
    kinds = [kind for kind in KINDS if given.kinds in kind.name]
    if given.part in (None, "steady"):
        print(
            "| thermometer | temperature | rate rms °C/h | rate z rms | z max | temperature max °C | z max |"
        )
        print("|---|---|---|---|---|---|---|")
        profiles = (("constant", constant), ("5 °C/h", drifting))
        show((k.name, name, steady_row(k, profile, seeds)) for k in kinds for name, profile in profiles)
    if given.part in (None, "thermostat"):
        print("\n| thermometer | swing, period | rate rms °C/h | rate z rms | z max | beyond 3 | z max |")
        print("|---|---|---|---|---|---|---|")
        cycling = ((k, name, profile) for k in kinds for name, profile in THERMOSTATS.items())
        show((k.name, name, thermostat_row(k, profile, seeds)) for k, name, profile in cycling)
    if given.part in (None, "ramp"):
        print(
            "\n| thermometer | hold s | temperature max °C "
            "| z max from 20 s + a refresh | rate z max | rate rms °C/h |"
        )
        print("|---|---|---|---|---|---|")
        show((k.name, f"{hold:g}", ramp_row(k, hold, seeds)) for k in kinds for hold in given.holds)
    if given.part in (None, "bias"):
        print("\n| thermometer | case | bias with the estimate °/h | over that with the reading | that °/h |")
        print("|---|---|---|---|---|")
        show((k.name, name, row) for k in kinds for name, row in bias_rows(k, seeds))


def show(rows: Iterable[tuple[str, str, list[float]]]) -> None:
    """Print rows, those first whose second number is largest; say on the way how far it has come."""
    done = []
    for row in rows:
        print(row, file=sys.stderr, flush=True)
        done.append(row)
    for kind, case, numbers in sorted(done, key=lambda row: -np.nan_to_num(row[2][1])):
        print(f"| {kind} | {case} | " + " | ".join(f"{x:.3g}" for x in numbers) + " |", flush=True)


if __name__ == "__main__":
    main()
