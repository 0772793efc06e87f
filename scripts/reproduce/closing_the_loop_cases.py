"""Runs of a unit whose bias has something that its declared model lacks; the physics is not that of the
regressors.

A lag comes from a two-node thermal network, a loop from Bouc and Wen's equation or from relays (Preisach),
a warm-up from two exponentials, a period from a triangle wave whose frequency wanders, a jump takes
seconds.  Everything is in means of one second, as `imumon.lab.diagnosis.runs` makes them, and fixed by the
seed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.runs import Run

DPH = np.pi / 180 / 3600
SECONDS = 7200
BLOCK = 30
SAMPLES = 100.0
WHITE_DPH = 1.6
"""White noise of a mean of 30 s."""
FLICKER_DPH = 1.0
"""1/f noise between 1/7200 and 1/60 Hz, rms of means of 30 s."""
CURVES = ((30.0, 20.0, -8.0, 3.0), (-10.0, -30.0, 5.0, 2.0), (5.0, 12.0, 10.0, -4.0))
SIGNS = (1.0, -1.0, 1.0)
EARTH_DPH = 15.04
GRAVITY = 9.81

Generator = np.random.Generator


@dataclass(frozen=True, slots=True)
class Thermal:
    """Temperatures of a run: of the thermometer's node and of the die behind it."""

    time_s: FloatArray
    board: FloatArray
    die: FloatArray


@dataclass(frozen=True, slots=True)
class Setting:
    """What a case has beside its effect."""

    effects: tuple[str, ...]
    size: float
    """Training residual of ordinary least squares due to the effect, in standard deviations of the noise."""
    axes: tuple[int, ...] = (0, 1, 2)
    noise: str = "flicker"
    poses: bool = False
    turn_on_dph: float = 0.0
    unequal: bool = False
    start_off_degc: float = 0.0
    latitude_deg: float | None = None
    late: bool = False
    """The whole curve is over the temperature of the die, and is bent beyond a cubic."""
    driver: str = ""
    """Which further column drives the bias, of `closing_the_loop_drivers`; "none" for columns alone."""
    label: str = ""


@dataclass(frozen=True, slots=True)
class Case:
    """Three runs, two for training, and the truth."""

    setting: Setting
    runs: list[Run]
    truth: list[set[str]]
    """Names of the effects in each channel."""
    floor: float
    """rms of all noise in means of 30 s, rad/s."""


def chamber(rng: Generator, up: bool, rate: float, seconds: int = SECONDS) -> FloatArray:
    """Return the air of a chamber: ramps between two ends with soaks."""
    start, high, low = 25 + rng.uniform(-3, 3), 42 + rng.uniform(-3, 3), 12 + rng.uniform(-3, 3)
    soak = rng.uniform(400, 900)
    knots, values = [0.0], [start]
    ends = [high, low] if up else [low, high]
    while knots[-1] < seconds:
        for end in ends:
            knots.append(knots[-1] + abs(end - values[-1]) / rate * 60)
            values.append(end)
            knots.append(knots[-1] + soak)
            values.append(end)
    air: FloatArray = np.interp(np.arange(seconds) + 0.5, knots, values)
    return air


@dataclass(frozen=True, slots=True)
class Network:
    """Two nodes: air to board, board to die, with the die's own heat."""

    board_s: float
    die_s: float
    back: float
    heat_degc: float

    @classmethod
    def drawn(cls, rng: Generator) -> Network:
        """Return that of a unit."""
        return cls(rng.uniform(150, 220), rng.uniform(170, 280), rng.uniform(0.05, 0.2), rng.uniform(0.5, 2))

    def run(self, air: FloatArray, start_off_degc: float) -> Thermal:
        """Return the temperatures of a run from near equilibrium, or from as much off as is said."""
        board, die = np.empty(len(air)), np.empty(len(air))
        b = air[0] + start_off_degc + 0.5 * self.heat_degc
        d = air[0] + 0.2 * start_off_degc + 1.5 * self.heat_degc
        for at, outside in enumerate(air):
            b += (outside - b) / self.board_s + self.back * (d - b) / self.die_s
            d += (b - d + self.heat_degc) / self.die_s
            board[at], die[at] = b, d
        return Thermal(np.arange(len(air), dtype=np.float64) + 0.5, board, die)


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


Physics = Callable[[Generator, list[Thermal], int], list[FloatArray]]


def _rate(_: Generator, runs: list[Thermal], __: int) -> list[FloatArray]:
    return [np.gradient(run.board) for run in runs]


def _lag(_: Generator, runs: list[Thermal], __: int) -> list[FloatArray]:
    return [run.die - run.board for run in runs]


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


def _periodic(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    period, phase = rng.uniform(130, 900), rng.uniform(0, 1)
    found = []
    for run in runs:
        wander = np.cumsum(rng.standard_normal(len(run.time_s))) * 2e-4
        turn = run.time_s / period + phase + wander
        found.append(2 * np.abs(2 * (turn - np.floor(turn + 0.5))) - 1)
    return found


def _step(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    return [0.5 + 0.5 * np.tanh((run.time_s - rng.uniform(1500, 5500)) / 4) for run in runs]


def _curve(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    at, width = rng.uniform(20, 32), rng.uniform(5, 8)
    return [np.tanh((run.board - at) / width) for run in runs]


def _bent(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return a curve over the die's temperature."""
    at, width = rng.uniform(20, 32), rng.uniform(5, 8)
    return [np.tanh((run.die - at) / width) for run in runs]


def _offset(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    levels = (0.0, rng.choice([-1.0, 1.0]), rng.uniform(-1, 1))
    return [np.full(len(run.time_s), level) for run, level in zip(runs, levels, strict=True)]


def _telegraph(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    hold = rng.uniform(400, 900)
    return [np.where(np.cumsum(rng.random(len(run.time_s)) < 1 / hold) % 2 == 0, 1.0, -1.0) for run in runs]


def _wander(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    tau = rng.uniform(300, 900)
    return [_relaxing(rng, len(run.time_s), tau) for run in runs]


def _relaxing(rng: Generator, n: int, tau: float) -> FloatArray:
    from scipy.signal import lfilter

    decay = np.exp(-1 / tau)
    noise = rng.standard_normal(n) * np.sqrt(1 - decay**2)
    noise[0] = rng.standard_normal()
    return np.asarray(lfilter([1.0], [1.0, -decay], noise))


def _bursts(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    found = []
    for run in runs:
        out = np.zeros(len(run.time_s))
        for start in rng.uniform(0, SECONDS, rng.integers(10, 25)):
            length = rng.uniform(20, 250)
            out += rng.normal() * ((run.time_s > start) & (run.time_s < start + length))
        found.append(out)
    return found


def _supply(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return a supply that a load switches at odd times and that sags and recovers between."""
    found = []
    for run in runs:
        level, target, out = 0.0, 0.0, np.empty(len(run.time_s))
        tau = rng.uniform(60, 200)
        for at in range(len(out)):
            if rng.random() < 1 / 500:
                target = rng.normal()
            level += (target - level) / tau
            out[at] = level
        found.append(out)
    return found


def _relaxation(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return a package whose stress creeps away through thirty barriers of random heights."""
    taus = 10.0 ** rng.uniform(0.5, rng.uniform(4.0, 5.0), 30)
    weights = rng.uniform(0.5, 1.5, 30)
    return [np.exp(-run.time_s[:, np.newaxis] / taus) @ weights for run in runs]


def _dead_time(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return what heat does that goes through twenty layers one after another."""
    layers, total = 20, rng.uniform(60, 300)
    found = []
    for run in runs:
        value = run.board
        for _ in range(layers):
            value = _behind(value, total / layers)
        found.append(run.board - value)
    return found


def _behind(value: FloatArray, tau: float) -> FloatArray:
    from scipy.signal import lfilter

    decay = np.exp(-1 / tau)
    return np.asarray(lfilter([1 - decay], [1.0, -decay], value, zi=[decay * value[0]])[0])


PHYSICS: dict[str, Physics] = {
    "stress_relaxation": _relaxation,
    "dead_time": _dead_time,
    "temperature_rate": _rate,
    "thermal_lag": _lag,
    "bent": _bent,
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
POSES = np.array([[0, 0, 1], [0, 0, -1], [0, 1, 0], [0, -1, 0], [1, 0, 0], [-1, 0, 0]], float) * GRAVITY


def make_case(setting: Setting, seed: int) -> Case:
    """Return the case of a setting and a seed."""
    rng = np.random.default_rng(seed)
    network = Network.drawn(rng)
    thermal = [
        network.run(chamber(rng, up, rate), setting.start_off_degc * float(rng.choice([-1, 1])))
        for up, rate in ((True, 1.0), (False, 1.0), (True, 0.7))
    ]
    noise_rms = float(np.hypot(WHITE_DPH, FLICKER_DPH if setting.noise == "flicker" else 0.0))
    poses = [_poses(rng, run, setting.poses) for run in thermal]
    bias = np.zeros((3, 3, SECONDS))
    truth: list[set[str]] = [set(), set(), set()]
    for name in setting.effects:
        for axis in setting.axes:
            for run, part in enumerate(_scaled(rng, name, setting, thermal, poses, axis, noise_rms)):
                bias[run, axis] += part
            truth[axis].add(NAMED.get(name, name))
    runs = [_recorded(rng, run, bias[at], poses[at], setting, at) for at, run in enumerate(thermal)]
    if setting.turn_on_dph:
        for channel in truth:
            channel.add("run_offset")
    return Case(setting, runs, truth, noise_rms * DPH)


def _scaled(
    rng: Generator,
    name: str,
    setting: Setting,
    thermal: list[Thermal],
    poses: list[FloatArray],
    axis: int,
    noise_rms: float,
) -> list[FloatArray]:
    """Return an effect in degrees per hour, scaled so that the declared model leaves `size` times the
    noise."""
    if name == "g_sensitivity":
        row = rng.normal(size=3)
        row[axis] = 0.0 if setting.latitude_deg is not None else row[axis]
        parts = [pose @ row for pose in poses]
    else:
        parts = PHYSICS[name](rng, thermal, axis)
    if setting.unequal:
        parts = [part * factor for part, factor in zip(parts, (0.3, 1.0, 0.6), strict=True)]
    board = np.concatenate([_means(run.board) for run in thermal[:2]])
    columns = ((board - 25) / 20)[:, np.newaxis] ** np.arange(4)
    left = np.concatenate([_means(part) for part in parts[:2]])
    left = left - columns @ np.linalg.lstsq(columns, left, rcond=None)[0]
    factor = SIGNS[axis] * setting.size * noise_rms / float(np.sqrt(np.mean(left**2)))
    return [part * factor for part in parts]


def _means(values: FloatArray) -> FloatArray:
    return np.asarray(values.reshape(-1, BLOCK).mean(axis=1))


def _poses(rng: Generator, run: Thermal, several: bool) -> FloatArray:
    """Return the specific force in body axes, (n, 3)."""
    if not several:
        return np.tile(POSES[0], (len(run.time_s), 1))
    order = rng.permutation(len(POSES))
    which = np.minimum((run.time_s // (SECONDS / len(POSES))).astype(int), len(POSES) - 1)
    return np.asarray(POSES[order[which]])


def _recorded(
    rng: Generator, thermal: Thermal, bias_dph: FloatArray, pose: FloatArray, setting: Setting, at: int
) -> Run:
    """Return what the diagnosis reads: means and scatter of each second."""
    n = len(thermal.time_s)
    reading = np.round((thermal.board + 0.01 * rng.standard_normal(n)) * 16) / 16
    mean: dict[str, FloatArray] = {"temperature": reading}
    variance: dict[str, FloatArray] = {}
    u = ((thermal.die if setting.late else thermal.board) - 25) / 20
    second_sd = WHITE_DPH * np.sqrt(BLOCK)
    for axis, letter in enumerate("xyz"):
        turn_on = (0.0, rng.choice([-1.0, 1.0]), rng.uniform(-1, 1))[at]
        total = np.polynomial.polynomial.polyval(u, CURVES[axis]) + bias_dph[axis]
        total = total + second_sd * rng.standard_normal(n) + _slow(rng, n, setting.noise)
        total = total + setting.turn_on_dph * turn_on
        if setting.latitude_deg is not None:
            total = total + EARTH_DPH * np.sin(np.radians(setting.latitude_deg)) * pose[:, axis] / GRAVITY
        mean[f"gyro_{letter}"] = total * DPH
        scatter = rng.chisquare(SAMPLES - 1, n) / (SAMPLES - 1)
        variance[f"gyro_{letter}"] = (second_sd * DPH) ** 2 * SAMPLES * scatter
        mean[f"accel_{letter}"] = pose[:, axis] + 1e-3 * rng.standard_normal(n)
        variance[f"accel_{letter}"] = np.full(n, 1e-4)
    count = dict.fromkeys(mean, np.full(n, SAMPLES))
    return Run(f"run {at + 1}", thermal.time_s, count, mean, variance, np.ones(n))


def _slow(rng: Generator, n: int, kind: str) -> FloatArray:
    if kind == "white":
        return np.zeros(n)
    if kind == "walk":
        return np.asarray(np.cumsum(rng.standard_normal(n)) * 3.0 / np.sqrt(SECONDS))
    frequency = np.fft.rfftfreq(n, 1.0)
    amplitude = np.zeros(len(frequency))
    band = (frequency >= 1 / 7200) & (frequency <= 1 / 60)
    amplitude[band] = 1 / np.sqrt(frequency[band])
    phasors = rng.standard_normal(len(frequency)) + 1j * rng.standard_normal(len(frequency))
    values = np.fft.irfft(amplitude * phasors, n)
    # Scaled by its expectation, not by what this draw happens to have.
    expected = np.sqrt(2 * np.sum(amplitude**2) * 2) / n
    return np.asarray(FLICKER_DPH * values / expected)
