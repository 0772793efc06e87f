"""Alignment as a stage of the pipeline: the heading of a unit at rest, with its sigma."""

import math
from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import GREEN, GREY, Axis, Chart, Curve
from imumon.columns import BodyAxes, Column
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.filters.turns import STILL
from imumon.geodesy import DEG_PER_H, heading_of
from imumon.lane import LaneState, Level

from .aligner import Aligner
from .parameters import AlignmentParameters
from .position import CALM_SLOTS, SLOT_S, Slot
from .report import Estimate, PositionHeading

LONGEST_GAP_S, LONGEST_MOTION_S = 5.0, 120.0
"""A gap longer than this and than three intervals may hide a turn: it restarts, as a longer motion does."""
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
        axes: BodyAxes | None = None,
        sent: Collection[str] = (),
    ) -> None:
        self._parameters, self._latitude_deg = parameters or AlignmentParameters(), latitude_deg
        self._events: list[str] = []  # motions and restarts so far
        self._aligner = Aligner(self._parameters, latitude_deg, self._events)
        self._earlier: list[PositionHeading] = []  # before the last restart
        self._slots = SlotGatherer(10, round(SLOT_S * 1e9), turns=True)
        self._down = {None: 0.0, "FRD": 1.0, "FLU": -1.0}[axes]
        """Sign of the body z axis: 1 down, -1 up, 0 not known yet."""
        self._prefix = "aligned_" if {"roll", "pitch"} & set(sent) else ""
        self._origin_ns = self._segment = self._run = 0
        """Of the segment: first time, number in the data, and count from 1."""
        self._index = -1  # of the last slot with samples in the segment
        self._step = math.inf  # least number of slots from one with samples to the next
        self._recent: deque[FloatArray] = deque(maxlen=CALM_SLOTS)
        """Specific force, m/s², and magnetic field of the last 2 s, (6,); the mean force is up at rest."""
        self._row: list[float] = []  # values of `columns` after the last slot; empty before the first sample
        self.status = self._aligner.status(0.0)  # state after the last block; may be read by another thread

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        texts = {
            "heading": "heading of the body x axis, clockwise from true north; missing if not observable",
            "heading_sd": "its standard deviation",
            f"{self._prefix}roll": "roll of the alignment",
            f"{self._prefix}pitch": "pitch of the alignment",
            "roll_drift": "change of roll since the first rest",
            "pitch_drift": "change of pitch since the first rest",
            "heading_magnetic": "heading of the body x axis from magnetic north",
            "heading_gyro_mean": "heading by the gyro mean",
            "heading_gyro_mean_sd": "its standard deviation, without sway and tilts",
            "heading_hann_mean": "heading by the hann mean",
            "heading_hann_mean_sd": "its standard deviation, without sway and tilts",
        }
        return [Column(name, "rad", description=text) for name, text in texts.items()]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is nothing yet.

        Needs ``device_time_ns`` and ``segment``, gyros and accelerometers; uses ``at_rest`` and ``mag_*``.
        """
        n = len(block)
        if not self._row:
            self._prefix = "aligned_" if "roll" in block or "pitch" in block else self._prefix
            self._row = [math.nan] * len(self.columns)
        names = [f"{name}_{axis}" for name in ("gyro", "accel", "mag") for axis in "xyz"]
        values = block.stacked([*names, "at_rest"])
        values[:, 9] = values[:, 9] != 0.0  # or unknown
        slots = self._slots.process(block["device_time_ns"], block["segment"], values)
        before, rows = np.array(self._row), np.empty((len(slots), len(self._row)))
        for k in range(len(slots)):
            self._process_slot(slots, k)
            self._row = rows[k] = self._make_row()
        out = held(slots.row, rows, before, n).T
        # The columns of one segment do not hold in a new one.
        other = held(slots.row, slots.segment, np.array(self._segment), n) != block["segment"]
        out[:, other] = np.nan
        if len(slots):
            self._segment = int(slots.segment[-1])
            self.status = self._aligner.status(SLOT_S * (self._index + 1))
        return {column.name: values for column, values in zip(self.columns, out, strict=True)}

    def _process_slot(self, slots: Slots, k: int) -> None:
        """Advance the aligner by slot k, unless a gyro or an accelerometer has no value in it."""
        if slots.begins[k]:
            self._restart(f"the device started anew (segment {slots.segment[k]})")
            self._run += 1
            self._origin_ns, self._index = int(slots.start_ns[k]), -1
        if not slots.count[k, :6].min():
            return
        index = (int(slots.start_ns[k]) - self._origin_ns) // self._slots.length_ns
        missing, end_s = index - self._index - 1, SLOT_S * (self._index + 1)
        self._step = min(self._step, missing + 1 if self._index >= 0 else math.inf)
        if SLOT_S * (missing + 1) > max(LONGEST_GAP_S, 3.0 * SLOT_S * self._step):
            self._restart(f"samples are missing at {end_s:.1f} s for {SLOT_S * missing:.1f} s")
        mean, turn, at_rest = slots.mean[k].copy(), slots.turns[k], bool(slots.smallest[k, -1] > 0.0)
        # A sample of a slow device fills the slots before it, which correlates cells; alone it is no calm.
        first = self._index + 1 if missing <= CALM_SLOTS - 2 else index
        for number in range(first, index + 1):
            self._recent.append(mean[3:9])
            self._aligner.step(Slot(SLOT_S * number, mean[:3], mean[3:6]), at_rest, turn)
            turn = STILL
        self._index, motion = index, self._aligner.motion
        moving_s = SLOT_S * index - motion.begun_s
        if motion.moving and moving_s > LONGEST_MOTION_S:
            # The rates in the first rest may have been a turn.
            self._restart(f"the unit turned at {motion.begun_s:.1f} s for {moving_s:.0f} s")

    def _restart(self, why: str) -> None:
        """Drop all positions, and report the reason."""
        if self._aligner.positions:
            self._earlier = self.finish()
            self._events.append(f"alignment: {why}: the alignment starts anew")
        self._aligner = Aligner(self._parameters, self._latitude_deg, self._events)

    def finish(self) -> list[PositionHeading]:
        """Fit the rest since the last fit; return the heading in each position."""
        return self._earlier + self._aligner.headings(self._run)

    def _make_row(self) -> list[float]:
        """Return the values of `columns`, NaN where unknown."""
        aligner = self._aligner
        if not aligner.positions:
            return [math.nan] * len(self._row)
        estimates = aligner.estimates
        joint, gyro, hann = (estimates.get(of, Estimate()) for of in ("joint", "gyro_mean", "hann_mean"))
        recent, up = np.array(self._recent), aligner.attitude[2]
        field = recent[np.isfinite(recent).all(axis=1), 3:].sum(axis=0)  # of whole readings
        magnetic = heading_of(up, field) % math.tau if field.any() else math.nan
        angles = self._roll_and_pitch(up if aligner.motion.moving else recent[:, :3].sum(axis=0))
        first = self._roll_and_pitch(aligner.positions[0].attitude[2])
        drifts = [math.remainder(now - then, math.tau) for now, then in zip(angles, first, strict=True)]
        return [*joint, *angles, *drifts, magnetic, *gyro, *hann]

    def _roll_and_pitch(self, up: FloatArray) -> tuple[float, float]:
        """Return roll and pitch, rad, ZYX, from a vertical in body axes, (3,)."""
        if not self._down:
            self._down = 1.0 if up[2] < 0.0 else -1.0
        x, y, z = (-self._down * up).tolist()
        return math.atan2(y, z), -math.atan2(x, math.hypot(y, z))

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the state of the alignment, and the source of the heading shown."""
        phase, by = self.status.phase, "joint fit" if self.status.observable else "none yet"
        return {"alignment": LaneState(phase, LEVELS.get(phase, Level.PLAIN)), "heading by": LaneState(by)}

    def charts(self) -> Sequence[Chart]:
        """Return sigma against time."""
        if len(self._aligner.history) < 2:
            return []
        rest_s, _, sd = np.array(self._aligner.history).T
        wanted = Curve("wanted", rest_s[[0, -1]], np.full(2, self._parameters.settled_deg), GREY)
        return [
            Chart(
                "alignment_progress",
                "Alignment",
                "Sigma of the heading",
                Axis("time at rest [s]", log=True),
                Axis("σ [°]", log=True),
                (Curve("σ", rest_s, np.degrees(sd), GREEN, width=2.0), wanted),
                headline=f"{self.status.heading_text}; {self.status.to_go_text}",
            )
        ]

    def notices(self) -> list[str]:
        """Return motions and restarts so far, and conditions that limit the heading."""
        return [*self._events, *self._conditions()]

    def _conditions(self) -> Iterator[str]:
        status, posterior = self.status, self._aligner.posterior
        declared = self._parameters.gyro_bias_sd_deg_per_h is not None
        horizontal = self._aligner.earth_horizontal / DEG_PER_H
        if status.phase == "not observable":
            yield (
                "heading not observable: the gyros' bias is not small beside the earth's horizontal rate of "
                f"{horizontal:.1f} °/h, or the unit sways, tilts or creeps; half a turn separates the bias"
            )
        if not declared and status.positions == 1 and status.phase in ("aligning", "settled"):
            yield (
                "alignment: the gyros' turn-on bias is not declared (gyro_bias_sd_deg_per_h); sigma takes it "
                f"for that of gyros of such noise: {math.radians(horizontal):.2g} °/h of the gyro that "
                "points east turn the heading by 1°; a turn by half a circle and a rest remove it"
            )
        if declared and posterior is not None and posterior.worse > 0.5:
            yield "alignment: the rates contradict the declared bias of the gyros, or the latitude is wrong"
