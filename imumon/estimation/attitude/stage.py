"""Attitude as a stage of the pipeline."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
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
    turned_about_up,
    up_of,
)
from imumon.estimation.attitude.fusion import ROW, Fusion, Rows
from imumon.estimation.attitude.heading_sigma import HeadingSigma
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.tilt_sigma import (
    ACCEL_SD,
    SLOT_S,
    WRONG_AXES,
    Accelerometers,
    Gyros,
    Slot,
    TiltSigma,
)
from imumon.filters.mounting import WAYS, Mounting, are_known, named
from imumon.filters.slots import SlotGatherer, Slots
from imumon.geodesy import EARTH_RATE, STANDARD_GRAVITY
from imumon.models.magnetometer import MagnetometerModel

GAP_NS = 250_000_000
"""A longer pause hides turns."""
NEAR = 0.2
"""Share by which the field may differ from its calibrated strength and still show how the unit turned."""
GRAVITY_SPREAD = 0.03
"""m/s²: between equator and poles gravity differs by no more from the standard (WGS-84: 9.780 to 9.832)."""
UNKNOWN = 1.0
"""rad: a larger error is no small angle, and its standard deviation means nothing."""
NAMES = [
    f"attitude_estimate_{name}" for name in (*"wxyz", "roll", "pitch", "tilt_sd", "heading", "heading_sd")
]
NORTH = "attitude_estimate_north"
_REST, _COLUMNS = 6, 7
"""Of the slots: rate and force, three each, and whether it is at rest."""
_KNOWN = np.dtype(
    [("tilt", np.float64), ("heading", np.float64), ("scale", np.float64)]
    + [(name, np.float64, (3,)) for name in ("path", "ignored", "up", "unconfirmed")]
)
"""Variances at the end of a slot, rad², that of the gyros' scale; path and ignored (`ROW`), u, and which
gyros are not confirmed."""


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
        self._parameters = given = parameters or AttitudeParameters()
        self._down = 0.0 if axes is None else (1.0 if axes == "FRD" else -1.0)
        self._magnetometer = magnetometer
        self._heading = math.radians(heading_deg or 0.0)
        self._slots = SlotGatherer(_COLUMNS, int(SLOT_S * 1e9), rates=0)
        self._fusion = Fusion(self._heading)
        self._tilt = TiltSigma(Accelerometers(given.accel_bias_m_per_s2), Gyros(given.gyro_scale))
        earth_rate = 0.0 if latitude_deg is None else EARTH_RATE
        self._turn = HeadingSigma(self._tilt.gyros, magnetometer, earth_rate)
        self._last = np.zeros(1, ROW)
        self._last["field"] = math.nan
        self._last_time: tuple[int, int] | None = None
        self._known = np.full(1, math.nan, _KNOWN)
        self._ignored = np.zeros(3)
        """Turned in the last slot while it was taken for at rest, rad."""
        self._mounting = Mounting()
        self._field_before = np.full(3, math.nan)
        """Field at the end of the last slot, over its calibrated strength."""
        self._other_axes = 0
        """Which of `WAYS` the magnetometer has, once the gyros have contradicted its axes."""
        self._force = math.nan
        """Magnitude of the specific force at the last rest, m/s²."""
        self._anew = 0
        """How often an attitude has ended, for another to begin."""
        self._sent = False
        """Whether the device sends an attitude."""
        self._named: set[str] = set()

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
                for name in NAMES[:4]
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
        self._sent |= "q_w" in block or "roll" in block
        n = len(block)
        which = np.flatnonzero((block["device_time_ns"] != NO_INT) & _whole(gyro))
        if len(which) < n:
            block = SampleBlock({name: values[which] for name, values in block.columns.items()})
        values, north = self._angles(*self._follow(block))
        if len(which) < n:
            values = [_spread(part, math.nan, which, n) for part in values]
            north = _spread(north, NO_INT, which, n)
        return {**dict(zip(NAMES, values, strict=True)), NORTH: north}

    def _rows(self, block: SampleBlock) -> tuple[Rows, BoolArray, BoolArray, Slots, list[int]]:
        """Gather what the filter and the sigmas take.

        Returns the samples as `ROW`, (n + 1,), behind the last one of the block before; whether each has a
        field and a known bias, (n,); the slots that end; and the rows that begin anew.
        """
        n, gyro, accel, mag = len(block), block.gyro, block.accel, block.mag
        assert gyro is not None
        assert accel is not None
        rows = np.zeros(n + 1, ROW)
        rows[0], sent = self._last[0], rows[1:]
        begins, interval_s = self._intervals(block["device_time_ns"], block["segment"])
        corrected, bias_sd = block.vector("gyro_corrected"), block.vector("gyro_bias_sd")
        known = np.zeros(n, bool) if corrected is None else _whole(corrected)
        rate = gyro if corrected is None else np.where(known[:, np.newaxis], corrected, gyro)
        rest = known & np.asarray(block.columns.get("at_rest", np.zeros(n, np.int64)) == 1)
        slots = self._slots.process(
            block["device_time_ns"], block["segment"], np.column_stack([rate, accel, rest])
        )
        turned = rate * interval_s[:, np.newaxis]
        sent["angle"] = np.where(rest[:, np.newaxis], 0.0, turned)
        sent["path"], sent["ignored"] = sent["angle"], turned - sent["angle"]
        for name in ("path", "ignored"):  # running sums, the same whatever the blocks
            rows[name] = np.cumsum(rows[name], axis=0)
        sent["accel"] = np.where(_whole(accel)[:, np.newaxis], accel, 0.0)
        sent["bias_sd"] = math.nan if bias_sd is None else bias_sd
        has_mag = np.zeros(n, bool)
        if mag is not None and self._parameters.use_magnetometer and not self._other_axes:
            field = mag if self._magnetometer is None else self._magnetometer.corrected(mag)
            has_mag = _whole(field)
            sent["mag"] = np.where(has_mag[:, np.newaxis], field, 0.0)
            latest = np.maximum.accumulate(np.where(has_mag, np.arange(1, n + 1), 0))
            sent["field"] = np.where((latest > 0)[:, np.newaxis], rows["mag"][latest], rows["field"][0])
        else:
            sent["field"] = rows["field"][0]
        for name in ("q", "levelling", "carried", "low_force"):
            sent[name] = math.nan
        return rows, has_mag, known, slots, begins

    def _follow(self, block: SampleBlock) -> tuple[Rows, Rows]:
        """Run the filter over a block; return its rows, `ROW`, and what was known at each, `_KNOWN`, (n,)."""
        rows, has_mag, bias_known, slots, begins = self._rows(block)
        time_ns, n = block["device_time_ns"], len(block)
        learned = np.flatnonzero(bias_known[1:] != bias_known[:-1]) + 1
        edges = sorted({0, n, *begins, *learned.tolist()})
        # A slot ends before the row behind it, which may begin anew.
        ended = [0, *np.searchsorted(slots.row, edges, side="right").tolist()]
        known: list[tuple[int, Rows]] = [(0, self._known)]
        for j, start in enumerate(edges):
            for k in range(ended[j], ended[j + 1]):
                known.append((int(slots.row[k]), self._end_slot(rows, has_mag, slots, k)))
            if start == n:
                break
            if start in begins:
                self._begin_anew()
                known.append((start, self._known))
            part = slice(start, edges[j + 1])
            self._fusion.process(rows[1:][part], time_ns[part], has_mag[part], bool(bias_known[start]))
        self._last = rows[-1:].copy()
        at = np.array([row for row, _ in known] + [n])
        return rows[1:], np.repeat(np.concatenate([each for _, each in known]), np.diff(at))

    def _begin_anew(self) -> None:
        self._anew += self._fusion.begun
        self._fusion = Fusion(self._heading)
        self._tilt, self._turn = self._tilt.begin_anew(), self._turn.begin_anew()
        self._known, self._ignored = np.full(1, math.nan, _KNOWN), np.zeros(3)

    def _intervals(self, time_ns: IntArray, segment: IntArray) -> tuple[list[int], FloatArray]:
        """Return the rows that begin anew, after a restart or a gap, and the time since the row before, s."""
        if not len(time_ns):
            return [], np.empty(0)
        last_ns, last_segment = self._last_time or (int(time_ns[0]), int(segment[0]))
        self._last_time = int(time_ns[-1]), int(segment[-1])
        interval = np.diff(time_ns, prepend=last_ns)
        changed = np.diff(segment, prepend=last_segment) != 0
        begins = np.flatnonzero(changed | (interval > GAP_NS) | (interval < 0))
        return begins.tolist(), np.asarray(interval * 1e-9)

    def _end_slot(self, rows: Rows, has_mag: BoolArray, slots: Slots, k: int) -> Rows:
        """Estimate how far the attitude is off at the end of a slot: `_KNOWN`, (1,)."""
        row, end = int(slots.row[k]), rows[slots.row[k]]
        if not self._fusion.begun or np.isnan(end["q"][0]):
            return self._known
        slot = self._slot(end, slots, k)
        tilt = self._tilt.step(slot)
        turn = self._turn.step(slot, tilt)
        if slot.north and self._contradicts(slot.mag, slots, k):
            self._fusion.lose_north(rows, row + 1)
            has_mag[row:] = False
            self._turn = self._turn.begin_anew()
            turn = math.nan
        gyros = self._tilt.gyros
        if gyros.contradicted or (self._other_axes and not gyros.confirmed.all()):
            turn = math.nan  # gyros or magnetometer: nobody knows which is wrong
        self._known = np.zeros(1, _KNOWN)
        self._known[0] = (
            tilt, turn, gyros.variance, end["path"], end["ignored"], slot.up, ~gyros.confirmed
        )  # fmt: skip
        return self._known

    def _slot(self, end: Rows, slots: Slots, k: int) -> Slot:
        """Return a slot for the sigmas, from its last row."""
        turns, carried = slots.turns, matrix(end["carried"])
        force = carried @ slots.mean[k, 3:6]
        rest = bool(slots.smallest[k, _REST] == 1.0 and force @ force > 0.0)
        ignored = end["ignored"] - self._known["ignored"][0]
        if math.isnan(ignored[0]):
            ignored = np.zeros(3)  # the first slot
        since, self._ignored = self._ignored + ignored, ignored if rest else np.zeros(3)
        if rest:
            self._force = float(np.linalg.norm(force))
        up_body = matrix(end["q"])[2]
        return Slot(
            rest=rest,
            up=matrix(end["levelling"])[2],
            up_body=up_body,
            force=force,
            low_force=float(end["low_force"]) or math.nan,
            turn=carried @ turns.rotation[k].T @ turns.by_scale[k].reshape(3, 9),
            lost=float(turns.fast[k] ** 2 + turns.missed[k] + turns.coning[k] @ turns.coning[k] / 3.0),
            ignored=float(since @ since),
            bias_sd=float(np.linalg.norm(up_body * end["bias_sd"])),
            north=bool(end["north"]),
            mag=end["field"].copy(),
            delta=float(end["delta"]),
            follows=float(end["follows"]),
        )

    def _contradicts(self, mag: FloatArray, slots: Slots, k: int) -> bool:
        """Compare the field with how the gyros have turned in a slot; return whether it has other axes.

        Where the gyros contradict gravity as well, it is theirs that are wrong.
        """
        if self._magnetometer is None:
            return False
        before, self._field_before = self._field_before, mag / self._magnetometer.field
        strengths = np.array([np.linalg.norm(before), np.linalg.norm(self._field_before)])
        near = bool((np.abs(strengths - 1.0) < NEAR).all())
        if slots.begins[k] or slots.smallest[k, _REST] == 1.0 or not (near and are_known(slots.turns.at(k))):
            return False
        self._mounting.add(
            before[np.newaxis], self._field_before[np.newaxis], slots.turns.rotation[k : k + 1]
        )
        if not self._tilt.gyros.contradicted:
            self._other_axes = self._mounting.found
        return self._other_axes > 0

    def _angles(self, rows: Rows, known: Rows) -> tuple[list[FloatArray], IntArray]:
        """Return quaternion, roll, pitch, tilt sigma, heading and its sigma of rows, (n,) each, and north."""
        q = turned_about_up(rows["q"], np.where(rows["north"] == 1, rows["delta"], -rows["free"]))
        # What was turned wrong since the last slot, and half an interval: a rate may be the mean of the
        # interval before or that of the moment.
        turned2 = (rows["path"] - known["path"]) ** 2
        late = known["scale"] * turned2.sum(1) + ((rows["ignored"] - known["ignored"]) ** 2).sum(1)
        late += (rows["angle"] ** 2).sum(1) / 12.0
        moved2 = ((up_of(rows["levelling"]) - known["up"]) ** 2).sum(1)
        wrong = WRONG_AXES * (turned2 * known["unconfirmed"]).sum(1)
        tilt = known["tilt"] + late + 0.5 * wrong + 0.5 * moved2
        turn = known["heading"] + late + wrong + slope(q, np.sqrt(tilt)) ** 2 * tilt
        tilt_sd, heading_sd = (np.sqrt(np.where(each < UNKNOWN**2, each, math.nan)) for each in (tilt, turn))
        if self._down == 0.0 and np.isfinite(q[:, 0]).any():
            first = int(np.argmax(np.isfinite(q[:, 0])))
            self._down = 1.0 if up_of(q[first : first + 1])[0, 2] < 0.0 else -1.0
        roll, pitch = level_angles(q, self._down)
        north = np.where(np.isnan(q[:, 0]), NO_INT, rows["north"])
        return [*(part.copy() for part in q.T), roll, pitch, tilt_sd, heading(q), heading_sd], north

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
        retired = self._parameters.retired
        conditions = dict.fromkeys((f"attitude: {name} is not used any more" for name in retired), True)
        if not self._sent:
            conditions |= self._conditions()
        texts = [text for text, true in conditions.items() if true and text not in self._named]
        self._named.update(texts)
        return texts

    def _conditions(self) -> dict[str, bool]:
        """Return the texts of `notices`, and whether each applies."""
        north, begun = self._fusion.north, self._fusion.begun
        declared = self._parameters.accel_bias_m_per_s2
        accel_sd = ACCEL_SD if declared is None else declared
        reference, gyros = math.degrees(self._heading), self._tilt.gyros
        return {
            "attitude: in turns the accelerometers show another vertical than the gyros carry, so the "
            "heading has no standard deviation: are axes, signs and units right? Accelerations that last for "
            "many seconds, as in a car, show the same": gyros.contradicted,
            "attitude: the specific force at rest is not gravity within what accelerometers are off by "
            f"({accel_sd:.2g} m/s²): are its scale and unit right?": (
                abs(self._force - STANDARD_GRAVITY) > GRAVITY_SPREAD + BEYOND * accel_sd
            ),
            "attitude: without a magnetometer the heading is free; it counts from "
            f"{reference:.0f}° at the beginning": begun and not north and not self._other_axes,
            "attitude: while the unit turns the field goes as if the magnetometer had not the gyros' axes: "
            f"their x, y, z seem to be its {named(WAYS[self._other_axes])}; or the gyros are wrong. "
            "North is not taken from it any more, the heading is free and counts from "
            f"{reference:.0f}° there": bool(self._other_axes),
            "attitude: the magnetometer is not calibrated, so nobody knows how far the heading is off; "
            "record a figure-eight, then: imumon magnetometer SESSION --out MODEL.yaml": (
                north and self._magnetometer is None
            ),
            f"attitude: begun anew, {self._anew} times so far, after a restart or a gap of more than "
            f"{GAP_NS * 1e-9:g} s, in which the unit may have turned"
            + ("" if north else f": the free heading counts from {reference:.0f}° again"): self._anew > 0,
        }


def _whole(vectors: FloatArray) -> BoolArray:
    """Return which vectors have all components, (n,)."""
    return np.asarray(np.isfinite(vectors[:, 0] + vectors[:, 1] + vectors[:, 2]))


def _spread(values: ColumnArray, missing: float, which: IntArray, n: int) -> ColumnArray:
    """Return values of some rows among n, (n,)."""
    result = np.full(n, missing, values.dtype)
    result[which] = values
    return result
