"""Alignment as a stage of the pipeline: the heading of a unit at rest, with its sigma."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Mapping, Sequence
from typing import Literal

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import GREEN, GREY, Axis, Chart, Curve
from imumon.columns import Column
from imumon.estimation.alignment.aligner import Aligner
from imumon.estimation.alignment.motion import CALM_SLOTS
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.record import SLOT_S, Slot
from imumon.estimation.alignment.report import PositionHeading, Status, heading_text, to_go_text
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.geodesy import DEG_PER_H
from imumon.lane import LaneState, Level

NOT_OBSERVABLE_S = 30.0
"""Time at rest after which "not observable" is reported."""
LEVELS = {"waiting": Level.WAIT, "disturbed": Level.BAD, "aligning": Level.WAIT, "settled": Level.GOOD}
"""Of the phases; the others are neither good nor bad."""


class Alignment:
    """Stage that estimates the heading of a unit at rest from the earth rate.

    The heading is that of the body's x axis, clockwise from true north; where x is within 6 degrees of the
    vertical, that of -z.  Roll and pitch are ZYX angles to the horizontal of the body's `axes`; None is
    whichever of FRD and FLU stands upright at the beginning.

    Of a device with roll and pitch of its own, among the columns `sent` or in its first samples, the stage's
    are called aligned_roll and aligned_pitch.
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
        self._slots = SlotGatherer(10, round(SLOT_S * 1e9), rates=0)
        self._down = 0.0 if axes is None else (1.0 if axes == "FRD" else -1.0)
        """Sign of the body z axis: 1 down, -1 up, 0 not known yet."""
        self._prefix = "aligned_" if {"roll", "pitch"} & set(sent) else ""
        self._has_data = False
        self._yaw = math.nan
        self._origin_ns = self._segment = 0
        self._index = -1
        """Number of the last slot since the origin, the first sample of the segment."""
        self._force: deque[FloatArray] = deque(maxlen=CALM_SLOTS)
        """Specific force of the last 2 s, m/s², whose mean is the vertical at rest."""
        self._reported: set[str] = set()
        self._row = dict.fromkeys((column.name for column in self.columns), math.nan)
        """Columns after the last slot."""
        self.status = self._make_status()
        """State after the last block; may be read by another thread."""

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
        for name in ("gyro mean", "hann mean"):
            column = f"heading_{name.replace(' ', '_')}"
            texts |= {column: f"heading by the {name}", f"{column}_sd": "its standard deviation"}
        return [Column(name, "rad", description=text) for name, text in texts.items()]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is nothing yet.

        Needs ``device_time_ns`` and ``segment``, gyros and accelerometers; uses ``at_rest`` and ``mag_*``.
        """
        n = len(block)
        if n and not self._has_data:
            self._has_data = True
            self._prefix = "aligned_" if "roll" in block or "pitch" in block else self._prefix
            self._row = dict.fromkeys((column.name for column in self.columns), math.nan)
        slots = self._slots.process(block["device_time_ns"], block["segment"], self._inputs(block))
        yaw = block.columns.get("yaw", np.empty(0))
        self._yaw = next(iter(yaw[np.isfinite(yaw)][-1:].tolist()), self._yaw)
        names, before = list(self._row), np.array(list(self._row.values()))
        rows = np.empty((len(slots), len(names)))
        for k in range(len(slots)):
            self._process_slot(slots, k)
            self._row = self._make_row()
            rows[k] = list(self._row.values())
        out = held(slots.row, rows.T, before, n, axis=-1)
        # The columns of one segment do not hold in a new one.
        other = held(slots.row, slots.segment, np.array(self._segment), n) != block["segment"]
        if other.any():
            out[:, other] = np.nan
        if len(slots):
            self._segment = int(slots.segment[-1])
            self.status = self._make_status()
        return dict(zip(names, out, strict=True))

    def _inputs(self, block: SampleBlock) -> FloatArray:
        """Return gyros, accelerometers and magnetometer, NaN where unknown, and whether it rests, (n, 10)."""
        vectors = [
            np.full((len(block), 3), np.nan) if one is None else one
            for one in (block.gyro, block.accel, block.mag)
        ]
        rests = np.asarray(block.columns.get("at_rest", np.ones(len(block), np.int64))) != 0  # or unknown
        values = np.column_stack([*vectors, rests])
        values[~np.isfinite(values[:, :6].sum(axis=1)), :6] = np.nan
        return values

    def _process_slot(self, slots: Slots, k: int) -> None:
        """Advance the aligner by slot k, unless it has no whole sample of gyros and accelerometers."""
        start_ns, samples, mean = int(slots.start_ns[k]), int(slots.count[k, :6].min()), slots.mean[k]
        if slots.begins[k]:
            self._aligner.begin_run()
            self._origin_ns, self._index = start_ns, -1
        index = (start_ns - self._origin_ns) // self._slots.length_ns
        length_s = min(SLOT_S * (index - self._index), 2.0)  # a longer time without samples is no rest
        self._index = index
        if samples:
            self._force.append(mean[3:6].copy())
            at_rest = bool(slots.smallest[k, -1] > 0.0)
            slot = Slot(index, length_s, samples, mean[:6].copy())
            self._aligner.step(slot, mean[6:9], at_rest, slots.turns.at(k))

    def _make_row(self) -> dict[str, float]:
        aligner = self._aligner
        row = dict.fromkeys(self._row, math.nan)
        if not aligner.state.positions:
            return row
        row["heading_sd"] = aligner.heading_sd
        for name, estimate in aligner.estimates.items():
            column = "heading" if name == "joint" else f"heading_{name}"
            row[column], row[f"{column}_sd"] = estimate.heading, estimate.sd
        row["heading_magnetic"] = aligner.magnetic_heading
        turning = aligner.state.motion.moving
        up = aligner.state.attitude[2] if turning else np.sum(self._force, axis=0)
        angles, first = self._roll_and_pitch(up), self._roll_and_pitch(aligner.state.positions[0].attitude[2])
        for name, angle, at_first in zip(("roll", "pitch"), angles, first, strict=True):
            row[self._prefix + name] = angle
            row[f"{name}_drift"] = math.remainder(angle - at_first, 2.0 * math.pi)
        return row

    def _roll_and_pitch(self, up: Sequence[float] | FloatArray) -> tuple[float, float]:
        """Return roll and pitch, rad, ZYX, from a vertical in body axes, (3,)."""
        if not self._down:
            self._down = 1.0 if up[2] < 0.0 else -1.0
        x, y, z = (-self._down * float(value) for value in up)
        return math.atan2(y, z), -math.atan2(x, math.hypot(y, z))

    def finish(self) -> list[PositionHeading]:
        """Fit the rest since the last fit; return the heading in each position."""
        return self._aligner.finish()

    def _make_status(self) -> Status:
        aligner, state = self._aligner, self._aligner.state
        last = state.positions[-1] if state.positions else None
        fit = None if last is None else last.fit
        substitutes = (
            ("the device's own yaw", self._yaw),
            ("magnetic, not true north", self._row["heading_magnetic"]),
        )
        known = (substitute for substitute in substitutes if math.isfinite(substitute[1]))
        declared = self._parameters.gyro_bias_sd_deg_per_h is not None
        one_position = last is not None and last.number == 1 and aligner.observable and not declared
        return Status(
            phase=self._phase(),
            estimates=aligner.estimates,
            substitute=next(known, ("nothing", math.nan)),
            settled_s=state.settled_s,
            remaining_s=aligner.remaining_s,
            wanted_sd=math.radians(self._parameters.settled_deg),
            rest_s=state.rest_s,
            elapsed_s=aligner.elapsed_s,
            assumed_bias=aligner.heading_sd * aligner.earth_horizontal if one_position else None,
            tilt_probability=0.0 if state.posterior is None else state.posterior.tilt_probability,
            positions=0 if last is None else last.number,
            position_s=0.0 if last is None else last.record.rest_s,
            position_sd=math.inf if fit is None else math.sqrt(fit.variance.min()) / aligner.earth_horizontal,
            turned=aligner.turned,
        )

    def _phase(self) -> str:
        aligner, state = self._aligner, self._aligner.state
        table = (
            (not aligner.elapsed_s, "waiting"),
            (state.motion.moving, "disturbed"),
            (state.posterior is None, "coarse"),
            (not aligner.observable and state.rest_s > NOT_OBSERVABLE_S, "not observable"),
            (not aligner.observable, "coarse"),
            (state.settled_s is not None, "settled"),
        )
        return next((phase for condition, phase in table if condition), "aligning")

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the state of the alignment, and the source of the heading shown."""
        phase, level = self.status.phase, LEVELS.get(self.status.phase, Level.PLAIN)
        by = "joint fit" if self.status.observable else "none yet"
        if phase == "not observable":
            phase, by = "not observable with this gyro", self.status.substitute[0]
        return {"alignment": LaneState(phase, level), "heading by": LaneState(by)}

    def charts(self) -> Sequence[Chart]:
        """Return sigma against time."""
        if len(self._aligner.state.history) < 2:
            return []
        time_s, _, sd = np.array(self._aligner.state.history).T
        wanted_s = np.array([max(time_s[0], 1.0), max(time_s[-1], 10.0)])
        curves = (
            Curve("σ", time_s, np.degrees(sd), GREEN, width=2.0),
            Curve("wanted", wanted_s, np.full(2, self._parameters.settled_deg), GREY),
        )
        return [
            Chart(
                "alignment_progress", "Alignment", "Sigma of the heading shown",
                Axis("observed time [s]", log=True), Axis("σ [°]", log=True), curves,
                headline=f"{heading_text(self.status)}; {to_go_text(self.status)}",
            )
        ]  # fmt: skip

    def notices(self) -> list[str]:
        """Return, once each, motions and restarts, and conditions that limit the heading."""
        texts, self._aligner.events = self._aligner.events, []
        new = [text for text, true in self._conditions().items() if true and text not in self._reported]
        self._reported.update(new)
        return texts + new

    def _conditions(self) -> dict[str, bool]:
        status, posterior = self.status, self._aligner.state.posterior
        declared = self._parameters.gyro_bias_sd_deg_per_h
        horizontal = self._aligner.earth_horizontal / DEG_PER_H
        limit = math.inf if declared is None else 3.0 * max(declared, 0.01) * DEG_PER_H
        return {
            "alignment: the level changes as the gyros turn: the unit is tilting (a tripod that settles?); "
            "its sigma allows for that": status.tilt_probability > 0.5 and status.observable,
            "heading not observable with this gyro: its bias is not small beside the earth's horizontal "
            f"rate of {horizontal:.1f} °/h; a turn by half a circle, and a rest, separate them; or an axis "
            "is swapped or reversed, or the unit of the gyros or the latitude is wrong": (
                status.phase == "not observable"
            ),
            "alignment: the gyros' turn-on bias is not declared (gyro_bias_sd_deg_per_h), and from one "
            "position it cannot be separated from the earth's rotation: sigma takes it for that of gyros of "
            "such noise, and is too small where it is larger; a turn by half a circle and a rest remove it": (
                status.assumed_bias is not None and status.phase in ("aligning", "settled")
            ),
            "alignment: the rates contradict the declared bias of the gyros, or the latitude is wrong": (
                posterior is not None and posterior.bias_size > limit
            ),
        }
