"""Thermometers as they are sold, temperatures to put them to, and what the stage makes of them."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from samples import sent
from scipy.signal import lfilter

from imumon.blocks import FloatArray
from imumon.estimation.temperature_rate.stage import RateMethod, TemperatureRate

Generator = np.random.Generator
Noise = Callable[[int, float, Generator], FloatArray]
Profile = Callable[[FloatArray, float], tuple[FloatArray, FloatArray]]
PER_HOUR = 3600.0
STEADY_S, SETTLED_S = 1800.0, 600.0
ONSET_S = 20.0
"""After the begin of a ramp, and of a record."""


@dataclass(frozen=True, slots=True)
class Kind:
    """A thermometer in a stream."""

    name: str
    step: float
    """Quantization, °C; 0 for none."""
    noise: Noise
    """Before the quantizer, °C: of the number of refreshes, their rate in Hz and a generator."""
    rate_hz: float = 100.0
    refresh_s: float = 0.0
    """Every so often there is a new reading, which is repeated in between; 0 for every sample."""
    after: Callable[[FloatArray], FloatArray] | None = None
    """What happens to the readings on their way."""

    def read(self, temperature: FloatArray, rng: Generator) -> FloatArray:
        """Return the readings of a temperature at the stream's samples, (n,)."""
        repeat = max(round(self.refresh_s * self.rate_hz), 1)
        x = temperature[::repeat]
        x = x + self.noise(len(x), self.rate_hz / repeat, rng)
        if self.step:
            x = self.step * np.round(x / self.step)
        if self.after is not None:
            x = self.after(x)
        return np.asarray(np.repeat(x, repeat)[: len(temperature)])


def white(sd: float) -> Noise:
    """Return white noise of this standard deviation."""
    return lambda n, _, rng: sd * rng.standard_normal(n)


def correlated(sd: float, time_s: float) -> Noise:
    """Return a first-order Gauss-Markov process: also white noise behind a low pass of the chip."""

    def make(n: int, rate_hz: float, rng: Generator) -> FloatArray:
        keep = np.exp(-1.0 / (rate_hz * time_s))
        drive = np.sqrt(1.0 - keep**2) * rng.standard_normal(n)
        drive[0] = rng.standard_normal()
        return np.asarray(sd * lfilter([1.0], [1.0, -keep], drive))

    return make


def flicker(sd: float) -> Noise:
    """Return 1/f noise from a cycle per record to half the sampling rate, of this standard deviation."""

    def make(n: int, rate_hz: float, rng: Generator) -> FloatArray:
        frequency = np.fft.rfftfreq(n, 1.0 / rate_hz)
        frequency[0] = np.inf
        x = np.fft.irfft(np.fft.rfft(rng.standard_normal(n)) / np.sqrt(frequency), n)
        return np.asarray(sd * x / x.std())

    return make


def averaged(sd: float, length: int) -> Noise:
    """Return a moving mean of so many samples of white noise, of this standard deviation in the end."""
    kernel = np.full(length, 1 / length)
    return lambda n, _, rng: np.asarray(
        sd * np.sqrt(length) * np.convolve(rng.standard_normal(n + length - 1), kernel, "valid")
    )


def telegraph(size: float, time_s: float) -> Noise:
    """Return popcorn noise: a random telegraph between ±size/2 that stays for this time on average."""
    return lambda n, rate_hz, rng: np.asarray(
        size * (np.cumsum(rng.random(n) < 1.0 / (time_s * rate_hz)) % 2 - 0.5)
    )


def both(*parts: Noise) -> Noise:
    """Return the sum of noises."""
    return lambda n, rate_hz, rng: np.asarray(sum(part(n, rate_hz, rng) for part in parts))


def sticky(step: float) -> Callable[[FloatArray], FloatArray]:
    """Return a reading that follows only when it is off by more than a step (hysteresis against flicker)."""

    def stick(reading: FloatArray) -> FloatArray:
        out = np.empty_like(reading)
        held = reading[0]
        for i, x in enumerate(reading):
            if abs(x - held) > 1.5 * step:
                held = x - np.sign(x - held) * step
            out[i] = held
        return out

    return stick


FINE, COARSE, MPU = 0.0625, 1.0, 1.0 / 340.0

KINDS = [
    *(Kind(f"white {s} step", FINE, white(s * FINE)) for s in (0, 0.03, 0.1, 0.2, 0.3, 0.4)),
    *(Kind(f"white {s} step", FINE, white(s * FINE)) for s in (0.45, 0.5, 0.55, 0.7, 1, 3, 20)),
    *(Kind(f"white {s} step, 10 Hz", FINE, white(s * FINE), 10.0) for s in (0.25, 0.5)),
    *(Kind(f"refresh {t:g} s, 0.3 step", FINE, white(0.3 * FINE), 100.0, t) for t in (0.1, 1, 4, 10, 60)),
    *(Kind(f"refresh 1 s, {s} step", FINE, white(s * FINE), 100.0, 1.0) for s in (0.1, 0.5, 2)),
    *(Kind(f"1 °C, white {s} step", COARSE, white(s * COARSE)) for s in (0.05, 0.3, 0.45, 1)),
    Kind("1 °C, refresh 1 s, 0.45 step", COARSE, white(0.45), 100.0, 1.0),
    *(Kind(f"correlated {t:g} s, 0.5 step", FINE, correlated(0.5 * FINE, t)) for t in (0.2, 1, 5, 50)),
    *(Kind(f"correlated 5 s, {s} step", FINE, correlated(s * FINE, 5.0)) for s in (0.1, 2)),
    *(Kind(f"1/f, {s} step", FINE, flicker(s * FINE)) for s in (0.1, 0.5, 3)),
    Kind("moving mean of 64, 0.5 step", FINE, averaged(0.5 * FINE, 64)),
    Kind("popcorn 1 step, 20 s, white 0.2", FINE, both(telegraph(FINE, 20.0), white(0.2 * FINE))),
    Kind("hysteresis of a step, white 0.1", FINE, white(0.1 * FINE), 10.0, 0.0, sticky(FINE)),
    Kind("0.0625 written as 0.01, 0.2 step", FINE, white(0.2 * FINE), after=lambda x: np.round(x, 2)),
    Kind("no steps, white 0.02 °C", 0.0, white(0.02)),
    Kind("no steps, white 0.3 °C", 0.0, white(0.3)),
    Kind("0.0029 °C, 17 steps white and 1/f", MPU, both(white(0.05), flicker(0.02))),
    Kind("0.0039 °C, 1/f of 1 step, 1 Hz", 1 / 256, flicker(1 / 256), 100.0, 1.0),
    Kind("0.05 °C, 2 Hz stream, 0.3 step", 0.05, white(0.015), 2.0),
    *(
        Kind(f"refresh {t:g} s, {s} step, 20 Hz", FINE, white(s * FINE), 20.0, t)
        for t in (1, 10, 60)
        for s in (0, 1)
    ),
    Kind("white 0.3 step, 1 kHz", FINE, white(0.3 * FINE), 1000.0),
    Kind("refresh 1 s, 0.3 step, 1 kHz", FINE, white(0.3 * FINE), 1000.0, 1.0),
    Kind("refresh 1 s, correlated 5 s, 0.5 step", FINE, correlated(0.5 * FINE, 5.0), 100.0, 1.0),
    Kind("refresh 10 s, 1/f, 0.5 step", FINE, flicker(0.5 * FINE), 20.0, 10.0),
    Kind("0.001 °C, white 0.5 step", 0.001, white(0.0005)),
    Kind("0.001 °C, 1/f, 20 steps", 0.001, flicker(0.02)),
    Kind("0.25 °C, refresh 10 s, 0.1 step", 0.25, white(0.025), 20.0, 10.0),
    Kind("0.5 °C, 1/f, 0.3 step", 0.5, flicker(0.15), 20.0),
    Kind("IIR of 16 at 10 Hz, 1 step", FINE, correlated(FINE, 1.6), 100.0, 0.1),
    Kind("IIR of 16 at 1 Hz, 0.5 step", FINE, correlated(0.5 * FINE, 16.0), 20.0, 1.0),
    Kind("popcorn 3 steps, 60 s, white 0.5", FINE, both(telegraph(3 * FINE, 60.0), white(0.5 * FINE)), 20.0),
    Kind("popcorn 0.3 step, 5 s, white 0.1", FINE, both(telegraph(0.3 * FINE, 5.0), white(0.1 * FINE)), 20.0),
    Kind("hysteresis of a step, no noise", FINE, white(0.0), 20.0, 0.0, sticky(FINE)),
    Kind("hysteresis of a step, white 0.5", FINE, white(0.5 * FINE), 20.0, 0.0, sticky(FINE)),
]


def constant(t: FloatArray, start: float) -> tuple[FloatArray, FloatArray]:
    """Return a temperature that stays."""
    return np.full(len(t), start), np.zeros(len(t))


def drifting(t: FloatArray, start: float) -> tuple[FloatArray, FloatArray]:
    """Return 5 °C/h."""
    return start + 5.0 / PER_HOUR * t, np.full(len(t), 5.0 / PER_HOUR)


def ramp(hold_s: float, rate: float = 2.0 / 60.0) -> Profile:
    """Return a temperature that holds and then goes at a rate in °C/s."""

    def profile(t: FloatArray, start: float) -> tuple[FloatArray, FloatArray]:
        return start + rate * np.maximum(t - hold_s, 0.0), np.where(t > hold_s, rate, 0.0)

    return profile


def thermostat(swing: float, period_s: float, lag_s: float = 0.0) -> Profile:
    """Return a temperature that goes up and down by a swing in °C, turning at once, or behind a lag."""

    def profile(t: FloatArray, start: float) -> tuple[FloatArray, FloatArray]:
        triangle = np.abs(2.0 * (t / period_s % 1.0) - 1.0) - 0.5
        keep = np.exp(-(t[1] - t[0]) / lag_s) if lag_s else 0.0
        follows = lfilter([1.0 - keep], [1.0, -keep], triangle - triangle[0])
        return start + swing * follows, np.gradient(swing * follows, t)

    return profile


def play(kind: Kind, profile: Profile, seconds: float, seed: int) -> tuple[FloatArray, ...]:
    """Return times, temperature, its rate, and the reading, (n,) each."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * kind.rate_hz)) / kind.rate_hz
    temperature, rate = profile(t, 25.0 + rng.uniform(-0.5, 0.5))
    return t, temperature, rate, kind.read(temperature, rng)


def errors(
    kind: Kind,
    profile: Profile,
    seconds: float,
    seed: int,
    new_method: Callable[[], RateMethod] | None = None,
) -> dict[str, FloatArray]:
    """Return once a second: time, errors of temperature and rate (°C, °C/h), and both in units of sigma."""
    t, temperature, rate, reading = play(kind, profile, seconds, seed)
    found = TemperatureRate(new_method=new_method).process(sent(t, temperature=reading))
    names = ("temperature_estimate", "temperature_rate", "temperature_estimate_sd", "temperature_rate_sd")
    each = slice(max(round(kind.rate_hz), 1) - 1, None, max(round(kind.rate_hz), 1))
    estimate, slope, sd, slope_sd = (found[name][each] for name in names)
    off, slope_off = estimate - temperature[each], slope - rate[each]
    return {
        "t": t[each],
        "temperature": off,
        "rate": slope_off * PER_HOUR,
        "z": off / sd,
        "rate_z": slope_off / slope_sd,
    }
