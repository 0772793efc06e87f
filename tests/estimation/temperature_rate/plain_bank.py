"""The default method written plainly: dense matrices, one slot after the other, SciPy's distributions."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import log_ndtr, ndtr

from imumon.blocks import FloatArray

JERKS = 10.0 ** np.arange(-27.0, -6.0, 1.5)
NOISES = np.array([0.0001, 0.001, 0.01, 0.015, 0.023, 0.035, 0.05, 0.07, 0.1, 0.14, 0.2, 0.28, 0.4])
TAU = 1800.0


class Slot(NamedTuple):
    at: float
    mean: float
    low: float
    high: float
    n: int
    changes: int
    duration: float
    crossed: float
    gap: float
    upward: bool


def slots(times: FloatArray, readings: FloatArray) -> list[tuple[float, Slot]]:
    """Return the slots of a record that is sampled at 5 Hz or faster, and when each was closed."""
    found, first = [], 0
    for i in range(len(times)):
        if times[i] - times[first] >= 1.0 - 1e-6 and i - first >= 5:
            members = list(range(first, i))
            if first and readings[first] != readings[first - 1]:
                members.insert(0, first - 1)
            y, t = readings[members], times[members]
            at = np.flatnonzero(np.diff(y))
            changes = len(at)
            crossed = float((t[at] + t[at + 1]).mean() / 2) if changes else 0.0
            gap = float((t[at + 1] - t[at]).mean()) if changes else 0.0
            span = times[i - 1] - times[first]
            where = float(t.mean()), y.mean(), y.min(), y.max(), len(y), changes, span
            slot = Slot(*where, crossed, gap, bool(y[-1] > (y.min() + y.max()) / 2))
            found.append((float(times[i]), slot))
            first = i
    return found


class PlainBank:
    """Hypotheses as lists of weight, mean (3,) and covariance (3, 3)."""

    def __init__(self, reading: float, step: float) -> None:
        self.step, self.time = step, 0.0
        self.noise = np.tile(NOISES * step, len(JERKS))
        self.jerk = np.repeat(JERKS, len(NOISES))
        count = len(self.jerk)
        self.w = np.full(count, 1.0 / count)
        self.x = np.tile([reading, 0.0, 0.0], (count, 1))
        rate = 20.0 / 3600.0
        acceleration = np.minimum((rate / 300.0) ** 2, self.jerk * TAU / 2)
        self.p = np.array([np.diag([step**2, rate**2, a]) for a in acceleration])

    def mix(self, dt: float) -> None:
        n, m = len(JERKS), len(NOISES)
        transition = np.zeros((n * m, n * m))
        for i in range(n):
            for j in range(m):
                for other, probability in (
                    *(((i + d, j), dt / 3600 / 2) for d in (-1, 1)),
                    *(((i, j + d), dt / 3600 / 2) for d in (-1, 1)),
                ):
                    if 0 <= other[0] < n and 0 <= other[1] < m:
                        transition[i * m + j, other[0] * m + other[1]] = probability
        transition[np.diag_indices(n * m)] = 1.0 - transition.sum(1)
        joint = transition * self.w[:, np.newaxis]
        self.w = joint.sum(0)
        x, p = self.x.copy(), self.p.copy()
        for k in np.flatnonzero(self.w > 1e-30):
            share = joint[:, k] / self.w[k]
            self.x[k] = share @ x
            d = x - self.x[k]
            self.p[k] = np.einsum("a,aij->ij", share, p) + np.einsum("a,ai,aj->ij", share, d, d)

    def predict(self, dt: float) -> None:
        keep = np.exp(-dt / TAU)
        g = TAU * (1 - keep)
        f = np.array([[1.0, dt, TAU * (dt - g)], [0.0, 1.0, g], [0.0, 0.0, keep]])
        q = np.array(
            [
                [dt**5 / 20, dt**4 / 8, dt**3 / 6],
                [dt**4 / 8, dt**3 / 3, dt**2 / 2],
                [dt**3 / 6, dt**2 / 2, dt],
            ]
        )
        for k in self.active():
            self.x[k] = f @ self.x[k]
            self.p[k] = f @ self.p[k] @ f.T + self.jerk[k] * q

    def active(self) -> list[int]:
        return [int(k) for k in np.flatnonzero(self.w > 1e-7)]

    def set_temperature(self, k: int, mean: float, variance: float) -> None:
        gain = self.p[k][:, 0] / self.p[k][0, 0]
        self.x[k] = self.x[k] + gain * (mean - self.x[k][0])
        self.p[k] = self.p[k] + np.outer(gain, gain) * (variance - self.p[k][0, 0])

    def measure(self, slot: Slot) -> None:
        self.mix(slot.at - self.time)
        self.predict(slot.at - self.time)
        self.time = slot.at
        evidence = np.zeros(len(self.w))
        active = self.active()
        for k in active:
            sigma = np.hypot(self.noise[k], self.x[k][1] * slot.duration / np.sqrt(12))
            mean, sd = self.x[k][0], np.sqrt(self.p[k][0, 0])
            low, high = slot.mean - self.step / 2, slot.mean + self.step / 2
            moved = abs(self.x[k][1]) * slot.duration
            once = slot.changes % 2 == 1 and slot.upward == (self.x[k][1] > 0)
            if once and moved > 4 * self.noise[k] and slot.changes <= 1 + 4 * self.noise[k] * slot.n / moved:
                since = slot.at - slot.crossed
                each = abs(self.x[k][1]) * slot.gap
                z = (slot.low + slot.high) / 2 + self.x[k][1] * since
                variance = each**2 / 12 + each * self.noise[k] / 1.8 + self.p[k][1, 1] * since**2
                total = variance + sd**2
                chance = np.log(each) - 0.5 * np.log(2 * np.pi * total) - 0.5 * (z - mean) ** 2 / total
                moments = mean + sd**2 / total * (z - mean), sd**2 * variance / total, chance
            elif slot.changes:
                share = np.clip(
                    (slot.mean - slot.low) / (slot.high - slot.low), 0.5 / slot.n, 1 - 0.5 / slot.n
                )
                count = min(slot.n, max(1.0, slot.changes / (2 * share * (1 - share))))
                edge = (slot.low + slot.high) / 2
                moments = laplace(mean, sd, edge, edge, share * count, (1 - share) * count, sigma)
            elif sd < 2 * sigma:
                if min(mean - low, high - mean) > 5 * sigma + 3 * sd:
                    continue
                moments = laplace(mean, sd, low, high, slot.n, slot.n, sigma)
            else:
                shift, shrink, mass = confine((low - mean) / sd, (high - mean) / sd)
                if sd < 1.5 * self.step and mass > np.log(0.02):
                    continue
                moments = mean + shift * sd, shrink * sd**2, mass
            self.set_temperature(k, *moments[:2])
            evidence[k] = moments[2]
        weights = np.zeros(len(self.w))
        weights[active] = self.w[active] * np.exp(evidence[active] - evidence[active].max())
        self.w = weights / weights.sum()

    def shown(self, slot: Slot) -> tuple[float, float, float]:
        """Return rate, acceleration and the rate's standard deviation, confined to the level of the slot."""
        weight, rate, variance, acceleration = [], [], [], []
        for k in self.active():
            w, x, p = self.w[k], self.x[k], self.p[k]
            sd = np.sqrt(p[0, 0])
            r, v, a = x[1], p[1, 1], x[2]
            if not slot.changes and sd >= 2 * self.noise[k]:
                half = self.step / 2 - min(1.5 * self.noise[k], 0.3 * self.step)
                shift, shrink, mass = confine((slot.low - half - x[0]) / sd, (slot.low + half - x[0]) / sd)
                gain = p[0, 1] / p[0, 0]
                a = a + p[0, 2] / p[0, 0] * shift * sd
                w, r, v = w * np.exp(mass), r + gain * shift * sd, v + gain**2 * (shrink - 1) * p[0, 0]
            weight.append(w)
            rate.append(r)
            variance.append(v)
            acceleration.append(a)
        w = np.array(weight) / sum(weight)
        mean = float(w @ rate)
        sd = float(np.sqrt(w @ (np.array(variance) + (np.array(rate) - mean) ** 2)))
        return mean, float(w @ acceleration), sd


def laplace(
    mean: float, sd: float, low: float, high: float, above: float, below: float, sigma: float
) -> tuple[float, float, float]:
    """Return mode, variance and log mass of a Gaussian times Φ((t-low)/σ)^above Φ((high-t)/σ)^below."""

    def log_density(t: float) -> float:
        return float(
            -0.5 * ((t - mean) / sd) ** 2
            + above * log_ndtr((t - low) / sigma)
            + below * log_ndtr((high - t) / sigma)
        )

    def slope(t: float) -> tuple[float, float]:
        u, v = (t - low) / sigma, (high - t) / sigma
        a, b = (np.exp(-0.5 * z * z - log_ndtr(z)) / np.sqrt(2 * np.pi) for z in (u, v))
        first = (mean - t) / sd**2 + (above * a - below * b) / sigma
        return first, 1 / sd**2 + (above * a * (a + u) + below * b * (b + v)) / sigma**2

    bottom, top = min(mean, low) - 10 * sigma, max(mean, high) + 10 * sigma
    for _ in range(60):
        middle = (bottom + top) / 2
        if slope(middle)[0] > 0:
            bottom = middle
        else:
            top = middle
    t = (bottom + top) / 2
    curvature = slope(t)[1]
    return t, 1 / curvature, log_density(t) - 0.5 * np.log(curvature * sd**2)


def confine(a: float, b: float) -> tuple[float, float, float]:
    """Return mean, variance and log mass of a standard normal between a and b."""
    mass = ndtr(b) - ndtr(a) if a < 0 else ndtr(-a) - ndtr(-b)
    at_a, at_b = np.exp(-0.5 * np.array([a, b]) ** 2) / np.sqrt(2 * np.pi)
    mean = (at_a - at_b) / mass
    variance = 1 + (a * at_a - b * at_b) / mass - mean**2
    return float(mean), float(max(variance, 1e-6)), float(np.log(mass))
