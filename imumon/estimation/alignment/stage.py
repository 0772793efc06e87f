"""Alignment as a stage of the pipeline: the heading of a unit at rest, with its sigma."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import Axis, Chart, Curve
from imumon.columns import Column
from imumon.estimation.alignment import kernel, state
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.watch import GAP, ROTATION, SCATTER, STEP, UNREST
from imumon.estimation.temperature_rate.series import SegmentClock
from imumon.estimation.zupt.earth import EARTH_RATE

NAMES = ("total_average", "curve_fit", "line_exponential", "tilt_corrected", "known_warm_up")
"""The estimators, in the order of the kernel's results."""
MICRO_G = 9.80665e-6
DEG_PER_H = math.pi / 180.0 / 3600.0
REAL = 0.95
"""Probability from which on a change of the level is called a tilt."""
PLACE = "Alignment"
POINTS = 400
"""Points that the chart keeps at the most."""

_CAUSES = {
    SCATTER: "a shock or vibration",
    ROTATION: "the unit turned",
    STEP: "the specific force jumped",
    UNREST: "the unit moved",
    GAP: "samples are missing",
}
_COLORS = ((232, 72, 72), (66, 133, 244))
_DRIFTS = ("roll_drift", "pitch_drift")
_ANGLES = ("roll", "pitch")


@dataclass(frozen=True, slots=True)
class Estimate:
    """A heading, rad clockwise from north, and its standard deviation."""

    heading: float
    sd: float


@dataclass(frozen=True, slots=True)
class Standing:
    """Where the alignment stands.

    Parameters
    ----------
    phase : str
        waiting, coarse, fine, settled, not observable or disturbed.
    chosen : str or None
        The estimator whose heading is shown.
    shown : Estimate or None
        Its heading; NaN where the gyro cannot see the north.
    settled_s : float or None
        s from the first sample until the heading settled, if it still is.
    to_go_s : float or None
        s until the sigma wanted is reached; None when it cannot be told, or never.
    estimates : mapping of str to Estimate
    magnetic : float
        rad from magnetic north; NaN without a magnetometer.
    arw, bias_sd : float
        Noise of the gyros in rad/√s, and standard deviation of a horizontal gyro's bias in rad/s.
    """

    phase: str
    observable: bool
    chosen: str | None
    shown: Estimate | None
    settled_s: float | None
    to_go_s: float | None
    estimates: Mapping[str, Estimate]
    magnetic: float
    arw: float
    bias_sd: float


class Alignment:
    """Finds the heading of a unit at rest by the earth rate.

    The heading is that of the body's x axis, clockwise from true north; where x is within 6 degrees of the
    vertical, that of -z.  Roll and pitch are ZYX angles to the horizontal of forward-right-down axes, or of
    forward-left-up ones.

    Parameters
    ----------
    parameters : AlignmentParameters
    latitude_deg : float
    axes : "FRD", "FLU" or None
        Body axes, for roll and pitch; None: whichever stands upright at the beginning.
    sent : collection of str
        Columns that the device may send.  A device's own roll and pitch stay as they are: the stage's are
        then called aligned_roll and aligned_pitch.  So are they when the first samples have a roll.
    """

    def __init__(
        self,
        parameters: AlignmentParameters | None,
        latitude_deg: float,
        axes: Literal["FRD", "FLU"] | None = None,
        sent: Collection[str] = (),
    ) -> None:
        self._parameters = parameters or AlignmentParameters()
        self._axes = axes
        self._prefix = "aligned_" if set(_ANGLES) & set(sent) else ""
        self._settings = _settings(self._parameters, latitude_deg)
        self._level = EARTH_RATE * math.cos(math.radians(latitude_deg))
        self._state = state.new_state()
        kernel.new_segment(self._state)
        self._clock = SegmentClock()
        self._begun = False
        self._elapsed = 0.0
        self._first_s = math.nan
        self._logged = 0
        self._said: set[str] = set()
        self._pending: list[str] = []
        self._points: list[tuple[float, float, float]] = []
        self._spacing = 1.0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        texts = {
            "heading": "heading of the body x axis, clockwise from true north; NaN if not observable",
            "heading_sd": "its standard deviation",
            f"{self._prefix}roll": "roll of the alignment",
            f"{self._prefix}pitch": "pitch of the alignment",
            "roll_drift": "change of roll since the coarse alignment",
            "pitch_drift": "change of pitch since the coarse alignment",
            "control_rate_east": "control rate about east",
            "control_rate_north": "control rate about north",
            "control_angle_east": "integral of the control rate about east",
            "control_angle_north": "integral of the control rate about north",
            "heading_magnetic": "heading of the body x axis from magnetic north",
        }
        for name in self._names:
            texts[f"heading_{name}"] = f"heading by {name.replace('_', ' ')}"
            texts[f"heading_{name}_sd"] = "its standard deviation"
        return [
            Column(name, "rad/s" if name.startswith("control_rate") else "rad", description=text)
            for name, text in texts.items()
        ]

    @property
    def _names(self) -> tuple[str, ...]:
        return NAMES if self._parameters.known_warm_up is not None else NAMES[:-1]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is nothing yet.

        Needs ``device_time_ns`` and ``segment``, gyros and accelerometers; uses ``at_rest`` and ``mag_*``.
        """
        n = len(block)
        if n and not self._begun:
            self._begun = True
            self._prefix = "aligned_" if "roll" in block or "pitch" in block else self._prefix
        readings = np.full((n, 6), np.nan)
        for j, name in enumerate(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"):
            if name in block:
                readings[:, j] = block[name]
        field = block.mag
        if field is None:
            field = np.full((n, 3), np.nan)
        rest = np.asarray(block["at_rest"]) if "at_rest" in block else np.ones(n, np.int64)
        out = np.full((n, kernel.OUTPUTS), np.nan)
        for start, stop, begins, seconds in self._clock.runs(block["device_time_ns"], block["segment"]):
            if begins:
                kernel.new_segment(self._state)
            part = slice(start, stop)
            self._settle_axes(readings[part])
            kernel.process(
                seconds, readings[part], field[part], rest[part], self._settings, self._state, out[part]
            )
            self._elapsed = float(seconds[-1])
            self._collect()
        columns = [column.name for column in self.columns]
        return {name: np.ascontiguousarray(out[:, j]) for j, name in enumerate(columns)}

    def _settle_axes(self, readings: FloatArray) -> None:
        """Take the axes from the first specific force where nothing else tells them."""
        if self._settings[state.DOWN] != 0.0:
            return
        if self._axes is not None:
            self._settings[state.DOWN] = 1.0 if self._axes == "FRD" else -1.0
            return
        whole = np.flatnonzero(np.isfinite(readings).all(1))
        if len(whole):
            self._settings[state.DOWN] = 1.0 if readings[whole[0], 5] < 0.0 else -1.0

    def _collect(self) -> None:
        """Keep points of the integrated control rates for the chart, half of them when there are too many."""
        time_s = float(self._state.number[state.TIME])
        if self._points and time_s < self._points[-1][0]:
            self._points, self._spacing = [], 1.0
        if not self._points or time_s >= self._points[-1][0] + self._spacing:
            east, north = self._state.path[:2].tolist()
            self._points.append((time_s, east, north))
        if len(self._points) > POINTS:
            self._points, self._spacing = self._points[::2], 2.0 * self._spacing

    @property
    def standing(self) -> Standing:
        """Where the alignment stands."""
        number, flag, result = self._state.number, self._state.flag, self._state.result
        estimates = {name: Estimate(*result[k].tolist()) for k, name in enumerate(self._names)}
        chosen = NAMES[flag[state.CHOSEN]] if flag[state.CHOSEN] >= 0 else None
        observable = bool(flag[state.OBSERVED])
        shown = None
        if chosen is not None:
            sd = estimates[chosen].sd
            visible = observable and sd < self._settings[state.OBSERVABLE]
            shown = Estimate(estimates[chosen].heading if visible else math.nan, sd)
        settled = float(number[state.SETTLED_AT])
        known = chosen is not None
        return Standing(
            phase=self._phase(chosen is not None, observable, math.isfinite(settled)),
            observable=observable,
            chosen=chosen,
            shown=shown,
            settled_s=settled if math.isfinite(settled) else None,
            to_go_s=self._to_go(shown),
            estimates=estimates,
            magnetic=kernel.magnetic_heading(self._state),
            arw=math.sqrt(number[state.ARW2]) if known else math.nan,
            bias_sd=math.sqrt(number[state.BIAS_VARIANCE]) if known else math.nan,
        )

    def _phase(self, known: bool, observable: bool, settled: bool) -> str:
        flag = self._state.flag
        if flag[state.DISTURBED]:
            return "disturbed"
        if flag[state.PHASE] != state.FINE:
            return "coarse" if flag[state.PHASE] == state.COARSE else "waiting"
        if not known:
            return "fine"
        if not observable:
            return "not observable"
        return "settled" if settled else "fine"

    def _to_go(self, shown: Estimate | None) -> float | None:
        """Return the seconds until white noise alone would leave the sigma wanted."""
        if shown is None or math.isnan(shown.heading):
            return None
        number = self._state.number
        time_s, white = float(number[state.TIME]), number[state.ARW2] / self._level**2
        lasting = number[state.BIAS_VARIANCE] / self._level**2
        left = self._settings[state.SETTLED] ** 2 - lasting
        if shown.sd <= self._settings[state.SETTLED]:
            return 0.0
        return max(white / left - time_s, 1.0) if left > 0.0 else None

    def lanes(self) -> Mapping[str, str]:
        """Return the state of the alignment and which estimator is shown."""
        standing = self.standing
        shown = standing.chosen.replace("_", " ") if standing.chosen and standing.observable else "none"
        return {"alignment": standing.phase, "heading by": shown}

    def charts(self) -> Sequence[Chart]:
        """Return the integrated control rates with the lines fitted to them."""
        if len(self._points) < 2:
            return []
        points, line = np.array(self._points), self._state.line
        t = points[:, 0]
        spread = line[0] * line[2] - line[1] ** 2
        curves = []
        for axis, (name, color) in enumerate(zip(("east", "north"), _COLORS, strict=True)):
            curves.append(Curve(name, t, 1e6 * points[:, 1 + axis], color, points=True, width=3.0))
            if spread > 0.0:
                slope = (line[0] * line[5 + axis] - line[1] * line[3 + axis]) / spread
                start = (line[3 + axis] - slope * line[1]) / line[0]
                ends = t[[0, -1]]
                curves.append(Curve(f"line {name}", ends, 1e6 * (start + slope * ends), color))
        x, y = Axis("observed time [s]"), Axis("angle [µrad]")
        title = "Integrated control rates, with their lines"
        return [Chart("alignment_integral", PLACE, title, x, y, tuple(curves))]

    def notices(self) -> list[str]:
        """Return, once each, disturbances and what they did, and why there is no heading."""
        found, self._pending = self._pending, []
        flag, log = self._state.flag, self._state.log
        logged = int(flag[state.LOGGED])
        for number in range(max(self._logged, logged - state.LOG_ROWS), logged):
            begin, end, cause, anew = log[number % state.LOG_ROWS]
            span = f"alignment: {_CAUSES.get(int(cause), 'disturbed')} at {begin:.1f} s"
            length = f" for {end - begin:.1f} s" if end > begin else ""
            found.append(f"{span}{length}: " + ("the alignment starts anew" if anew else "left out"))
        self._logged = logged
        for text, true in self._conditions().items():
            if true and text not in self._said:
                self._said.add(text)
                found.append(text)
        return found

    def _conditions(self) -> dict[str, bool]:
        standing, number = self.standing, self._state.number
        known, bias = standing.chosen is not None, standing.bias_sd / DEG_PER_H
        level = self._level / DEG_PER_H
        late = float(number[state.TIME]) > 30.0
        size = f"{float(f'{bias:.2g}'):g}" if known else ""
        return {
            "alignment: the level changes as the gyros turn: the unit is tilting (a sinking tripod?); the "
            "total average is free of that": known and bool(number[state.REAL_TILT] > REAL),
            "heading not observable with this gyro: its bias is not small beside the earth's horizontal "
            f"rate of {level:.1f} °/h": known and late and not standing.observable and bool(size),
            "alignment: the rates contradict the declared bias of the gyros, or the latitude is wrong": bool(
                self._state.flag[state.CONTRADICTED]
            ),
        }


def _settings(parameters: AlignmentParameters, latitude_deg: float) -> FloatArray:
    values = np.zeros(state.SETTINGS)
    bias, warm = parameters.gyro_bias_sd_deg_per_h, parameters.known_warm_up
    values[state.COARSE_S] = parameters.coarse_s
    values[state.CORNER] = 2.0 * math.pi * parameters.corner_hz
    values[state.DAMPING] = parameters.damping
    values[state.LATITUDE] = math.radians(latitude_deg)
    values[state.OBSERVABLE] = math.radians(parameters.observable_deg)
    values[state.BIAS_SD] = -1.0 if bias is None else bias * DEG_PER_H
    values[state.LEVEL_SD] = parameters.accel_bias_sd_ug * 1e-6
    values[state.LARGEST_DRIFT] = parameters.largest_drift_ug * 1e-6
    values[state.SETTLED] = math.radians(parameters.settled_deg)
    if warm is not None:
        values[state.WARM_X : state.WARM_X + 3] = np.array(warm.amplitude_ug) * MICRO_G
        values[state.WARM_TAU] = warm.time_constant_s
    return values
