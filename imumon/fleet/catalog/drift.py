"""How the models of a unit change over months, and which units differ from the others of their kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.fleet.catalog.units import BEST, WORST, Dated, Unit
from imumon.lab.diagnosis.page import shown
from imumon.models.model import ChannelModel
from imumon.recordings.reduced import GYRO

MONTH_NS = 365.25 / 12 * 86_400e9
FEWEST_UNITS = 5
"""Of fewer the median deviation is that of one or two."""
OUTLYING = 3.5
"""Modified z-score, with `TO_SIGMA`, as of Iglewicz and Hoaglin, How to Detect and Handle Outliers (1993)."""
TO_SIGMA = 0.6745
"""Median absolute deviation of a normal distribution, in sigmas."""


class Drift(NamedTuple):
    """The bias of a channel at one temperature, by each of the unit's models."""

    channel: str
    at_degc: float
    """Middle of the temperatures that all models know."""
    time_ns: IntArray
    """Unix time of the latest data of each model, (n,)."""
    bias: FloatArray
    sd: FloatArray
    """In the channel's unit, (n,).  The sigma is that of the curve and of the turn-on offset together."""
    per_month: float
    per_month_sd: float
    """Slope of the straight line; NaN with one model, or with all from one moment."""


def drifts(unit: Unit) -> list[Drift]:
    """Return the drift of every gyro, as far as its models can be compared.

    Those with the earth rate and those without are not; the accelerometers' constant is gravity's.
    """
    if not unit.models:
        return []
    state = unit.models[-1].model.earth_rate
    alike = [dated for dated in unit.models if dated.model.earth_rate == state]
    found = []
    for name in GYRO:
        having = [dated for dated in alike if name in dated.model.channels]
        at = common_temperature([dated.model.channels[name] for dated in having])
        if at is not None:
            found.append(_drift(name, having, at))
    return found


def common_temperature(channels: Sequence[ChannelModel]) -> float | None:
    """Return the middle of the temperatures that all know, °C; None where there is none."""
    low = max((channel.temperature_range_degc[0] for channel in channels), default=np.inf)
    high = min((channel.temperature_range_degc[1] for channel in channels), default=-np.inf)
    return 0.5 * (low + high) if low <= high else None


def _drift(name: str, models: Sequence[Dated], at: float) -> Drift:
    time_ns = np.array([dated.time_ns for dated in models], np.int64)
    bias = np.array([float(dated.model.channels[name].value(at)) for dated in models])
    sd = np.array([_sigma(dated, name) for dated in models])
    return Drift(name, at, time_ns, bias, sd, *line((time_ns - time_ns[0]) / MONTH_NS, bias, sd))


def _sigma(dated: Dated, name: str) -> float:
    """Return by how much the bias of the next power-on may differ from the curve."""
    offsets = [run.offset[name] for run in dated.model.trained_on if name in run.offset]
    turn_on = float(np.std(offsets, ddof=1)) if len(offsets) > 1 else 0.0
    return float(np.hypot(dated.model.channels[name].residual_sd, turn_on))


def line(x: FloatArray, y: FloatArray, sd: FloatArray) -> tuple[float, float]:
    """Return the slope of the weighted straight line through points, and its sigma; NaN without a span.

    Where the points scatter by more than they should, the sigma is as much larger (Birge, Phys. Rev. 40,
    207, 1932, eq. 5).
    """
    if len(x) < 2 or np.ptp(x) == 0.0:
        return float("nan"), float("nan")
    weight = 1.0 / np.maximum(sd, np.finfo(float).tiny ** 0.25)
    coefficients, covariance = np.polyfit(x, y, 1, w=weight, cov="unscaled")
    left = weight * (y - np.polyval(coefficients, x))
    excess = float((left**2).sum()) / (len(x) - 2) if len(x) > 2 else 1.0
    return float(coefficients[0]), float(np.sqrt(max(excess, 1.0) * covariance[0, 0]))


class Outlier(NamedTuple):
    """A value of a unit, in rad/s, far from those of the others of its device.

    `score` is the modified z-score: about its distance from the median in sigmas of the others.
    """

    unit: str
    what: str
    value: float
    median: float
    score: float

    def __str__(self) -> str:
        """Return it in a few words."""
        factor, unit = shown("rad/s")
        values = f"{factor * self.value:.3g} {unit}, the others {factor * self.median:.3g}"
        return f"{self.what}: {values} (score {self.score:.1f})"


def outliers(units: Sequence[Unit]) -> list[Outlier]:
    """Return what is unusual, the worst first, among at least `FEWEST_UNITS` units of each device."""
    found: list[Outlier] = []
    for device in dict.fromkeys(unit.device for unit in units):
        for what, of in _quantities([unit for unit in units if unit.device == device]).items():
            known = {name: value for name, value in of.items() if np.isfinite(value)}
            if len(known) < FEWEST_UNITS:
                continue
            median = float(np.median([*known.values()]))
            spread = float(np.median([abs(value - median) for value in known.values()]))
            for name, value in known.items():
                score = TO_SIGMA * (value - median) / spread if spread else 0.0
                if abs(score) > OUTLYING:
                    found.append(Outlier(name, what, value, median, score))
    return sorted(found, key=lambda outlier: -abs(outlier.score))


def _quantities(units: Sequence[Unit]) -> dict[str, dict[str, float]]:
    """Return what units of a device are compared by: name to unit to value, in rad/s."""
    found: dict[str, dict[str, float]] = {
        "smallest σ of the bias": {unit.name: unit.row[BEST] for unit in units},
        "largest σ of the bias": {unit.name: unit.row[WORST] for unit in units},
    }
    latest = {unit.name: unit.models[-1].model.channels for unit in units if unit.models}
    for channel in GYRO:
        having = {name: channels[channel] for name, channels in latest.items() if channel in channels}
        at = common_temperature([*having.values()])
        if at is not None:
            found |= {
                f"{channel} at {at:.0f} °C": {n: float(c.value(at)) for n, c in having.items()},
                f"{channel} slope per °C": {n: float(c.slope(at)) for n, c in having.items()},
                f"{channel} residual": {n: c.residual_sd for n, c in having.items()},
            }
    return found
