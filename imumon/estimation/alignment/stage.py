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
from imumon.estimation.alignment.estimator import SLOT_S, Aligner, State
from imumon.estimation.alignment.motion import LEAST, RECENT, Slot
from imumon.estimation.alignment.parameters import AlignmentParameters
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
_ANGLES = ("roll", "pitch")
_STATE = (
    "_aligner", "_down", "_prefix", "_begun", "_yaw", "_origin_ns", "_last_ns", "_said", "_points",
    "_spacing", "_added", "_last", "_segment", "_status",
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
        self._said: set[str] = set()
        self._points: list[tuple[float, float]] = []
        self._spacing = 1.0
        self._added = [column.name for column in self.columns]
        self._last = np.full(len(self._added), np.nan)
        self._status = self._judge()

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
        values = np.full((n, len(_CHANNELS) + 1), np.nan)
        for j, name in enumerate(_CHANNELS):
            if name in block:
                values[:, j] = block[name]
        unknown = ~np.isfinite(sum(values[:, j] for j in range(6)))
        if unknown.any():
            values[unknown, :6] = np.nan
        # Unknown is no motion.
        values[:, -1] = np.asarray(block.columns.get("at_rest", np.ones(n, np.int64))) != 0
        yaw = block.columns.get("yaw", np.empty(0))
        self._yaw = next(iter(yaw[np.isfinite(yaw)][-1:].tolist()), self._yaw)
        slots = self._slots.process(block["device_time_ns"], block["segment"], values)
        rows = np.empty((len(slots), len(self._added)))
        spread = np.stack([slots.mean[:, :6], slots.variance[:, :6]], axis=1)
        k = 0
        while k < len(slots):
            taken = self._rest_on(slots, spread, k, rows)
            if not taken:
                self._step(slots, spread, k)
                rows[k], taken = self._row(), 1
            k += taken
        out = held(slots.row, rows.T, self._last, n, axis=-1)
        # What was said of another segment does not hold in a new one.
        other = held(slots.row, slots.segment, np.array(self._segment), n) != block["segment"]
        if other.any():
            out[:, other] = np.nan
        if len(slots):
            self._last, self._segment = rows[-1], int(slots.segment[-1])
            self._status = self._judge()
        return dict(zip(self._added, out, strict=True))

    def _step(self, slots: Slots, values: FloatArray, k: int) -> None:
        """Give a slot to the estimator; `values` are means and variances of all, (m, 2, 6)."""
        start, end = int(slots.start_ns[k]), int(slots.end_ns[k])
        state = self._aligner.state
        if slots.begins[k] or not self._origin_ns:
            if not slots.begins[k] or state.poses:
                self._aligner.begin_anew("the device started anew")
            self._aligner.run += int(slots.begins[k])
            self._aligner.state = state = State(
                events=self._aligner.state.events, restarts=self._aligner.state.restarts
            )
            self._origin_ns, self._last_ns = start, start
            self._points, self._spacing = [], 1.0
        samples, valid = int(slots.samples[k]), int(slots.count[k, :6].min())
        if samples > 1:
            state.interval_s = (end - start) * 1e-9 / (samples - 1)
        elif start > self._last_ns:
            state.interval_s = (start - self._last_ns) * 1e-9
        self._last_ns = end
        if valid == 0:
            return
        if self._down == 0.0:
            self._down = 1.0 if slots.mean[k, 5] < 0.0 else -1.0
        slot = Slot(
            time_s=0.5 * (start - self._origin_ns + end - self._origin_ns) * 1e-9,
            length_s=samples * state.interval_s if state.interval_s < 30.0 else SLOT_S,
            samples=valid,
            values=values[k],
            at_rest=bool(slots.smallest[k, -1] > 0.0),
            turn=slots.turns.at(k),
        )
        self._aligner.step(slot, slots.mean[k, 6:9].tolist())
        self._collect()

    def _rest_on(self, slots: Slots, values: FloatArray, first: int, rows: FloatArray) -> int:
        """Give slots from the first on to the estimator while the unit rests as before; return how many.

        What `_step` does one by one, it does at once for those that nothing disturbs.
        """
        aligner, state = self._aligner, self._aligner.state
        if state.motion.disturbed or not self._origin_ns:
            return 0
        ahead = slots[first : first + RECENT]
        start, end = ahead.start_ns - self._origin_ns, ahead.end_ns - self._origin_ns
        samples, valid = ahead.samples, ahead.count[:, :6].min(axis=1)
        interval_s = (end - start) * 1e-9 / np.maximum(samples - 1, 1)
        time_s, length_s = 0.5 * (start + end) * 1e-9, samples * interval_s
        before = np.r_[state.slot_end_s, (time_s + 0.5 * length_s)[:-1]]
        even = time_s - 0.5 * length_s - before <= np.maximum(SLOT_S, 2.5 * length_s)
        even &= (
            ~ahead.begins & (samples > 1) & (valid > 0) & (ahead.smallest[:, -1] > 0.0) & (interval_s < 30.0)
        )
        many = len(even) if even.all() else int(even.argmin())
        levels = state.motion.rest_on(values[first : first + many])
        times, lengths, counts = time_s.tolist(), length_s.tolist(), valid.tolist()
        magnetic = ahead.mean[:, 6:9].tolist()
        row, due_s = self._headings(), state.due_s
        for k in range(len(levels)):
            slot = Slot(times[k], lengths[k], counts[k], values[first + k], True)
            aligner.count(slot, magnetic[k])
            self._collect()
            if state.due_s != due_s:
                row, due_s = self._headings(), state.due_s
            if not math.isnan(row[0]):
                row[:2] = aligner.heading, aligner.heading_sd  # a creep is followed from fit to fit
            row[6] = self._magnetic()
            rows[first + k] = row
        if len(levels):
            state.interval_s = float(interval_s[len(levels) - 1])
            self._last_ns = int(ahead.end_ns[len(levels) - 1])
            rows[first : first + len(levels), 2:6] = self._angles(levels)
        return len(levels)

    def _row(self) -> list[float]:
        """Return the columns of now."""
        row, state = self._headings(), self._aligner.state
        if state.poses:
            if state.first_angles is None and len(state.motion.recent) >= LEAST:
                state.first_angles = self._level()
            row[2:6] = self._angles(self._up()[None])[0].tolist()
            row[6] = self._magnetic()
        return row

    def _headings(self) -> list[float]:
        """Return the columns of now, without level and magnetic heading."""
        aligner, state = self._aligner, self._aligner.state
        row = [math.nan] * len(self._added)
        if not state.poses:
            return row
        shown = aligner.observable
        row[0] = aligner.heading if shown else math.nan
        row[1] = aligner.heading_sd
        for j, name in enumerate(MEANS):
            if name in state.means:
                estimate = state.means[name]
                row[7 + 2 * j] = aligner.as_heading(estimate.heading) if shown else math.nan
                row[8 + 2 * j] = estimate.sd
        return row

    def _up(self) -> FloatArray:
        """Return the vertical in body axes, (3,), by the accelerometers of the last two seconds."""
        state = self._aligner.state
        return state.attitude[2] if state.motion.disturbed else state.motion.level

    def _angles(self, up: FloatArray) -> FloatArray:
        """Return roll and pitch, rad, ZYX, and their change since the first rest, (n, 4), from (n, 3)."""
        x, y, z = (-self._down * up).T
        angles = np.column_stack([np.arctan2(y, z), -np.arctan2(x, np.hypot(y, z))])
        first = self._aligner.state.first_angles or (math.nan, math.nan)
        return np.hstack([angles, np.remainder(angles - first + math.pi, 2.0 * math.pi) - math.pi])

    def _level(self) -> tuple[float, float]:
        """Return roll and pitch, rad."""
        roll, pitch = self._angles(self._up()[None])[0, :2].tolist()
        return roll, pitch

    def _magnetic(self) -> float:
        state = self._aligner.state
        if not state.field_sum[3]:
            return math.nan
        ahead, left, _ = (state.attitude @ state.field_sum[:3]).tolist()
        return self._aligner.as_heading(math.atan2(left, ahead))

    def _collect(self) -> None:
        """Keep points for the charts, half of them when there are too many."""
        state = self._aligner.state
        time_s = state.counted_s
        if not state.poses or state.found is None or state.motion.disturbed:
            return
        if self._points and time_s < self._points[-1][0]:
            self._points, self._spacing = [], 1.0
        if not self._points or time_s >= self._points[-1][0] + self._spacing:
            self._points.append((time_s, self._aligner.heading_sd))
        if len(self._points) > POINTS:
            self._points, self._spacing = self._points[::2], 2.0 * self._spacing

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

    def _judge(self) -> Status:
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
        rests = bool(state.poses) and len(state.motion.recent) >= LEAST
        roll, pitch = self._level() if rests else (math.nan, math.nan)
        last = state.fits[-1] if state.fits and len(state.fits) == len(state.poses) else None
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
            arw=math.nan if not state.fits else math.sqrt(state.fits[-1].white),
            bias_sd=math.nan if state.found is None else state.found.bias_sd,
            tilting=0.0 if state.found is None else state.found.tilting,
            restarts=state.restarts,
            disturbed=state.disturbed,
            seconds=state.slot_end_s,
            shaken_s=state.shaken_s,
            wanted=math.radians(self._parameters.settled_deg),
            earth_rate=aligner.level_rate,
            positions=len(self._aligner.positions),
            position_s=0.0 if last is None else last.seconds,
            position_sd=math.inf if last is None else math.sqrt(last.variance[0]) / aligner.level_rate,
            turned=self._aligner.turned,
            bias_declared=self._parameters.gyro_bias_sd_deg_per_h is not None,
            force_sd=aligner.force_sd,
        )

    def _phase(self) -> str:
        state = self._aligner.state
        if not self._begun or not state.slot_end_s:
            return "waiting"
        if state.poses and state.motion.disturbed:
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
            and state.found.supposed_sd > 3.0 * max(declared, 1e-3) * DEG_PER_H
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
