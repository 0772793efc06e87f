"""What moves a bias, by other physics than that of the regressors that are to find it.

A lag comes from a two-node thermal network, a loop from Bouc and Wen's equation or from relays (Preisach), a
warm-up from two exponentials, a period from a triangle wave whose frequency wanders; a jump takes seconds.
Of recorded columns a supply acts through tanh, a load through two lags, a field through a loop, and a second
thermometer sits where the heat comes later.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.runs import Run

SECONDS = 7200
Generator = np.random.Generator
Column = Callable[[Generator, Run], FloatArray]


def behind(values: FloatArray, tau_s: float) -> FloatArray:
    """Return values a second behind a first-order lag, from equilibrium."""
    decay = np.exp(-1 / tau_s)
    return np.asarray(lfilter([1 - decay], [1.0, -decay], values, zi=[decay * values[0]])[0])


@dataclass(frozen=True, slots=True)
class Thermal:
    """Temperatures of a run: of the thermometer's node and of the die behind it."""

    time_s: FloatArray
    board: FloatArray
    die: FloatArray


def bouc_wen(rng: Generator, temperature: FloatArray) -> FloatArray:
    """Return z of Bouc and Wen's equation with a width of 2 to 6 °C and a random sharpness."""
    width, power, share = rng.uniform(2, 6), rng.uniform(1.0, 2.0), rng.uniform(0.55, 0.9)
    z, out = 0.0, np.empty(len(temperature))
    for at, step in enumerate(np.diff(temperature, prepend=temperature[0])):
        pull = abs(z) ** power * (share * np.sign(step * z) + (1 - share))
        z += step / width * (1 - pull)
        out[at] = z
    return out


def relays(rng: Generator, temperature: FloatArray) -> FloatArray:
    """Return the mean of relays with random thresholds (Preisach)."""
    centre = rng.normal(25, 9, 400)
    half = rng.gamma(2.0, 1.5, 400)
    state = np.where(temperature[0] > centre, 1.0, -1.0)
    out = np.empty(len(temperature))
    for at, value in enumerate(temperature):
        state[value > centre + half] = 1.0
        state[value < centre - half] = -1.0
        out[at] = state.mean()
    return out


Physics = Callable[[Generator, list[Thermal], int], Iterable[FloatArray]]


def _hysteresis(rng: Generator, runs: list[Thermal], axis: int) -> list[FloatArray]:
    seed = int(rng.integers(2**31))
    model = bouc_wen if seed % 2 else relays
    return [model(np.random.default_rng(seed + axis), run.board) for run in runs]


def _warm_up(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    fast, slow, share = rng.uniform(20, 60), rng.uniform(300, 700), rng.uniform(0.0, 0.12)
    return [(1 - share) * np.exp(-run.time_s / slow) + share * np.exp(-run.time_s / fast) for run in runs]


def _drift(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    power = rng.uniform(0.95, 1.05)
    return [(run.time_s / SECONDS) ** power for run in runs]


def _periodic(rng: Generator, runs: list[Thermal], _: int) -> Iterator[FloatArray]:
    period, phase = rng.uniform(130, 900), rng.uniform(0, 1)
    for run in runs:
        wander = np.cumsum(rng.standard_normal(len(run.time_s))) * 2e-4
        turn = run.time_s / period + phase + wander
        yield 2 * np.abs(2 * (turn - np.floor(turn + 0.5))) - 1


def _step(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    return [0.5 + 0.5 * np.tanh((run.time_s - rng.uniform(1500, 5500)) / 4) for run in runs]


def _curve(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    at, width = rng.uniform(20, 32), rng.uniform(5, 8)
    return [np.tanh((run.board - at) / width) for run in runs]


def _offset(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    levels = (0.0, rng.choice([-1.0, 1.0]), rng.uniform(-1, 1))
    return [np.full(len(run.time_s), level) for run, level in zip(runs, levels, strict=True)]


def _telegraph(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    hold = rng.uniform(400, 900)
    return [np.where(np.cumsum(rng.random(len(run.time_s)) < 1 / hold) % 2 == 0, 1.0, -1.0) for run in runs]


def _wander(rng: Generator, runs: list[Thermal], _: int) -> Iterator[FloatArray]:
    decay = np.exp(-1 / rng.uniform(300, 900))
    for run in runs:
        drive = rng.standard_normal(len(run.time_s)) * np.sqrt(1 - decay**2)
        drive[0] = rng.standard_normal()
        yield np.asarray(lfilter([1.0], [1.0, -decay], drive))


def _bursts(rng: Generator, runs: list[Thermal], _: int) -> Iterator[FloatArray]:
    for run in runs:
        out = np.zeros(len(run.time_s))
        for start in rng.uniform(0, SECONDS, rng.integers(10, 25)):
            length = rng.uniform(20, 250)
            out += rng.normal() * ((run.time_s > start) & (run.time_s < start + length))
        yield out


def _supply(rng: Generator, runs: list[Thermal], _: int) -> Iterator[FloatArray]:
    """Yield a supply that a load switches at odd times and that sags and recovers between."""
    for run in runs:
        level, target, out = 0.0, 0.0, np.empty(len(run.time_s))
        tau = rng.uniform(60, 200)
        for at in range(len(out)):
            if rng.random() < 1 / 500:
                target = rng.normal()
            level += (target - level) / tau
            out[at] = level
        yield out


def _relaxation(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return a package whose stress creeps away through thirty barriers of random heights."""
    taus = 10.0 ** rng.uniform(0.5, rng.uniform(4.0, 5.0), 30)
    weights = rng.uniform(0.5, 1.5, 30)
    return [np.exp(-run.time_s[:, np.newaxis] / taus) @ weights for run in runs]


def _dead_time(rng: Generator, runs: list[Thermal], _: int) -> Iterator[FloatArray]:
    """Yield what heat does that goes through twenty layers one after another."""
    layers, total = 20, rng.uniform(60, 300)
    for run in runs:
        value = run.board
        for _ in range(layers):
            value = behind(value, total / layers)
        yield run.board - value


PHYSICS: dict[str, Physics] = {
    "stress_relaxation": _relaxation,
    "dead_time": _dead_time,
    "temperature_rate": lambda _, runs, __: [np.gradient(run.board) for run in runs],
    "thermal_lag": lambda _, runs, __: [run.die - run.board for run in runs],
    "bent": lambda rng, runs, _: _curve(rng, [replace(run, board=run.die) for run in runs], 0),
    "hysteresis": _hysteresis,
    "warm_up": _warm_up,
    "drift": _drift,
    "periodic": _periodic,
    "step": _step,
    "temperature_curve": _curve,
    "run_offset": _offset,
    "telegraph": _telegraph,
    "slow wander": _wander,
    "bursts": _bursts,
    "supply": _supply,
}
NAMED = {"bent": "thermal_lag"}
"""What an effect is called that has another name here."""
OUTSIDE = ("telegraph", "slow wander", "bursts", "supply")


def walk(rng: Generator, run: Run) -> FloatArray:
    """Return a random walk."""
    return np.asarray(np.cumsum(rng.standard_normal(len(run.time_s))))


def ramp(rng: Generator, run: Run) -> FloatArray:
    """Return a battery that runs down, or a tank."""
    return np.asarray(rng.normal() + run.time_s / 7200 * rng.uniform(0.7, 1.3))


def swing(rng: Generator, run: Run) -> FloatArray:
    """Return a swing of its own phase and nearly its own period in each run."""
    period = 10 ** rng.uniform(2.4, 3.7)
    return np.asarray(np.sin(2 * np.pi * (run.time_s / period + rng.random())))


def near_temperature(rng: Generator, run: Run) -> FloatArray:
    """Return what goes with temperature: a supply with a temperature coefficient, and noise of its own."""
    return np.asarray(0.02 * run.mean["temperature"] + 0.02 * rng.standard_normal(len(run.time_s)))


def late_temperature(rng: Generator, run: Run) -> FloatArray:
    """Return a second thermometer, on the housing."""
    late = behind(run.mean["temperature"], rng.uniform(200, 900))
    return np.asarray(np.round((late + 0.02 * rng.standard_normal(len(late))) * 16) / 16)


def noise(rng: Generator, run: Run) -> FloatArray:
    """Return a constant with noise."""
    return np.asarray(5.0 + 0.01 * rng.standard_normal(len(run.time_s)))


def switched(rng: Generator, run: Run) -> FloatArray:
    """Return what is switched between levels at odd times and follows within a minute or three."""
    level = np.cumsum(rng.random(len(run.time_s)) < 1 / 500)
    values = rng.normal(size=int(level[-1]) + 1)[level]
    return behind(values, rng.uniform(60, 200))


IRRELEVANT: dict[str, Column] = {
    "walk_1": walk,
    "walk_2": walk,
    "walk_3": walk,
    "ramp_1": ramp,
    "swing_1": swing,
    "swing_2": swing,
    "load_current": near_temperature,
    "temperature_2": late_temperature,
    "reference_voltage": noise,
    "supply_voltage": switched,
}


@dataclass(frozen=True, slots=True)
class Driving:
    """A column that drives the bias, and what it does."""

    column: str
    made: Column
    does: Callable[[Generator, FloatArray, Run], FloatArray]
    truth: str


DRIVING: dict[str, Driving] = {
    "supply, curved": Driving(
        "supply_voltage", switched, lambda _, v, __: np.tanh(v / 1.5) + 0.2 * v, "curve(supply_voltage)"
    ),
    "pressure, straight": Driving("pressure", walk, lambda _, v, __: v, "curve(pressure)"),
    "load, late": Driving(
        "load_current",
        switched,
        lambda rng, v, __: behind(behind(v, rng.uniform(150, 300)), 40.0),
        "lag(load_current)",
    ),
    "field, loop": Driving(
        "mag_x",
        lambda rng, run: 20.0 * behind(swing(rng, run) + 0.3 * switched(rng, run), 30.0),
        lambda rng, v, __: bouc_wen(rng, v),
        "loop(mag_x)",
    ),
    "pressure, rate": Driving(
        "pressure", switched, lambda _, v, __: behind(np.gradient(v), 10.0), "rate(pressure)"
    ),
    "gradient": Driving(
        "temperature_2",
        lambda rng, run: late_temperature(rng, run) + 2.0 * behind(switched(rng, run), 100.0),
        lambda _, v, run: v - behind(run.mean["temperature"], 20.0),
        "curve(temperature_2)",
    ),
    "vibration": Driving(
        "vibration",
        lambda rng, run: np.asarray(np.exp(switched(rng, run)) * rng.chisquare(297, len(run.time_s)) / 297),
        lambda _, v, __: behind(v, 2.0),
        "curve(vibration)",
    ),
    "supply, with temperature": Driving(
        "supply_voltage",
        switched,
        lambda _, v, run: v * (run.mean["temperature"] - 25.0) / 15.0,
        "product(temperature, supply_voltage)",
    ),
}
