"""Alignment as a stage of the pipeline: the heading of a unit at rest, with its sigma."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Literal

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import Chart
from imumon.columns import Column
from imumon.estimation.alignment import charting, kernel, state
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.standing import Estimate, Standing, instead
from imumon.estimation.alignment.watch import GAP, ROTATION, SCATTER, STEP, UNREST
from imumon.estimation.temperature_rate.series import SegmentClock
from imumon.geodesy import DEG_PER_H, EARTH_RATE, MICRO_G

NAMES = ("total_average", "curve_fit", "line_exponential", "tilt_corrected", "known_warm_up")
"""The estimators, in the order of the kernel's results."""
REAL = 0.95
"""Probability from which on a change of the level is called a tilt."""
POINTS = 400
"""Points that the chart keeps at the most."""

_CAUSES = {
    SCATTER: "a shock or vibration",
    ROTATION: "the unit turned",
    STEP: "the specific force jumped",
    UNREST: "the unit moved",
    GAP: "samples are missing",
}
_ANGLES = ("roll", "pitch")


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
        # Views into the state: a record looks its fields up slowly.
        self._number, self._flag, self._result = self._state.number, self._state.flag, self._state.result
        self._clock = SegmentClock()
        self._begun = False
        self._yaw = math.nan
        self._disturbed = self._restarts = 0
        self._logged = 0
        self._said: set[str] = set()
        self._pending: list[str] = []
        self._points: list[tuple[float, float, float, float]] = []
        self._spacing = 1.0
        self._added = [column.name for column in self.columns]
        self._standing = self._judge()

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
            self._added = [column.name for column in self.columns]
        readings = np.full((n, 6), np.nan)
        for j, name in enumerate(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz"):
            if name in block:
                readings[:, j] = block[name]
        field = block.mag
        if field is None:
            field = np.full((n, 3), np.nan)
        rest = np.asarray(block["at_rest"]) if "at_rest" in block else np.ones(n, np.int64)
        yaw = block.columns.get("yaw", np.empty(0))
        self._yaw = next(iter(yaw[np.isfinite(yaw)][-1:].tolist()), self._yaw)
        out = np.full((n, kernel.OUTPUTS), np.nan)
        for start, stop, begins, seconds in self._clock.runs(block["device_time_ns"], block["segment"]):
            if begins:
                kernel.new_segment(self._state)
            part = slice(start, stop)
            self._settle_axes(readings[part])
            kernel.process(
                seconds, readings[part], field[part], rest[part], self._settings, self._state, out[part]
            )
            self._collect()
        self._standing = self._judge()
        return {name: np.ascontiguousarray(out[:, j]) for j, name in enumerate(self._added)}

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
        time_s = float(self._number[state.TIME])
        if self._points and time_s < self._points[-1][0]:
            self._points, self._spacing = [], 1.0
        if not self._points or time_s >= self._points[-1][0] + self._spacing:
            east, north = self._state.path[:2].tolist()
            chosen = int(self._flag[state.CHOSEN])
            sd = float(self._state.result[chosen, 1]) if chosen >= 0 else math.nan
            self._points.append((time_s, east, north, sd))
        if len(self._points) > POINTS:
            self._points, self._spacing = self._points[::2], 2.0 * self._spacing

    @property
    def wanted_deg(self) -> float:
        """The sigma wanted, degrees."""
        return self._parameters.settled_deg

    @property
    def standing(self) -> Standing:
        """Where the alignment stood after the last block; may be read by another thread."""
        return self._standing

    def _judge(self) -> Standing:
        number, flag, result = self._number, self._flag, self._result
        observable = bool(flag[state.OBSERVED])
        estimates = {}
        for k, name in enumerate(self._names):
            heading, sd = result[k].tolist()
            visible = observable and sd < self._settings[state.OBSERVABLE]
            estimates[name] = Estimate(heading if visible else math.nan, sd)
        chosen = NAMES[flag[state.CHOSEN]] if flag[state.CHOSEN] >= 0 else None
        shown = None if chosen is None else estimates[chosen]
        settled = float(number[state.SETTLED_AT])
        known = chosen is not None
        roll, pitch = math.nan, math.nan
        if flag[state.PHASE] == state.FINE:
            roll, pitch = kernel.level_angles(self._state, self._settings)
        return Standing(
            phase=self._phase(chosen is not None, observable, math.isfinite(settled)),
            observable=observable,
            chosen=chosen,
            shown=shown,
            settled_s=settled if math.isfinite(settled) else None,
            to_go_s=self._to_go(shown),
            estimates=estimates,
            magnetic=kernel.magnetic_heading(self._state),
            device_yaw=self._yaw,
            time_s=float(number[state.TIME]),
            roll=roll,
            pitch=pitch,
            arw=math.sqrt(number[state.ARW2]) if known else math.nan,
            bias_sd=math.sqrt(number[state.BIAS_VARIANCE]) if known else math.nan,
            # A gyro that does not see the earth rate bends by its own drift as if the unit tilted.
            tilting=known and observable and bool(number[state.REAL_TILT] > REAL),
            disturbed=int(flag[state.LOGGED]),
            restarts=int(flag[state.RESTARTS]),
            seconds=0.0 if math.isnan(number[state.LAST]) else float(number[state.LAST]),
            coarse_s=float(number[state.COARSE_TIME]),
            shaken_s=float(flag[state.SHAKEN]) * kernel.SLOT,
            coarse_wanted_s=self._parameters.coarse_s,
            wanted=float(self._settings[state.SETTLED]),
            earth_rate=self._level,
        )

    def _phase(self, known: bool, observable: bool, settled: bool) -> str:
        flag = self._flag
        if flag[state.DISTURBED]:
            return "disturbed"
        if flag[state.PHASE] != state.FINE:
            return "coarse" if flag[state.PHASE] == state.COARSE else "waiting"
        if known and not observable:
            return "not observable"
        return "settled" if settled else "aligning"

    def _to_go(self, shown: Estimate | None) -> float | None:
        """Return the seconds until white noise alone would leave the sigma wanted."""
        if shown is None or math.isnan(shown.heading):
            return None
        number = self._number
        time_s, white = float(number[state.TIME]), number[state.ARW2] / self._level**2
        lasting = number[state.BIAS_VARIANCE] / self._level**2
        left = self._settings[state.SETTLED] ** 2 - lasting
        if shown.sd <= self._settings[state.SETTLED]:
            return 0.0
        return max(white / left - time_s, 1.0) if left > 0.0 else None

    def lanes(self) -> Mapping[str, str]:
        """Return the state of the alignment, and what tells the heading that is shown."""
        standing = self.standing
        phase = "not observable with this gyro" if standing.phase == "not observable" else standing.phase
        shown = "none yet"
        if standing.chosen is not None and standing.observable:
            shown = standing.chosen.replace("_", " ")
        elif standing.phase == "not observable":
            shown = instead(standing)[0]
        return {"alignment": phase, "heading by": shown}

    def charts(self) -> Sequence[Chart]:
        """Return the estimators beside each other, the sigma on its way, and the integrated control rates."""
        if len(self._points) < 2 or self._state.flag[state.CHOSEN] < 0:
            return []
        standing, points = self.standing, np.array(self._points)
        wanted, line = math.degrees(self._settings[state.SETTLED]), self._state.line
        return [
            charting.headings(standing),
            charting.progress(standing, points[:, 0], points[:, 3], wanted),
            charting.integrals(points[:, 0], points[:, 1:3], line),
        ]

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
        known = standing.chosen is not None
        level = self._level / DEG_PER_H
        late = float(number[state.TIME]) > 30.0
        return {
            "alignment: the level changes as the gyros turn: the unit is tilting (a sinking tripod?); the "
            "total average is free of that": standing.tilting,
            "heading not observable with this gyro: its bias is not small beside the earth's horizontal "
            f"rate of {level:.1f} °/h": known and late and not standing.observable,
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
        values[state.WARM_TAU : state.WARM_TAU + 3] = warm.time_constant_s
        values[state.WARM_SD] = (warm.amplitude_sd_ug or 0.0) * MICRO_G
        values[state.WARM_TAU_SD] = warm.time_constant_sd_s
    return values
