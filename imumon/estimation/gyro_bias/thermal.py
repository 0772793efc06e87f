"""Temperature: a thermal bias model as a known input, the variance that it adds, and charts of the bias."""

import math
from collections.abc import Iterator

import numpy as np

from imumon.blocks import FloatArray, SampleBlock
from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.effects.thermal_lag import OWN_LAG_S
from imumon.estimation.temperature_rate.thermometer import UNSEEN_RATE
from imumon.geodesy import DEG_PER_H
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

GYROS = ("gyro_x", "gyro_y", "gyro_z")
MOVED_DEGC = 0.5  # the temperature has moved when it is so far from where it was: no noise.  Assumed.
CORRELATION_DEGC = 5.0  # errors of a curve so far apart are independent: they differ by √2 sd.  Assumed.
MOST_POINTS = 250  # when more are kept, every second one is dropped, and from then on half as many are taken


class Thermal:
    """The model's increments since the first temperature, and their variance; zero without a model.

    Within the calibrated range the error of the curve is a random walk over temperature; outside it the slope
    itself is unknown, on the way out and on the way back.  An unknown state at power-on fades: its sd at
    first less that now is by how much the bias has moved.
    """

    def __init__(self, model: BiasModel | None) -> None:
        self._predictor = None if model is None else BiasPredictor(model, GYROS)
        columns = ["temperature"] * 3 if self._predictor is None else self._predictor.temperature_columns
        suffixes = [name.removeprefix("temperature").removeprefix("_estimate") for name in columns]
        # Suffixes that the columns of each gyro may have, the likeliest first.
        self._suffixes = [[own] if own else ["", f"_{a}"] for own, a in zip(suffixes, "xyz", strict=True)]
        self._reference = np.full(3, np.nan)  # the curve at the first temperature, rad/s
        channels = [] if model is None else [model.channels[name] for name in GYROS]
        # Of each gyro, (3,), empty without a model: range, °C; sd of residual, rad/s; rms slope, rad/s/°C.
        self._low, self._high = np.reshape([one.temperature_range_degc for one in channels], (-1, 2)).T
        self._residual = np.array([one.residual_sd for one in channels])
        within = np.linspace(self._low, self._high, 101).T
        slopes = [one.slope(degc) for one, degc in zip(channels, within, strict=True)]
        self._steepness = np.array([np.sqrt(np.mean(slope**2)) for slope in slopes])
        self.notices: dict[str, None] = {}  # what was missing, or out of range, so far, in order
        self.restart()

    def restart(self) -> None:
        """Count the variance from now on."""
        self._walked_degc = np.full(3, np.nan)  # up to which temperature the walk of the error is counted, °C
        self._beyond_degc = np.zeros(3)  # how far outside of the calibrated range, °C
        self._power_on_sd = np.full(3, np.nan)  # the first sd of the state at power-on, rad/s
        self._faded = np.zeros(3)  # variance by what has faded of that state, (rad/s)²

    def take_temperature(self, degc: FloatArray, sd: FloatArray, lag_degc: FloatArray | float) -> FloatArray:
        """Return the variance that a new temperature adds to the bias, (rad/s)², (3,); NaN adds none.

        `sd` is that of the state at power-on; in a gap the gyros' lag may change by `lag_degc` (sd), (3,).
        """
        if self._predictor is None:
            return np.zeros(3)
        # Within the range: a random walk, in steps of `MOVED_DEGC` at least.
        self._walked_degc = np.where(np.isfinite(self._walked_degc), self._walked_degc, degc)
        moved = np.abs(degc - self._walked_degc)
        far = moved >= MOVED_DEGC
        self._walked_degc = np.where(far, degc, self._walked_degc)
        walk = np.where(far, 2.0 * self._residual**2 * moved / CORRELATION_DEGC, 0.0)
        # Beyond the range: the error of the slope times the way, out and, by a hysteresis, back.
        beyond_before = self._beyond_degc
        beyond = np.maximum(np.maximum(self._low - degc, degc - self._high), 0.0)
        back = beyond_before - beyond >= MOVED_DEGC
        self._beyond_degc = np.where(back, beyond, np.fmax(beyond_before, beyond))
        degc2 = np.abs(self._beyond_degc**2 - beyond_before**2) + lag_degc**2
        # By the state at power-on: as much as has faded of its sd.
        faded_before = self._faded
        self._power_on_sd = np.where(np.isfinite(self._power_on_sd), self._power_on_sd, sd)
        self._faded = np.fmax(faded_before, (sd - self._power_on_sd) ** 2)
        return walk + self._steepness**2 * degc2 + self._faded - faded_before

    def unseen_lag(self, gap_s: float, behind: SampleBlock) -> FloatArray:
        """Return by how much the lag of each gyro's temperature may have changed in a gap (sd), °C, (3,), by
        the rate (sd) that the first row `behind` it has, else by `UNSEEN_RATE`."""
        rate_sd = self._first_of(behind, "_rate_sd")[0]
        unseen = np.where(np.isfinite(rate_sd), rate_sd, UNSEEN_RATE)
        return -OWN_LAG_S * math.expm1(-gap_s / OWN_LAG_S) * unseen  # lag of first order behind this rate

    def process(self, block: SampleBlock) -> tuple[FloatArray, FloatArray]:
        """Return the temperature of each gyro and its sd, °C, (2, n, 3), estimated where possible, and three
        by the model, rad/s, (3, n, 3), zero without one: what is added to the bias since the first
        temperature, the curve, and the sd of its unknown state at power-on; both NaN before that."""
        # The reading is used only where there is no estimate at all: mixed, both would jump.
        temperature = self._first_of(block, "_estimate", "")
        temperatures = np.stack([temperature, np.nan_to_num(self._first_of(block, "_estimate_sd"))])
        if self._predictor is None:
            return temperatures, np.zeros((3, len(block), 3))
        predicted = self._predictor.of_block(block, temperature)
        curve, known = predicted.bias, np.isfinite(predicted.bias)
        for j in np.flatnonzero(np.isnan(self._reference) & known.any(0)):
            self._reference[j] = curve[np.argmax(known[:, j]), j]
        if len(block) and not known.any():
            self.notices["the bias model lacks its temperature: the bias is taken as constant"] = None
        if (np.isfinite(temperature) & ~predicted.inside).any():
            self.notices[
                f"the temperature is outside the bias model's range, {self._low.max():.1f} to "
                f"{self._high.min():.1f} °C: the bias is extrapolated"
            ] = None
        total = np.where(known, curve - self._reference, 0.0)
        return temperatures, np.stack([total, curve, np.where(known, predicted.start_sd, np.nan)])

    def _first_of(self, block: SampleBlock, *kinds: str) -> FloatArray:
        """Return the first column of these kinds that a block has for each gyro, (n, 3); else NaN."""
        names = [[f"temperature{kind}{end}" for kind in kinds for end in ends] for ends in self._suffixes]
        return block.stacked([next((name for name in of_gyro if name in block), "") for of_gyro in names])


class BiasTrail:
    """Bias over temperature since the start, thinned to constant memory, beside the curves of a model."""

    def __init__(self, model: BiasModel | None) -> None:
        self._channels = [] if model is None else [model.channels[name] for name in GYROS]
        self._points, self._latest = list[FloatArray](), np.zeros(6)
        self._every, self._count = 1, 0

    def add(self, temperature: FloatArray, bias: FloatArray) -> None:
        """Take estimates of slots, (n, 3) each, in °C and rad/s."""
        points = np.hstack([temperature, bias])
        for point in points[np.isfinite(points).all(1)]:
            if self._count % self._every == 0:
                self._points.append(point)
            self._count += 1
            self._latest = point
            if len(self._points) > MOST_POINTS:
                self._points = self._points[::2]
                self._every *= 2

    def charts(self) -> list[Chart]:
        """Return charts of the bias and, with a model, of the bias less its curve; none without data."""
        if not self._points:
            return []
        degc, bias = np.hsplit(np.vstack([*self._points, self._latest]), 2)
        bias = bias / DEG_PER_H
        lines, left = [], bias.copy()
        for j, ((axis, color), channel) in enumerate(zip(AXIS_COLORS.items(), self._channels, strict=False)):
            low, high = channel.temperature_range_degc
            at = np.linspace(low, high, 101)
            lines.append(Curve(f"{axis}, model", at, channel.value(at) / DEG_PER_H, color, width=1.2))
            left[:, j] -= channel.value(degc[:, j]) / DEG_PER_H
        dots = "dots: estimates since the start; large: now"
        note = f"line: model; {dots}" if lines else dots
        over = (*lines, *_trails(degc, bias))
        axes = Axis("temperature [°C]"), Axis("bias [°/h]")
        charts = [Chart("gyro_bias", "Gyro bias", "Gyro bias over temperature", *axes, over, notes=(note,))]
        if lines:
            title, over = "Gyro bias minus the calibrated curve", tuple(_trails(degc, left))
            charts.append(Chart("gyro_bias_left", "Residual", title, *axes, over, notes=(dots,)))
        return charts


def _trails(degc: FloatArray, bias: FloatArray) -> Iterator[Curve]:
    """Yield where each axis has been, and where it is now, the last point, larger; °C and °/h, (n, 3)."""
    for (axis, color), x, y in zip(AXIS_COLORS.items(), degc.T, bias.T, strict=True):
        yield Curve(f"{axis}, estimate", x[:-1], y[:-1], color, points=True, width=2.5)
        yield Curve(f"now {axis}", x[-1:], y[-1:], color, points=True, width=9.0, listed=False)
