"""Which assumption gives the times of the published experiment: 529 s (average) and 355 s (curve fit)."""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import brentq

from imumon.blocks import FloatArray
from imumon.geodesy import EARTH_RATE

DRIFT_UG, LATITUDE_DEG, LIMIT_DEG, END_S = 83.7, 36.0, 0.05, 900.0
AVERAGE_S, FIT_S = 529.0, 355.0
STEP_S = 0.25


def errors_deg(
    tau_s: float, start_s: float, amplitude_ug: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time since power-on and the heading errors of total average and curve fit from `start_s` on.

    The warm-up is amplitude (1 - exp(-t / tau)) from power-on; control rates are free of noise.
    """
    t = np.arange(start_s + STEP_S, END_S + 0.5 * STEP_S, STEP_S)
    angle = amplitude_ug * 1e-6 * (math.exp(-start_s / tau_s) - np.exp(-t / tau_s))
    s = t - start_s
    n = np.arange(1, len(t) + 1)
    sums = [np.cumsum(values) for values in (s, s * s, angle, s * angle)]
    spread = n * sums[1] - sums[0] ** 2
    spread[0] = np.nan
    scale = math.degrees(1.0 / (EARTH_RATE * math.cos(math.radians(LATITUDE_DEG))))
    return t, scale * angle / s, scale * (n * sums[3] - sums[0] * sums[2]) / spread


def within_from(t: FloatArray, error: FloatArray) -> float:
    """Return the time from which on the error stays within the limit; NaN for never."""
    bad = np.flatnonzero(~(np.abs(error) <= LIMIT_DEG))
    if not len(bad):
        return float(t[0])
    return float(t[bad[-1] + 1]) if bad[-1] + 1 < len(t) else math.nan


def amplitude_of(tau_s: float, start_s: float) -> float:
    """Return the amplitude, µg, whose change from `start_s` to the end is the published drift."""
    return DRIFT_UG / (math.exp(-start_s / tau_s) - math.exp(-END_S / tau_s))


def straight() -> list[list[str]]:
    """Times as the formula gives them: the drift counted from power-on, averages from 0 or from 30 s."""
    rows = []
    for tau in (50.0, 80.0, 150.0, 300.0, 600.0):
        for start in (0.0, 30.0):
            t, average, fit = errors_deg(tau, start, amplitude_of(tau, 0.0))
            own = within_from(t, average - average[-1]), within_from(t, fit - fit[-1])
            at = float(np.interp(AVERAGE_S, t, average)), float(np.interp(FIT_S, t, fit))
            rows.append(
                [
                    f"{tau:g}", f"{start:g}", f"{at[0]:.3f}", f"{at[1]:.3f}",
                    _s(within_from(t, average)), _s(within_from(t, fit)), _s(own[0]), _s(own[1]),
                ]
            )  # fmt: skip
    return rows


def _s(value: float) -> str:
    return "never" if math.isnan(value) else f"{value:.0f}"


def consistent(start_s: float) -> tuple[float, float, float]:
    """Return tau, amplitude and drift after `start_s` for which both times come out, without any offset."""

    def excess(tau: float) -> float:
        t, average, fit = errors_deg(tau, start_s, 1.0)
        return float(np.interp(FIT_S, t, fit) / np.interp(AVERAGE_S, t, average) - 1.0)

    tau = float(brentq(excess, 10.0, 150.0))
    t, average, _ = errors_deg(tau, start_s, 1.0)
    amplitude = LIMIT_DEG / float(np.interp(AVERAGE_S, t, average))
    return tau, amplitude, amplitude * (math.exp(-start_s / tau) - math.exp(-END_S / tau))


def solutions() -> list[list[str]]:
    """Both times, for several beginnings of the averages: by another warm-up or another truth."""
    rows = []
    for start in (0.0, 30.0, 60.0, 90.0, 120.0, 140.0):
        tau, amplitude, drift = consistent(start)
        t, average, _ = errors_deg(tau, start, amplitude_of(tau, 0.0))
        offset = float(np.interp(AVERAGE_S, t, average)) - LIMIT_DEG
        rows.append([f"{start:g}", f"{tau:.0f}", f"{amplitude:.1f}", f"{drift:.1f}", f"{offset:+.3f}"])
    return rows


def beginning() -> tuple[float, float]:
    """Return beginning of the averages and tau for which the whole warm-up is the published drift."""

    def excess(start: float) -> float:
        tau, amplitude, _ = consistent(start)
        return amplitude * (1.0 - math.exp(-END_S / tau)) - DRIFT_UG

    start = float(brentq(excess, 1.0, 140.0, xtol=0.1))
    return start, consistent(start)[0]
