"""The bank of filters once more, with matrices written out, as in a textbook."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.estimation.zupt import bank as fast


class PlainBank:
    """One row of filters with slope: full matrices, and the textbook mixing of multiple models."""

    def __init__(self, family: fast.Family, noise: float) -> None:
        self.markov = family.markov[0] * (noise if family.relative else 1.0)
        self.walk = family.walk[0] * (noise if family.relative else 1.0)
        self.prior, self.noise = family.prior, noise
        self.weight = family.prior.copy()
        self.x = np.zeros((len(self.prior), 7))
        self.p = np.zeros((len(self.prior), 7, 7))
        slope = fast.SLOPE_PER_NOISE * noise
        for p, markov in zip(self.p, self.markov, strict=True):
            p[range(2, 7), range(2, 7)] = [fast.UNKNOWN_BIAS**2, *[markov**2] * 3, slope**2]
            p[0, 0] = fast.UNKNOWN_ROTATION**2

    def wander(self, dt: float, warming: float, travel: float, growth: float) -> None:
        decay = np.exp(-dt / np.array(fast.MARKOV_S))
        f = np.diag([1.0, 1.0, 1.0, *decay, 1.0])
        f[2, 6] = warming
        for h in range(len(self.x)):
            q = np.zeros(7)
            q[2] = self.walk[h] ** 2 * dt + growth
            q[3:6] = self.markov[h] ** 2 * (1.0 - decay**2)
            self.x[h] = f @ self.x[h]
            self.p[h] = f @ self.p[h] @ f.T
            slope2 = self.x[h][6] ** 2 + self.p[h][6, 6] + fast.SLOPE_WALK**2 * dt
            q[6] = fast.SLOPE_WALK**2 * dt + slope2 * travel / fast.CURVATURE_DEGC
            self.p[h] += np.diag(q)

    def take(self, dt: float, rate: float, tilt: float, tilt2: float, sway2: float) -> float:
        f = np.eye(7)
        f[0, 2:6], f[1, 0], f[1, 2:6] = -dt, dt, -dt * dt / 2
        given = np.array([dt * rate, dt * dt / 2 * rate - dt * tilt, 0, 0, 0, 0, 0])
        of_noise = np.array([dt, dt * dt / 2, 0, 0, 0, 0, 0]) * self.noise / math.sqrt(dt)
        q = np.outer(of_noise, of_noise)
        q[1, 1] += tilt2 * dt
        row = np.eye(7)[[1]]
        likelihood = np.empty(len(self.x))
        for h in range(len(self.x)):
            x, p = f @ self.x[h] + given, f @ self.p[h] @ f.T + q
            s = p[1, 1] + sway2
            gain = p @ row.T / s
            keep = np.eye(7) - gain @ row
            self.x[h] = x - gain[:, 0] * x[1]
            self.p[h] = keep @ p @ keep.T + sway2 * gain @ gain.T
            likelihood[h] = math.exp(-0.5 * x[1] ** 2 / s) / math.sqrt(2 * math.pi * s)
        total = float(self.weight @ likelihood)
        self.weight = self.weight * likelihood / total
        return math.log(total)

    def mix(self, dt: float) -> None:
        stay = math.exp(-dt / fast.DWELL_S)
        n = len(self.x)
        switch = stay * np.eye(n) + (1.0 - stay) * self.prior[np.newaxis, :]
        after = self.weight @ switch
        shares = self.weight[:, np.newaxis] * switch / after
        x = shares.T @ self.x
        p = np.zeros_like(self.p)
        for j in range(n):
            for i in range(n):
                off = self.x[i] - x[j]
                p[j] += shares[i, j] * (self.p[i] + np.outer(off, off))
        self.x, self.p, self.weight = x, p, after

    def bias(self) -> tuple[float, float]:
        value = self.x[:, 2:6].sum(1)
        variance = self.p[:, 2:6, 2:6].sum((1, 2))
        mean = float(self.weight @ value)
        return mean, float(self.weight @ (variance + (value - mean) ** 2))

    def slope(self) -> FloatArray:
        return np.asarray(self.weight @ self.x[:, 6])
