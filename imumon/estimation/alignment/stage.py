"""Alignment as a stage of the pipeline: the heading of a unit at rest, with its sigma."""

from __future__ import annotations

import copy
import math
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import Chart
from imumon.columns import Column
from imumon.estimation.alignment import charting
from imumon.estimation.alignment.aligner import SLOT_S, Aligner
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.positions import CALM, Slot
from imumon.estimation.alignment.status import Estimate, Position, Status, instead
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.geodesy import DEG_PER_H

MEANS = ("gyro_mean", "hann_mean")
"""What stands beside the joint fit."""
OBSERVED_S = 30.0
"""After so long it is said that a gyro does not see the north."""
LIKELY = 0.5
"""Probability of a tilt from which on it is said."""
POINTS = 400
"""Points that a chart keeps at the most."""
GAP, LONGEST_INTERVAL_S = 2.5, 30.0
"""A longer step between slots of one sample, in usual intervals, is a gap; the first may take so many s."""
_ANGLES = ("roll", "pitch")
_STATE = (
    "_aligner", "_down", "_prefix", "_begun", "_yaw", "_origin_ns", "_last_ns", "_interval_s", "_force",
    "_said", "_points", "_spacing", "_added", "_last", "_segment", "_status",
)  # fmt: skip
_CHANNELS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel", "mag") for axis in "xyz")


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
        self._aligner = Aligner(self._parameters, latitude_deg)
        self._slots = SlotGatherer(len(_CHANNELS) + 1, round(SLOT_S * 1e9), rates=0)
        self._down = 0.0 if axes is None else (1.0 if axes == "FRD" else -1.0)
        self._prefix = "aligned_" if set(_ANGLES) & set(sent) else ""
        self._begun = False
        self._yaw = math.nan
        self._origin_ns = self._last_ns = self._segment = 0
        self._interval_s = 0.0
        self._force = np.full((CALM, 3), np.nan)
        """Specific force of the last slots, m/s²."""
        self._said: set[str] = set()
        self._points: list[tuple[float, float]] = []
        self._spacing = 1.0
        self._added = [column.name for column in self.columns]
        self._last = np.full(len(self._added), np.nan)
        self._status = self._stands()

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        texts = {
            "heading": "heading of the body x axis, clockwise from true north; NaN if not observable",
            "heading_sd": "its standard deviation",
            f"{self._prefix}roll": "roll of the alignment",
            f"{self._prefix}pitch": "pitch of the alignment",
            "roll_drift": "change of roll since the first rest",
            "pitch_drift": "change of pitch since the first rest",
            "heading_magnetic": "heading of the body x axis from magnetic north",
        }
        for name in MEANS:
            texts[f"heading_{name}"] = f"heading by the {name.replace('_', ' ')}"
            texts[f"heading_{name}_sd"] = "its standard deviation"
        return [Column(name, "rad", description=text) for name, text in texts.items()]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is nothing yet.

        Needs ``device_time_ns`` and ``segment``, gyros and accelerometers; uses ``at_rest`` and ``mag_*``.
        """
        n = len(block)
        if n and not self._begun:
            self._begun = True
            self._prefix = "aligned_" if "roll" in block or "pitch" in block else self._prefix
            self._added = [column.name for column in self.columns]
        slots = self._slots.process(block["device_time_ns"], block["segment"], self._values(block))
        yaw = block.columns.get("yaw", np.empty(0))
        self._yaw = next(iter(yaw[np.isfinite(yaw)][-1:].tolist()), self._yaw)
        rows = self._rows(slots)
        out = held(slots.row, rows.T, self._last, n, axis=-1)
        # The columns of one segment do not hold in a new one.
        other = held(slots.row, slots.segment, np.array(self._segment), n) != block["segment"]
        if other.any():
            out[:, other] = np.nan
        if len(slots):
            self._last, self._segment = rows[-1], int(slots.segment[-1])
            self._status = self._stands()
        return dict(zip(self._added, out, strict=True))

    def _values(self, block: SampleBlock) -> FloatArray:
        """Return gyros, accelerometers and magnetometer, NaN where unknown, and whether it rests, (n, 10)."""
        n = len(block)
        values = np.full((n, len(_CHANNELS) + 1), np.nan)
        for j, name in enumerate(_CHANNELS):
            if name in block:
                values[:, j] = block[name]
        values[~np.isfinite(values[:, :6].sum(axis=1)), :6] = np.nan
        values[:, -1] = np.asarray(block.columns.get("at_rest", np.ones(n, np.int64))) != 0  # or unknown
        return values

    def _rows(self, slots: Slots) -> FloatArray:
        """Give slots to the estimator; return the columns after each, (m, k)."""
        m = len(slots)
        rows = np.full((m, len(self._added)), np.nan)
        up, first = np.full((2, m, 3), np.nan)
        valid = slots.count[:, :6].min(axis=1, initial=1 << 30)
        begins, start, end = slots.begins.tolist(), slots.start_ns.tolist(), slots.end_ns.tolist()
        samples, counts, rest = slots.samples.tolist(), valid.tolist(), (slots.smallest[:, -1] > 0.0).tolist()
        magnetic, rates = slots.mean[:, 6:9].tolist(), slots.mean[:, :3].tolist()
        for k in range(m):
            self._time(begins[k], start[k], end[k], samples[k])
            if counts[k]:
                if self._down == 0.0:
                    self._down = 1.0 if slots.mean[k, 5] < 0.0 else -1.0
                time_s = 0.5 * (start[k] - self._origin_ns + end[k] - self._origin_ns) * 1e-9
                length_s = samples[k] * (self._interval_s or SLOT_S)
                slot = Slot(time_s, length_s, counts[k], slots.mean[k, :6], tuple(rates[k]))
                self._aligner.step(slot, magnetic[k], rest[k], slots.turns, k)
                self._collect()
            state = self._aligner.state
            if state.positions:
                rows[k], first[k] = self._row(), state.first_vertical
                if state.motion.turning:
                    up[k] = state.attitude[2]
        # At rest, the level is by the accelerometers of the last 2 s.
        force = np.concatenate([self._force, slots.mean[valid > 0, 3:6]])
        resting = np.isnan(up[:, 0]) & np.isfinite(first[:, 0])
        up[resting] = _moving_sums(force)[np.cumsum(valid > 0)[resting]]
        self._force = force[len(force) - CALM :]
        rows[:, 2:4] = self._angles(up)
        rows[:, 4:6] = np.remainder(rows[:, 2:4] - self._angles(first) + math.pi, 2.0 * math.pi) - math.pi
        return rows

    def _time(self, begins: bool, start: int, end: int, samples: int) -> None:
        """Renew origin and sample interval by a slot."""
        if begins:
            self._aligner.begin_run()
            self._origin_ns = self._last_ns = start
            self._interval_s, self._points, self._spacing = 0.0, [], 1.0
        since_s = (start - self._last_ns) * 1e-9
        if samples > 1:
            self._interval_s = (end - start) * 1e-9 / (samples - 1)
        elif 0.0 < since_s < (GAP * self._interval_s or LONGEST_INTERVAL_S):
            self._interval_s = since_s
        self._last_ns = end

    def _row(self) -> list[float]:
        """Return the columns of now, without level."""
        aligner = self._aligner
        shown, state = aligner.observable, aligner.state
        row = [math.nan] * len(self._added)
        row[0], row[1] = aligner.heading if shown else math.nan, aligner.heading_sd
        row[6] = self._magnetic()
        for j, name in enumerate(MEANS):
            if name in state.means:
                estimate = state.means[name]
                row[7 + 2 * j] = aligner.as_heading(estimate.heading) if shown else math.nan
                row[8 + 2 * j] = estimate.sd
        return row

    def _collect(self) -> None:
        """Keep points for the charts, half of them when there are too many."""
        aligner, state = self._aligner, self._aligner.state
        time_s = state.counted_s
        if state.found is None or not aligner.resting:
            return
        if self._points and time_s < self._points[-1][0]:
            self._points, self._spacing = [], 1.0
        if not self._points or time_s >= self._points[-1][0] + self._spacing:
            self._points.append((time_s, aligner.heading_sd))
        if len(self._points) > POINTS:
            self._points, self._spacing = self._points[::2], 2.0 * self._spacing

    def _angles(self, up: FloatArray) -> FloatArray:
        """Return roll and pitch, rad, ZYX, (n, 2), from verticals in body axes, (n, 3)."""
        x, y, z = (-self._down * up).T
        return np.column_stack([np.arctan2(y, z), -np.arctan2(x, np.hypot(y, z))])

    def _magnetic(self) -> float:
        state = self._aligner.state
        if not state.field_sum[3] or not state.positions:
            return math.nan
        ahead, left, _ = (state.attitude @ state.field_sum[:3]).tolist()
        return self._aligner.as_heading(math.atan2(left, ahead))

    def snapshot(self) -> dict[str, object]:
        """Return a copy of all that is remembered."""
        return {
            "slots": self._slots.snapshot(),
            **copy.deepcopy({name: getattr(self, name) for name in _STATE}),
        }

    def restore(self, saved: Mapping[str, Any]) -> None:
        """Go on from what `snapshot` returned."""
        self._slots.restore(saved["slots"])
        for name in _STATE:
            setattr(self, name, copy.deepcopy(saved[name]))

    @property
    def wanted_deg(self) -> float:
        """The sigma wanted, degrees."""
        return self._parameters.settled_deg

    def finish(self) -> list[Position]:
        """Fit what has come since the last fit; return where the unit stood still."""
        return self._aligner.finish()

    @property
    def status(self) -> Status:
        """Where the alignment stood after the last block; may be read by another thread."""
        return self._status

    def _stands(self) -> Status:
        aligner, state = self._aligner, self._aligner.state
        observable = aligner.observable
        estimates: dict[str, Estimate] = {}
        shown = None
        if state.found is not None:
            shown = Estimate(aligner.heading if observable else math.nan, aligner.heading_sd)
            estimates["joint"] = shown
            for name, mean in state.means.items():
                heading = aligner.as_heading(mean.heading) if observable else math.nan
                estimates[name] = Estimate(heading, mean.sd)
        roll, pitch = self._last[2:4].tolist() if aligner.resting else (math.nan, math.nan)
        last = state.positions[-1] if state.positions else None
        fit = None if last is None else last.fit
        return Status(
            phase=self._phase(),
            observable=observable,
            shown=shown,
            settled_s=state.settled_s,
            to_go_s=self._to_go(shown),
            estimates=estimates,
            magnetic=self._magnetic(),
            device_yaw=self._yaw,
            time_s=state.counted_s,
            roll=roll,
            pitch=pitch,
            arw=math.nan if fit is None else math.sqrt(fit.white),
            bias_sd=math.nan if state.found is None else state.found.bias_sd,
            tilting=0.0 if state.found is None else state.found.settling,
            restarts=state.restarts,
            disturbed=state.disturbed,
            seconds=state.ended_s,
            shaken_s=state.shaken_s,
            wanted=math.radians(self._parameters.settled_deg),
            earth_rate=aligner.level_rate,
            positions=0 if last is None else last.number,
            position_s=0.0 if fit is None else fit.seconds,
            position_sd=math.inf if fit is None else math.sqrt(fit.variance[0]) / aligner.level_rate,
            turned=aligner.turned,
            bias_declared=self._parameters.gyro_bias_sd_deg_per_h is not None,
            force_sd=aligner.errors.level,
        )

    def _phase(self) -> str:
        state = self._aligner.state
        if not self._begun or not state.ended_s:
            return "waiting"
        if state.positions and state.motion.turning:
            return "disturbed"
        if state.found is None:
            return "coarse"
        if not self._aligner.observable:
            return "not observable" if state.counted_s > OBSERVED_S else "coarse"
        return "settled" if state.settled_s is not None else "aligning"

    def _to_go(self, shown: Estimate | None) -> float | None:
        """Return the seconds until white noise alone would leave the sigma wanted."""
        state = self._aligner.state
        if shown is None or state.found is None or math.isnan(shown.heading):
            return None
        wanted = math.radians(self._parameters.settled_deg)
        if shown.sd <= wanted:
            return 0.0
        white = state.found.noise_sd**2
        left = wanted**2 - (state.found.bias_sd / self._aligner.level_rate) ** 2
        # What a possible tilt adds falls with time, too.
        return max(state.counted_s * (max(white, 0.0) / left - 1.0), 1.0) if left > 0.0 else None

    def lanes(self) -> Mapping[str, str]:
        """Return the state of the alignment, and what tells the heading that is shown."""
        status = self.status
        phase = "not observable with this gyro" if status.phase == "not observable" else status.phase
        shown = "none yet"
        if status.phase == "not observable":
            shown = instead(status)[0]
        elif status.shown is not None and status.observable:
            shown = "joint fit"
        return {"alignment": phase, "heading by": shown}

    def charts(self) -> Sequence[Chart]:
        """Return the estimators beside each other, and the sigma on its way."""
        if len(self._points) < 2 or self._aligner.state.found is None:
            return []
        status, points = self.status, np.array(self._points)
        wanted = self._parameters.settled_deg
        return [
            charting.headings(status),
            charting.progress(status, points[:, 0], points[:, 1], wanted),
        ]

    def notices(self) -> list[str]:
        """Return, once each, disturbances and what they did, and why there is no heading."""
        events = self._aligner.state.events
        found = list(events)
        events.clear()
        for text, true in self._conditions().items():
            if true and text not in self._said:
                self._said.add(text)
                found.append(text)
        return found

    def _conditions(self) -> dict[str, bool]:
        status, state = self.status, self._aligner.state
        level = self._aligner.level_rate / DEG_PER_H
        declared = self._parameters.gyro_bias_sd_deg_per_h
        contradicted = (
            declared is not None and state.found is not None
            and state.found.size_sd > 3.0 * max(declared, 1e-3) * DEG_PER_H
        )  # fmt: skip
        return {
            "alignment: the level changes as the gyros turn: the unit is tilting (a tripod that settles?)": (
                status.tilting > LIKELY and status.observable
            ),
            "heading not observable with this gyro: its bias is not small beside the earth's horizontal "
            f"rate of {level:.1f} °/h; a turn by half a circle, and a rest, tell them apart; or an axis is "
            "swapped or reversed, or the unit of the gyros or the latitude is wrong": status.phase
            == "not observable",
            "alignment: the gyros' turn-on bias is not declared (gyro_bias_sd_deg_per_h), and from one "
            "position it cannot be told from the earth's rotation: sigma takes it for that of gyros of such "
            "noise, and is too small where it is larger; a turn by half a circle and a rest take it off": (
                status.phase in ("aligning", "settled") and not status.bias_declared and status.positions == 1
            ),
            "alignment: the rates contradict the declared bias of the gyros, or the latitude is wrong": bool(
                contradicted
            ),
        }


def _moving_sums(force: FloatArray) -> FloatArray:
    """Return the sums of each CALM rows, (n - CALM + 1, 3), in the same order however many at once."""
    total = np.zeros((len(force) - CALM + 1, 3))
    for k in range(CALM):
        total += force[k : k + len(total)]
    return total
