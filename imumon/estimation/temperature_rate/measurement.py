"""What the readings of a slot show of y = T + e, for all filters at once: one decision table.

`step` is d in °C, n the number of independent readings, u the fraction of readings above an edge, f the
normal density at Φ⁻¹(u).  s² = σ² + (r² + P_rr) Δ²/12, in °C², is the white noise of a model and the motion
in Δ, the usual time from one slot that is used to the next, and β = exp(-2π²s²/d²).  Of the rows of the code
models the first that holds counts; the last row always does.  The last reading before the slot counts as one
of its codes, unless it is long ago.  A code stands for readings about its middle: of a thermometer that
truncates T is half a step off.

| the slot | filters | what enters the state |
|---|---|---|
| one code in it, more than a step from the last reading | code models | as one code |
| more than two codes | code models | (6) z = mean less ripple, R = max(s², variance)/n + (β d/π)²/8 |
| two codes | code models | (7) z = edge + s Φ⁻¹(u), R = s² u(1-u)/(n f²) + (0.1 s Φ⁻¹(u))² |
| one code: soft edge, surprise, or prediction wide | code models | (8) y is in the code: truncated Gaussian |
| one code | code models | nothing, probabilities hardly change; the code confines this slot's output alone |
| any | mean models | (9) z = mean, R = white part of max(ρ, d²/12) + (d/n)²/2π |

A code that stays is one statement, but at a soft edge.  Mean models count it anew, and pay by the width of R.

Log likelihoods are of probabilities of a slot's mean on its lattice of d/n, so that all rows can be compared.
With R = (d/n)²/2π the density 1/√(2πR) times d/n is 1: no point of the lattice has a probability above it.
"""

import math

import numpy as np
from scipy.special import log_ndtr, ndtr, ndtri

from imumon.blocks import FloatArray

from .filter import CODE, MEAN, NOISE, RATE, Correction, Filters
from .thermometer import Slot, Thermometer

ROOT_2_PI = math.sqrt(2.0 * math.pi)
SOFT = 2.0
"""An edge is soft for a prediction with a sigma below so many of the edge's.  Ablation: "no soft edges"."""
SURPRISE = 0.02  # least probability of a code that is no surprise.  Ablation: "no code is a surprise".
WIDE = 1.5  # steps of sigma beyond which a prediction is wide.  Ablation: "wide beyond 3 steps".
SIGMA_ERROR = 0.1
"""Relative error of the σ of a code model: half the distance of two.  Ablation: "σ of a model exact"."""
MOST_RIPPLE = 0.4  # largest β by which a mean is corrected: the iteration converges while 2 β < 1
RENEWAL = 0.1
"""A code that stays counts this part of its log likelihood, times the new part of e.  Ablation: first row."""


def evaluate(thermometer: Thermometer, slot: Slot, filters: Filters) -> tuple[Correction, Correction]:
    """Return the evidence of a slot with readings for all filters, by the table above.

    The first is what enters the states, the second all that the slot shows, for the output.
    """
    step, n = thermometer.step, max(thermometer.independence * slot.count, 1.0)  # independent readings
    variance = NOISE.white[MEAN] * thermometer.mean_variance + (step / n) ** 2 / (2.0 * math.pi)
    of_means = _gaussian(filters, MEAN, slot.mean, variance, math.log(step / n))
    square_rate = filters.x[RATE, CODE] ** 2 + filters.p[RATE, RATE, CODE]
    s = np.sqrt(NOISE.white[CODE] * step**2 + square_rate * thermometer.spacing_s**2 / 12.0)
    span = (slot.highest - slot.lowest) / step
    if span > 1.5 and slot.largest > slot.smallest:
        of_codes = [_many_codes(filters, slot, step, n, s)]
    elif 0.5 <= span <= 1.5:
        of_codes = [_two_codes(filters, slot, step, n, s)]
    else:
        renewed = 1.0 - np.exp(-thermometer.spacing_s / NOISE.tau_s[CODE])
        of_codes = _one_code(filters, slot, step, n, s, renewed)
    found = [Correction(*map(np.concatenate, zip(each, of_means, strict=True))) for each in of_codes]
    return found[0], found[-1]


def _gaussian(
    filters: Filters, rows: slice, z: FloatArray | float, r: FloatArray, log_scale: FloatArray | float
) -> Correction:
    """Correct by y = z with the variance R: mean by P (z - mean)/S, variance by -P²/S, with S = P + R.

    P is the variance of y.  A density of z times exp(`log_scale`), °C, is a probability.
    """
    mean, variance = (of_all[rows] for of_all in filters.y)
    innovation, innovation_variance = z - mean, variance + r
    gain = variance / innovation_variance
    log_density = -0.5 * (np.log(2.0 * math.pi * innovation_variance) + innovation**2 / innovation_variance)
    return Correction(gain * innovation, -gain * variance, log_density + log_scale)


def _many_codes(filters: Filters, slot: Slot, step: float, n: float, s: FloatArray) -> Correction:
    """Measure by the mean (6): with white noise E[mean] = x - β/π sin 2πx, x = y/d (Widrow, Kollar 2008)."""
    ripple = np.exp(-2.0 * np.pi**2 * (s / step) ** 2)
    offset = (slot.mean - slot.smallest) / step
    x = np.full_like(ripple, offset)
    for _ in range(4):
        x = offset + np.minimum(ripple, MOST_RIPPLE) / math.pi * np.sin(2.0 * math.pi * x)
    # With a wrong β half of the ripple is left: of its mean square, (β d/π)²/2, a quarter.
    r = np.maximum(s**2, slot.variance) / n + (ripple * step / math.pi) ** 2 / 8.0
    scatter = _scatter(x, s / step, slot.variance / step**2, n)
    return _gaussian(filters, CODE, slot.smallest + step * x, r, math.log(step / n) + scatter)


def _scatter(x: FloatArray, s: FloatArray, variance: float, n: float) -> FloatArray:
    """Return the log likelihood of readings that scatter more than noise and rounding: χ² of n.

    Rounded readings have the variance s² + d²/12 and its first harmonic in x; all in steps.
    """
    ripple, phase = np.exp(-2.0 * np.pi**2 * s**2), 2.0 * math.pi * x
    harmonic = -ripple * np.cos(phase) * (1.0 / math.pi**2 + 4.0 * s**2)
    harmonic -= (ripple * np.sin(phase) / math.pi) ** 2
    excess = np.maximum(variance / (s**2 + np.maximum(1.0 / 12.0 + harmonic, 0.0)), 1.0)
    # Its mean is made zero: half the time it is -χ²/2, of mean -1/2.
    return 0.25 - 0.5 * n * (excess - 1.0 - np.log(excess))


def _two_codes(filters: Filters, slot: Slot, step: float, n: float, s: FloatArray) -> Correction:
    """Measure by the fraction u of readings above the edge between the two codes (7)."""
    least = 0.5 / slot.count
    u = min(max((slot.mean - slot.lowest) / (slot.highest - slot.lowest), least), 1.0 - least)
    quantile = float(ndtri(u))
    density = math.exp(-0.5 * quantile**2) / ROOT_2_PI
    r = s**2 * (u * (1.0 - u) / (n * density**2) + (SIGMA_ERROR * quantile) ** 2)
    z = 0.5 * (slot.lowest + slot.highest) + s * quantile
    # All n readings are of these two codes: models of more noise would have read a third.
    apart = step / s
    within = n * np.log(np.maximum(ndtr(apart - quantile) - ndtr(-apart - quantile), 1e-300))
    return _gaussian(filters, CODE, z, r, np.log(s / (density * n)) + within)


def _one_code(
    filters: Filters, slot: Slot, step: float, n: float, s: FloatArray, renewed: FloatArray
) -> list[Correction]:
    """Confine y to the code (8).

    All n readings are in it, so was the most extreme noise of n.  Its median is s Φ⁻¹(2^(-1/n)), by which the
    edges move in; they are soft by s²/(1 + 2 ln n), half of its variance: the whole fails at silent levels.

    `renewed` is the part of the slow error that is new: to that part, a code that stays is new evidence.
    Returns what enters the states, and all that the code shows.
    """
    mean, variance = (of_all[CODE] for of_all in filters.y)
    edge_variance = s**2 / (1.0 + 2.0 * math.log(n))
    total_sd = np.sqrt(variance + edge_variance)
    half = np.maximum(0.5 * step - float(ndtri(2.0 ** (-1.0 / n))) * s, 0.1 * step)
    off = mean - slot.last
    shift, kept, log_mass = truncated((-half - np.abs(off)) / total_sd, (half - np.abs(off)) / total_sd)
    gain = variance / total_sd
    shown = Correction(np.sign(off) * gain * shift, gain**2 * (kept - 1.0), log_mass)
    soft, wide = variance < SOFT**2 * edge_variance, variance > (WIDE * step) ** 2
    enters = soft | wide | (log_mass < math.log(SURPRISE))
    evidence = np.where(enters, 1.0, RENEWAL * renewed) * log_mass
    return [Correction(enters * shown.mean_change, enters * shown.variance_change, evidence), shown]


def truncated(low: FloatArray, high: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean, variance and log mass of a standard normal between two bounds (Curry 1970).

    The lower bound is the farther from zero: then all is stable, however far out.
    """
    log_high = log_ndtr(high)
    log_mass = log_high + np.log1p(-np.exp(np.minimum(log_ndtr(low) - log_high, -1e-12)))
    at_low, at_high = (np.exp(-0.5 * bound**2 - log_mass) / ROOT_2_PI for bound in (low, high))
    mean = np.clip(at_low - at_high, low, high)
    variance = np.clip(1.0 + low * at_low - high * at_high - mean**2, 1e-6, 1.0)
    return mean, variance, log_mass
