"""Attitude as a stage of the pipeline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.attitude.angles import (
    BEYOND,
    heading,
    level_angles,
    matrix,
    slope,
    turned_clockwise,
)
from imumon.estimation.attitude.fusion import Found, Fusion, Readings
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.uncertainty import (
    CERTAIN,
    GRAVITY_SPREAD,
    LEAST_BIAS,
    SINCE,
    UNKNOWN,
    Errors,
    Motion,
    Slot,
    begin,
)
from imumon.filters.mounting import WAYS, Mounting, are_known, named
from imumon.filters.slots import SlotGatherer, Slots
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.models.magnetometer import MagnetometerModel

SLOT_NS = 1_000_000_000
"""So often it is judged how far the attitude may be off: bias and path grow little in a second."""
GAP_NS = 250_000_000
"""A longer pause hides turns."""
NEAR = 0.2
"""Share by which the field may differ from its calibrated strength and still show how the unit turned."""
Q = tuple(f"attitude_estimate_{part}" for part in "wxyz")
NORTH = "attitude_estimate_north"
_REST = 6
_COLUMNS = 7
"""Of the slots: rate and force, three each, and whether it is at rest."""


@dataclass(slots=True, eq=False)
class _Rows:
    """Rows that have a time and a rate: what goes in, where it begins anew, and what is found for each."""

    readings: Readings
    bias_known: BoolArray
    bias_sd: FloatArray
    begins: set[int]
    slots: Slots
    motion: Motion
    found: Found
    variance: FloatArray


class AttitudeEstimate:
    """Attitude from body axes to east-north-up by VQF, with the bias of the stage before.

    Where ``gyro_bias`` is known the rate is without it, and while the unit is ``at_rest`` it does not turn;
    before, VQF estimates the bias by its own means.  North is that of the magnetometer.  Without one the
    heading begins at `heading_deg` or 0 and is free: its standard deviation is that of its change since then.
    After a restart or a gap it begins there again: it has another reference.

    Parameters
    ----------
    axes : "FRD", "FLU" or None
        Body axes, for roll and pitch; None: whichever stands upright at the beginning.
    magnetometer : MagnetometerModel or None
        Hard and soft iron.
    latitude_deg, heading_deg : float or None
        Of the place, and of the body's x axis at the beginning.
    """

    def __init__(
        self,
        parameters: AttitudeParameters | None = None,
        axes: Literal["FRD", "FLU"] | None = None,
        magnetometer: MagnetometerModel | None = None,
        latitude_deg: float | None = None,
        heading_deg: float | None = None,
    ) -> None:
        self._parameters = parameters or AttitudeParameters()
        self._down = 0.0 if axes is None else (1.0 if axes == "FRD" else -1.0)
        self._magnetometer = magnetometer
        self._errors = Errors(
            self._parameters.accel_bias_m_per_s2,
            self._parameters.gyro_scale,
            0.0 if latitude_deg is None else EARTH_RATE,
            math.nan if magnetometer is None else magnetometer.error_sd,
            math.nan if magnetometer is None else magnetometer.field,
            self._parameters.accel_error_probability,
            self._parameters.axes_error_probability,
            self._parameters.magnet_error_probability,
        )
        self._heading = math.radians(heading_deg or 0.0)
        self._slots = SlotGatherer(_COLUMNS, SLOT_NS, rates=0)
        self._last: tuple[int, int] | None = None
        self._ended_ns = 0
        self._fusion = Fusion()
        self._uncertainty = begin(self._errors)
        self._since = np.zeros(1, SINCE)
        self._field = np.full(3, np.nan)
        self._bias_sd = np.full(3, np.nan)
        self._mounting = Mounting()
        self._field_before = np.full(3, np.nan)
        """Field at the end of the last slot, over its calibrated strength."""
        self._other_axes = 0
        """Which of `WAYS` the magnetometer has, once the gyros have contradicted its axes."""
        self._anew = 0
        """How often an attitude has ended, for another to begin."""
        self._reported = False
        self._names = [column.name for column in self.columns if column.name != NORTH]
        self._said: set[str] = set()

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        angles = {
            "roll": "roll by the estimator",
            "pitch": "pitch by the estimator",
            "tilt_sd": "standard deviation of roll and pitch",
            "heading": "heading of the body x axis, clockwise from magnetic north; free: from where it "
            "begins, or begins anew behind a gap",
            "heading_sd": "its standard deviation; of its change since then where it is free",
        }
        return [
            *(
                Column(name, "1", description=f"attitude by the estimator, body to east-north-up, {name[-1]}")
                for name in Q
            ),
            *(Column(f"attitude_estimate_{name}", "rad", description=text) for name, text in angles.items()),
            Column(NORTH, "1", "int64", "1 where the heading is from magnetic north, 0 where it is free"),
        ]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no attitude, none without gyros or gravity.

        Needs ``device_time_ns`` and ``segment``, gyros and accelerometers; uses ``mag_*``, ``gyro_bias_*``,
        ``gyro_bias_sd_*`` and ``at_rest``.
        """
        gyro, accel = block.gyro, block.accel
        if gyro is None or accel is None:
            return {}
        self._reported |= "q_w" in block or "roll" in block
        n = len(block)
        which = np.flatnonzero((block["device_time_ns"] != NO_INT) & _whole(gyro))
        rows = self._rows(
            block
            if len(which) == n
            else SampleBlock({name: values[which] for name, values in block.columns.items()})
        )
        self._follow(rows)
        q, variance = rows.found.q, rows.variance
        roll, pitch = level_angles(q, self._down)
        variance[1] += slope(q, np.sqrt(variance[0])) ** 2 * variance[0]
        tilt_sd, heading_sd = np.sqrt(np.where(variance < UNKNOWN**2, variance, np.nan))
        values = [*(part.copy() for part in q.T), roll, pitch, tilt_sd, heading(q), heading_sd]
        north = np.where(np.isnan(q[:, 0]), NO_INT, rows.found.north)
        if len(which) < n:
            values = [_spread(part, np.nan, which, n) for part in values]
            north = _spread(north, NO_INT, which, n)
        return {**dict(zip(self._names, values, strict=True)), NORTH: north}

    def _rows(self, block: SampleBlock) -> _Rows:
        """Gather what the filter takes, of rows that it can take."""
        n, gyro, accel, mag = len(block), block.gyro, block.accel, None
        assert gyro is not None
        assert accel is not None
        if self._parameters.use_magnetometer and not self._other_axes:
            mag = block.mag
        if mag is None:
            mag = np.full((n, 3), np.nan)
        elif self._magnetometer is not None:
            mag = self._magnetometer.corrected(mag)
        corrected, bias_sd = block.vector("gyro_corrected"), block.vector("gyro_bias_sd")
        if bias_sd is None:
            bias_sd = np.full((n, 3), np.nan)
        known, rest, rate = np.zeros(n, bool), np.zeros(n, bool), gyro
        if corrected is not None:
            known = _whole(corrected)
            rate = corrected if known.all() else np.where(known[:, np.newaxis], corrected, gyro)
            rest = known & np.asarray(block.columns.get("at_rest", np.zeros(n, np.int64)) == 1)
        values = np.empty((n, _COLUMNS))
        values[:, :3], values[:, 3:6], values[:, _REST] = rate, accel, rest
        time_ns, segment = block["device_time_ns"], block["segment"]
        begins, interval_s = self._intervals(time_ns, segment)
        turned, moving = rate * interval_s[:, np.newaxis], ~rest
        angle = turned * moving[:, np.newaxis]
        motion = Motion(angle, turned - angle, interval_s * moving)
        has_mag = _whole(mag)
        readings = Readings(time_ns, angle, _or_zero(accel), _or_zero(mag), has_mag)
        slots = self._slots.process(time_ns, segment, values)
        found = Found(np.full((n, 4), np.nan), np.full((n, 4), np.nan), np.zeros(n, np.int64))
        return _Rows(readings, known, bias_sd, begins, slots, motion, found, np.empty((2, n)))

    def _follow(self, rows: _Rows) -> None:
        """Run the filter from edge to edge: a slot has ended, it begins anew, the bias is known from here."""
        n, known = len(rows.bias_known), rows.bias_known
        ended = {int(row): k for k, row in enumerate(rows.slots.row)}
        learned = np.flatnonzero(known[1:] != known[:-1]) + 1
        edges = sorted({0, n, *rows.begins, *ended, *learned.tolist()})
        begun = 0
        for start, stop in pairwise(edges):
            if start in ended:
                self._judge(rows, ended[start], start)
                if self._contradicts(rows, ended[start]):
                    self._turn_free(rows, begun, start)
                    self._lose_north(rows, start)
                    begun = start
            if start in rows.begins:
                self._anew += self._fusion.begun
                self._fusion, self._since[:] = Fusion(), 0
                self._uncertainty = self._uncertainty.anew()
            fusion = self._fusion
            fusion.process(rows.readings, start, stop, bool(known[start]), rows.found)
            if self._down == 0.0 and fusion.begun:
                self._down = 1.0 if matrix(fusion.last)[2, 2] < 0.0 else -1.0
            sent = rows.motion, rows.bias_sd, rows.found.levelling
            self._uncertainty.at(self._since, range(start, stop), *sent, rows.variance)
            if stop == n or stop in rows.begins:
                self._turn_free(rows, begun, stop)
                begun = stop
        self._keep_latest(rows, n)

    def _turn_free(self, rows: _Rows, start: int, stop: int) -> None:
        """Let the heading of rows that nothing ties to north begin where it was said."""
        q, free = rows.found.q, np.flatnonzero(rows.found.north[start:stop] == 0) + start
        if len(free) and self._fusion.begun:
            q[free] = turned_clockwise(q[free], self._heading - self._fusion.first_heading)

    def _keep_latest(self, rows: _Rows, stop: int) -> None:
        """Keep the latest reading of the magnetometer before a row, and how well the bias was known there."""
        found = np.flatnonzero(rows.readings.has_mag[:stop])
        if len(found):
            self._field = rows.readings.mag[found[-1]].copy()
        if stop:
            self._bias_sd = rows.bias_sd[stop - 1].copy()

    def _intervals(self, time_ns: IntArray, segment: IntArray) -> tuple[set[int], FloatArray]:
        """Return the rows that begin anew, after a restart or a gap, and the time since the row before, s."""
        if not len(time_ns):
            return set(), np.empty(0)
        last_ns, last_segment = self._last or (int(time_ns[0]), int(segment[0]))
        self._last = int(time_ns[-1]), int(segment[-1])
        interval = np.empty_like(time_ns)
        interval[0], interval[1:] = time_ns[0] - last_ns, time_ns[1:] - time_ns[:-1]
        changed = np.empty(len(segment), bool)
        changed[0], changed[1:] = segment[0] != last_segment, segment[1:] != segment[:-1]
        begins = set(np.flatnonzero(changed | (interval > GAP_NS) | (interval < 0)).tolist())
        return begins, np.asarray(interval * 1e-9, np.float64)

    def _judge(self, rows: _Rows, k: int, row: int) -> None:
        """Say how far the attitude may be off, by a slot that has ended before a row."""
        fusion, slots = self._fusion, rows.slots
        start_ns = int(slots.start_ns[k]) if slots.begins[k] else self._ended_ns
        self._ended_ns = int(slots.end_ns[k])
        ignored = self._since["ignored"][0].copy()
        self._since[:] = 0
        if not fusion.begun:
            return
        self._keep_latest(rows, row)
        self._uncertainty.step(
            Slot(
                seconds=(self._ended_ns - start_ns) * 1e-9,
                rest=bool(slots.smallest[k, _REST] == 1.0),
                turn=slots.turns.at(k),
                force=slots.mean[k, 3:6],
                mag=self._field,
                bias_sd=self._bias_sd,  # the row behind may be of a new segment: nothing is known there
                attitude=matrix(fusion.last),
                levelling=fusion.levelling,
                ignored=ignored,
                to_north=fusion.to_north,
                follows=fusion.follows(),
            )
        )

    def _contradicts(self, rows: _Rows, k: int) -> bool:
        """Compare the field with how the gyros have turned in a slot; tell whether it has other axes by now.

        Where the gyros contradict gravity as well, it is theirs that are wrong.
        """
        if self._magnetometer is None or self._other_axes or not self._fusion.north:
            return False
        slots, before = rows.slots, self._field_before
        self._field_before = after = self._field / self._magnetometer.field
        strengths = np.array([np.linalg.norm(before), np.linalg.norm(after)])
        turn = slots.turns.at(k)
        near = bool((np.abs(strengths - 1.0) < NEAR).all())
        if slots.begins[k] or slots.smallest[k, _REST] == 1.0 or not (near and are_known(turn)):
            return False
        self._mounting.add(before[np.newaxis], after[np.newaxis], turn.rotation[np.newaxis])
        if self._uncertainty.gyros.now.usual >= 1.0 - CERTAIN:
            self._other_axes = self._mounting.found
        return self._other_axes > 0

    def _lose_north(self, rows: _Rows, row: int) -> None:
        """Go on from a row without the magnetometer: the heading is free from there."""
        rows.readings.has_mag[row:] = False
        self._fusion.lose_north()
        self._uncertainty.lose_north()

    def lanes(self) -> Mapping[str, str]:
        """Return what the heading of the estimated attitude refers to."""
        if not self._fusion.begun:
            return {"attitude": "waiting"}
        if not self._fusion.north:
            return {"attitude": "heading free"}
        if self._fusion.disturbed:
            return {"attitude": "disturbed: magnetic field"}
        calibrated = self._magnetometer is not None
        return {"attitude": "magnetic north" if calibrated else "magnetic north, magnetometer not calibrated"}

    def notices(self) -> list[str]:
        """Return, once each, what an attitude lacks and when it began anew, where the device sends none."""
        if self._reported:
            return []
        begun, declared = self._fusion.begun, self._parameters.gyro_scale
        usual, magnitude = self._uncertainty.gyros.now.usual, self._uncertainty.magnitude
        accel_sd = LEAST_BIAS if self._errors.accel is None else self._errors.accel
        reference = math.degrees(self._heading)
        conditions = {
            "attitude: after turns the accelerometers show another vertical than the gyros have carried, "
            f"by more than gyro_scale ({declared:.1%}) allows: are axes, signs and units right?": (
                usual < 1.0 - CERTAIN
            ),
            "attitude: the specific force at rest is not gravity within what accelerometers are off by "
            f"({accel_sd:.2g} m/s²): are its scale and unit right?": (
                abs(magnitude - STANDARD_GRAVITY) > GRAVITY_SPREAD + BEYOND * accel_sd
            ),
            "attitude: without a magnetometer the heading is free; it counts from "
            f"{reference:.0f}° at the beginning": begun and not self._fusion.north and not self._other_axes,
            "attitude: while the unit turns the field goes as if the magnetometer had not the gyros' axes: "
            f"their x, y, z seem to be its {named(WAYS[self._other_axes])}; or the gyros are wrong. "
            "North is not taken from it any more, the heading is free and counts from "
            f"{reference:.0f}° there": bool(self._other_axes),
            "attitude: the magnetometer is not calibrated, so nobody knows how far the heading is off; "
            "record a figure-eight, then: imumon magnetometer SESSION --out MODEL.yaml": (
                self._fusion.north and self._magnetometer is None
            ),
            f"attitude: begun anew, {self._anew} times so far, after a restart or a gap of more than "
            f"{GAP_NS * 1e-9:g} s, in which the unit may have turned"
            + ("" if self._fusion.north else f": the free heading counts from {reference:.0f}° again"): (
                self._anew > 0
            ),
        }
        texts = [text for text, true in conditions.items() if true and text not in self._said]
        self._said.update(texts)
        return texts


def _whole(vectors: FloatArray) -> BoolArray:
    """Return which vectors have all components, (n,)."""
    return np.asarray(np.isfinite(vectors[:, 0] + vectors[:, 1] + vectors[:, 2]))


def _or_zero(vectors: FloatArray) -> FloatArray:
    """Return whole vectors as they are, others as zero: what VQF passes over, (n, 3)."""
    finite = _whole(vectors)
    return vectors if finite.all() else np.where(finite[:, np.newaxis], vectors, 0.0)


def _spread(values: ColumnArray, missing: float, which: IntArray, n: int) -> ColumnArray:
    """Return values of some rows among n, (..., n)."""
    result = np.full((*values.shape[:-1], n), missing, values.dtype)
    result[..., which] = values
    return result
