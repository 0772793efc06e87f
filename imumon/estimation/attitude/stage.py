"""Attitude as a stage of the pipeline."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, FloatArray, SampleBlock, missing
from imumon.columns import BodyAxes, Column, vector_columns
from imumon.filters.slots import SlotGatherer, Slots, held
from imumon.geodesy import EARTH_RATE, LEAST_HORIZONTAL
from imumon.lane import LaneState, Level
from imumon.models.model import MagnetometerModel

from .fusion import Fusion, Rows, heading, matrices
from .parameters import AttitudeParameters
from .sigma import SLOT_S, Accelerometers, Gyros, HeadingSigma, Slot, TiltSigma

GAP_NS = 250_000_000  # a longer pause hides turns: in it a hand turns by a radian
ANGLES = {
    "roll": "estimated roll",
    "pitch": "estimated pitch",
    "tilt_sd": "standard deviation of pitch; that of roll is this over cos(pitch)",
    "heading": "of the body x axis, clockwise from magnetic north; relative: from where it begins",
    "heading_sd": "its standard deviation; where it is relative, of its change since the gyro bias is known",
}


class AttitudeEstimate:
    """Attitude from body axes to east-north-up by VQF, with the bias of the stage before.

    Where ``gyro_bias`` is known the rate is without it, and while the unit is ``at_rest`` it does not turn;
    before, VQF estimates the bias by its own means.  North is that of the magnetometer.  Without one the
    heading is relative: it begins at `heading_deg` or 0, after a restart or a gap again, and its standard
    deviation is that of its change since the gyro bias is known.

    Roll and pitch are of the body's `axes`; None is whichever of FRD and FLU stands upright at the beginning.
    """

    columns: Sequence[Column] = (
        *vector_columns("attitude_estimate", "1", "attitude, body to east-north-up", "wxyz"),
        *(Column(f"attitude_estimate_{of}", "rad", description=text) for of, text in ANGLES.items()),
        Column(
            "attitude_estimate_north", "1", "int64", "1: heading from magnetic north, 0: relative heading"
        ),
    )

    def __init__(
        self,
        parameters: AttitudeParameters | None = None,
        axes: BodyAxes | None = None,
        magnetometer: MagnetometerModel | None = None,
        latitude_deg: float | None = None,
        heading_deg: float | None = None,
    ) -> None:
        self._parameters = given = parameters or AttitudeParameters()
        self._down = {None: 0.0, "FRD": 1.0, "FLU": -1.0}[axes]
        """Sign of the body z axis: 1 down, -1 up, 0 not known yet."""
        self._magnetometer = magnetometer
        self._heading = math.radians(heading_deg or 0.0)
        self._slots = SlotGatherer(11, int(SLOT_S * 1e9), turns=True)
        self._accelerometers, self._gyros = Accelerometers(given.accel_bias_m_per_s2), Gyros(given.gyro_scale)
        # With a latitude the earth rate stays in the corrected rate: its vertical part turns the heading.
        # Without one it is in the bias, whose standard deviation covers what a turn changes of it.
        self._earth_rate = EARTH_RATE * abs(math.sin(math.radians(latitude_deg or 0.0)))
        self._fusion = Fusion(self._heading)
        self._path = np.zeros(3)  # sum of the angles of all samples, rad
        self._shown = np.array([math.nan, math.nan, 0.0, 0.0, 0.0, 0.0])
        """Of the latest slot: variances of tilt and heading, rad², and of a turn per rad²; path."""
        self._last_time: tuple[int, int] | None = None  # ns, and segment of the last sample
        self._attitudes = self._silent = 0  # times that one began anew; slots without force, in a row
        self._device_has_attitude = False

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no attitude, none without gyros or gravity.

        Needs ``device_time_ns`` and ``segment``, gyros and accelerometers; uses ``mag_*``,
        ``gyro_corrected_*``, ``gyro_bias_sd_*`` and, while the bias is known, ``at_rest``.
        """
        gyro = block.gyro
        if gyro is None or block.accel is None:
            return {}
        self._device_has_attitude |= "q_w" in block or "roll" in block
        found = {column.name: missing(len(block), column.dtype) for column in self.columns}
        usable = np.flatnonzero((block["device_time_ns"] != NO_INT) & np.isfinite(gyro).all(axis=1))
        if len(usable):
            estimates = self._estimate(block if len(usable) == len(block) else block.kept(usable))
            for values, each in zip(found.values(), estimates, strict=True):
                values[usable] = each
        return found

    def _estimate(self, block: SampleBlock) -> list[ColumnArray]:
        """Return the columns of samples with a time and a rate."""
        time_ns, rate = block["device_time_ns"], np.asarray(block.gyro)
        corrected, bias_sd, field = (
            block.stacked([f"{name}_{axis}" for axis in "xyz"])
            for name in ("gyro_corrected", "gyro_bias_sd", "mag")
        )
        known = np.asarray(np.isfinite(corrected).all(axis=1))
        rest = known & (block["at_rest"] == 1 if "at_rest" in block else False)
        rate = np.where(known[:, None], corrected, rate) * ~rest[:, None]
        last_ns, last_segment = self._last_time or (time_ns[0], block["segment"][0])
        self._last_time = time_ns[-1], block["segment"][-1]
        interval_ns = np.diff(time_ns, prepend=last_ns)
        begins = np.diff(block["segment"], prepend=last_segment) != 0
        begins |= (interval_ns > GAP_NS) | (interval_ns < 0)
        attitude = self._attitudes + np.cumsum(begins)
        self._attitudes = int(attitude[-1])
        if not self._parameters.use_magnetometer:
            field[:] = math.nan
        if self._magnetometer is not None:
            field = self._magnetometer.corrected(field)
        angle = 1e-9 * interval_ns[:, None] * rate
        force = np.asarray(block.accel)
        sensors = angle, _complete(force), _complete(field)
        rows = self._fusion.process(begins, known, time_ns, *sensors)
        path = np.cumsum(np.vstack([self._path, angle]), axis=0)[1:]
        values = np.column_stack([rate, bias_sd, field, rest, force.sum(1)])
        slots = self._slots.process(time_ns, attitude, values)
        ended = [[*self._end_slot(rows[row], slots, k), *path[row]] for k, row in enumerate(slots.row)]
        shown = held(slots.row, np.reshape(ended, (-1, 6)), self._shown, len(rows))
        self._path, self._shown = path[-1], shown[-1]
        return self._output(rows, angle, path, shown)

    def _end_slot(self, end: Any, slots: Slots, k: int) -> tuple[float, float, float]:
        """Return the variances of tilt and heading, rad², and of a turn over its square, behind slot k.

        `end` is the first row behind the slot; NaN where an attitude begins with it, or nothing is known.
        """
        self._silent = 0 if slots.count[k, 10] else self._silent + 1
        silent = self._silent > 2  # accelerometers may be as slow as 1 Hz
        if slots.begins[k] or silent:  # what is known of the sensors stays
            self._tilt_sigma = TiltSigma(self._accelerometers, self._gyros)
        if slots.begins[k]:
            self._heading_sigma = HeadingSigma(self._gyros, self._magnetometer, self._earth_rate)
        turn, bias_sd = slots.turns[k], slots.last[k, 3:6]
        if not end["low_force"] > 0.0:
            return math.nan, math.nan, 0.0
        body, carried = matrices(np.array([end["quat6d"], end["gyr_quat"]]))
        slot = Slot(
            end,
            rest=bool(slots.smallest[k, 9] == 1.0),
            up=carried @ body[2],
            up_body=body[2],
            wrong_turns=carried @ turn.rotation.T @ turn.by_scale.reshape(3, 9),
            missed=turn.missed,
            bias_sd=float(np.linalg.norm(body[2] * bias_sd)),
            field=slots.last[k, 6:9],
        )
        tilt = math.nan if silent else self._tilt_sigma.step(slot)
        per_turn = self._gyros.error_variance(np.eye(1, 9)[0])  # about the axis of one gyro
        return tilt, self._heading_sigma.step(slot, tilt), per_turn

    def _output(
        self, rows: Rows, angle: FloatArray, path: FloatArray, shown: FloatArray
    ) -> list[ColumnArray]:
        """Return the columns of rows, (n,) each; `shown` (n, 6) is of the latest slot."""
        c, s = np.cos(0.5 * rows["delta"]), np.sin(0.5 * rows["delta"])
        w, x, y, z = rows["quat6d"].T
        q = np.column_stack([c * w - s * z, c * x - s * y, c * y + s * x, c * z + s * w])
        up = matrices(q)[:, 2]
        # What was turned wrong since the latest slot, and an angle uniform within half an interval: a rate
        # may be the mean of the interval before or that of the moment.
        since = ((path - shown[:, 3:]) ** 2).sum(1) * shown[:, 2] + (angle**2).sum(1) / 12.0
        tilt = shown[:, 0] + since
        variances = np.array([tilt, shown[:, 1] + since + tilt_into_heading(up, tilt)])
        # More than a radian is no small angle, and its standard deviation means nothing.
        tilt_sd, heading_sd = np.sqrt(np.where(variances < 1.0, variances, math.nan))
        known = np.isfinite(up[:, 2])
        if self._down == 0.0 and known.any():
            self._down = 1.0 if up[known, 2][0] < 0.0 else -1.0
        # The third axis of the level frame that the body axes are like, in body axes.
        along, across, third = -self._down * up.T
        roll, pitch = np.arctan2(across, third), -np.arcsin(np.clip(along, -1.0, 1.0))
        north = np.where(known, rows["north"], NO_INT)
        return [*q.T, roll, pitch, tilt_sd, heading(q), heading_sd, north]

    def lanes(self) -> Mapping[str, LaneState]:
        """Return what the heading of the estimated attitude refers to."""
        table = (
            (not self._fusion.begun, LaneState("waiting", Level.WAIT)),
            (not self._fusion.north, LaneState("relative heading")),
            (self._fusion.disturbed, LaneState("disturbed: magnetic field", Level.BAD)),
            (self._magnetometer is None, LaneState("magnetic north, magnetometer not calibrated")),
            (True, LaneState("magnetic north")),
        )
        return {"attitude": next(state for holds, state in table if holds)}

    def notices(self) -> list[str]:
        """Return what an attitude lacks and its reinitializations, where the device sends none."""
        return [] if self._device_has_attitude else [f"attitude: {text}" for text in self._conditions()]

    def _conditions(self) -> Iterator[str]:
        north, restarts = self._fusion.north, self._fusion.restarts
        reference = f"counts from {math.degrees(self._heading):.0f}°"
        if self._gyros.contradicted:
            yield (
                "gyros and accelerometers disagree about turns, so the heading is as uncertain as these: are "
                "axes, signs and units right? Accelerations for many seconds, as in a car, look the same"
            )
        if self._fusion.begun and not north:
            yield f"without a magnetometer the heading is relative; it {reference} at the beginning"
        if north and self._magnetometer is None:
            yield (
                "the magnetometer is not calibrated, so it is not known how far the heading is off; record a "
                "figure-eight, then: imumon magnetometer SESSION --out MODEL.yaml"
            )
        if restarts:
            again = "" if north else f": the relative heading {reference} again"
            yield (
                f"reinitialized, {restarts} times so far, after a restart or a gap of more than "
                f"{GAP_NS * 1e-9:g} s, in which the unit may have turned{again}"
            )


def tilt_into_heading(up: FloatArray, tilt_variance: FloatArray) -> FloatArray:
    """Return the variance of `heading` by that of the tilt, rad², (n,): times the slope of its axis, squared.

    It is infinite where the tilt leaves open, to three sigma, which axis that is.  `up` (n, 3): body axes.
    """
    level = np.hypot(up[:, 1], up[:, 2])
    rise2 = np.where(level < LEAST_HORIZONTAL, up[:, 2], up[:, 0]) ** 2
    slope2 = rise2 / np.maximum(1.0 - rise2, LEAST_HORIZONTAL**2)
    is_open = np.abs(level - LEAST_HORIZONTAL) < 3.0 * np.sqrt(tilt_variance)
    return np.where(is_open, np.inf, slope2 * tilt_variance)


def _complete(vectors: FloatArray) -> FloatArray:
    """Return vectors, (n, 3), zero where a component is missing: for VQF there is no reading then."""
    return np.where(np.isfinite(vectors).all(axis=1, keepdims=True), vectors, 0.0)
