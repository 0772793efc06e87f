"""The filter VQF (Laidig and Seel, Information Fusion 2023, doi 10.1016/j.inffus.2022.10.014) over samples.

VQF takes samples at a constant rate.  Here the rate is that of the first samples, and each angular rate is
multiplied by its own interval over the usual one, so the angle is right whatever the intervals are.
"""

import copyreg
import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.geodesy import LEAST_HORIZONTAL

FIELD_INTERVALS = 4  # least intervals of the magnetometer for their median: one of them may be long
RATE_SAMPLES = 16
"""Intervals whose median is that of the samples: jitter of a clock averages out, a gap does not count."""
TAU_ACC_S, TAU_MAG_S = 3.0, 9.0
"""VQF's defaults, s: so slowly the vertical follows the accelerometers, and the heading the magnetometer."""
ROW = np.dtype(
    [(name, np.float64, (4,)) for name in ("quat6d", "gyr_quat")]
    + [(name, np.float64) for name in ("low_force", "delta")]
    + [(name, np.int64) for name in ("north", "follows")]
)
"""What VQF makes of a sample; NaN and 0 before it has begun.

quat6d, gyr_quat : quaternions w, x, y, z, from body to level axes without north, and to gyro-carried axes
low_force : magnitude of the low-passed specific force, m/s²
delta : counterclockwise angle from quat6d to the attitude, rad: VQF's by the field, or that to the declared
    heading
north, follows : whether the field has shown north, and whether the heading follows it: VQF rejects a
    disturbed field for some time, and then follows it at half its speed
"""
Rows = npt.NDArray[np.void]


def _restored(intervals_s: Sequence[float], params: dict[str, Any], state: dict[str, Any]) -> VQF:
    vqf = VQF(*intervals_s, **params)
    vqf.state = state
    return vqf


# For pickle and copy: VQF's own `__setstate__` only raises.
copyreg.pickle(
    VQF,
    lambda vqf: (_restored, ([vqf.coeffs[f"{of}Ts"] for of in ("gyr", "acc", "mag")], vqf.params, vqf.state)),
)


def matrices(q: FloatArray) -> FloatArray:
    """Return the matrices, (n, 3, 3), of quaternions w, x, y, z, (n, 4)."""
    w, x, y, z = q.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)


def heading(q: FloatArray) -> FloatArray:
    """Return the heading of the x axis, rad, clockwise from north, 0 to 2π, (n,); where x is vertical, of -z.

    `q` (n, 4) are quaternions w, x, y, z, body to east-north-up.
    """
    body = matrices(q)
    steep = np.hypot(body[:, 0, 0], body[:, 1, 0]) < LEAST_HORIZONTAL
    ahead = np.where(steep[:, None], -body[:, :, 2], body[:, :, 0])
    return np.mod(np.arctan2(ahead[:, 0], ahead[:, 1]), 2.0 * np.pi)


class Fusion:
    """Attitude by VQF, anew after each restart or gap; a relative heading begins at `begins_at`, rad."""

    def __init__(self, begins_at: float) -> None:
        self._begins_at = begins_at
        self.restarts = 0  # how often an attitude has ended, for another to begin
        self._begin()

    def _begin(self) -> None:
        self._first_ns: list[int] = []
        self._samples, self._fields, self._field_rate_known = 0, list[int](), False
        """First times, number of samples, and which of them had a field: both rates are learned of them."""
        self._vqf: VQF | None = None
        self._interval_s = 0.0
        self._bias_known = False
        self._delta = math.nan  # of a relative heading
        self.north = False  # whether the heading refers to the magnetometer
        self.disturbed = False  # whether VQF takes the field for disturbed

    @property
    def begun(self) -> bool:
        """Whether there is an attitude."""
        return not math.isnan(self._delta)

    def process(
        self, begins: BoolArray, bias_known: BoolArray, time_ns: IntArray, *sensors: FloatArray
    ) -> Rows:
        """Return the rows, (n,), of samples; an attitude begins where `begins`.

        The sensors, (n, 3) each, are the turn since the sample before, rad, zero at rest; the specific force,
        m/s², and the magnetic field, any unit, both zero where there is none.  VQF estimates the bias unless
        it is known, and the angles are without it.
        """
        unknown = [math.nan] * 4, [math.nan] * 4, math.nan, math.nan, 0, 0
        rows = np.full(len(time_ns), np.array(unknown, ROW))
        changes = np.flatnonzero(begins | np.diff(bias_known, prepend=False)).tolist()
        for start, stop in pairwise(sorted({0, len(rows), *changes})):
            if begins[start]:
                self.restarts += self.begun
                self._begin()
            while self._vqf is None and start < stop:
                self._learn_rate(int(time_ns[start]), *(values[start] for values in sensors[1:]))
                start += self._vqf is None
            while start < stop:
                end = start + self._learn_field_rate(sensors[2][start:stop])
                self._follow(rows[start:end], bool(bias_known[start]), *(one[start:end] for one in sensors))
                start = end
        return rows

    def _learn_rate(self, time_ns: int, accel: FloatArray, field: FloatArray) -> None:
        """Take the time of a sample, or make the filter, which then gets it, when the interval is known."""
        self._first_ns = [*self._first_ns[-RATE_SAMPLES:], time_ns]
        if self._samples >= RATE_SAMPLES and accel.any():
            self._interval_s = max(float(np.median(np.diff(self._first_ns))), 1.0) * 1e-9
            self._vqf = VQF(self._interval_s, tauAcc=TAU_ACC_S, tauMag=TAU_MAG_S)
            return
        if field.any():
            self._fields = [*self._fields[-RATE_SAMPLES:], self._samples]
        self._samples += 1

    def _learn_field_rate(self, field: FloatArray) -> int:
        """Return how many samples come before the next field; all once enough have shown their interval."""
        if self._field_rate_known:
            return len(field)
        has_field = np.asarray(field.any(axis=1))
        if has_field[0]:
            self._fields = [*self._fields[-RATE_SAMPLES:], self._samples]
        if len(self._fields) > FIELD_INTERVALS:
            assert self._vqf is not None
            field_s = self._interval_s * float(np.median(np.diff(self._fields)))
            intervals_s = self._interval_s, self._interval_s, field_s
            self._vqf = _restored(intervals_s, self._vqf.params, self._vqf.state)
            self._field_rate_known = True
            return len(field)
        n = 1 + int(np.argmax(np.append(has_field[1:], True)))
        self._samples += n
        return n

    def _follow(
        self, rows: Rows, bias_known: bool, angle: FloatArray, accel: FloatArray, field: FloatArray
    ) -> None:
        """Fill in rows, once the rate is known."""
        vqf = self._vqf
        assert vqf is not None
        if bias_known != self._bias_known:
            self._bias_known = bias_known
            vqf.setBiasEstimate(np.zeros(3), math.radians(vqf.params["biasSigmaInit"]))
            vqf.setMotionBiasEstEnabled(not bias_known)
            vqf.setRestBiasEstEnabled(not bias_known)
        found = vqf.updateBatchFullState(angle * (1.0 / self._interval_s), accel, field)
        rows["quat6d"], rows["gyr_quat"] = found["quat6D"], found["gyrQuat"]
        rows["low_force"] = np.sqrt((found["lastAccLp"] ** 2).sum(1))
        if not self.begun:
            self._delta = float(heading(rows["quat6d"][:1])[0]) - self._begins_at
        rows["north"] = self.north | np.logical_or.accumulate(field.any(axis=1))
        rows["delta"] = np.where(rows["north"], found["delta"], self._delta)
        # Before it has taken a field as its reference VQF calls every field disturbed, and follows it.
        disturbed = found["magDistDetected"] & (found["magRefNorm"] > 0.0)
        rows["follows"] = ~disturbed | (found["magRejectT"] > vqf.params["magMaxRejectionTime"])
        self.north, self.disturbed = bool(rows["north"][-1]), bool(disturbed[-1])
