"""The filter VQF (Laidig and Seel, Information Fusion 2023, doi 10.1016/j.inffus.2022.10.014) over samples.

VQF takes samples at a constant rate.  Here the rate is that of the first samples, and each angular rate is
multiplied by its own interval over the usual one, so the angle is right whatever the intervals are.
"""

from __future__ import annotations

import copyreg
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.geodesy import LEAST_HORIZONTAL

RATE_SAMPLES = 16
"""Intervals whose median is taken for that of the samples: jitter of a clock averages out, a gap does not
count, and at 50 Hz the attitude begins after 0.3 s."""
TAU_ACC_S, TAU_MAG_S = 3.0, 9.0
"""VQF's defaults, s: so slowly the vertical follows the accelerometers, and the heading the magnetometer."""
ROW = np.dtype(
    [(name, np.float64, (3,)) for name in ("angle", "path", "field", "slot_path")]
    + [(name, np.float64, (4,)) for name in ("quat6d", "acc_quat", "gyr_quat")]
    + [(name, np.float64) for name in ("low_force", "delta", "tilt", "heading", "gyros")]
    + [(name, np.int64) for name in ("north", "follows")]
)
"""A sample and what is made of it; NaN before the filter has begun.

angle : turn since the sample before, rad, zero at rest
path : running sum of the angles, rad
field : latest magnetic field, any unit; NaN before the first
quat6d, acc_quat, gyr_quat : VQF's quaternions w, x, y, z, from body to level axes without north; from
    gyro-carried to level; from body to gyro-carried
low_force : magnitude of the low-passed specific force, m/s²
delta : counterclockwise angle from quat6d to the attitude, rad: VQF's by the field, or that to the declared
    heading
north, follows : whether the field has shown north, and whether the heading follows it: VQF rejects a
    disturbed field for some time
tilt, heading, gyros, slot_path : at the end of the latest slot the variances of both, rad²,
    `sigma.Gyros.turn_variance`, and the path
"""
Rows = npt.NDArray[np.void]
BEFORE_FIRST: Rows = np.zeros(1, ROW)
"""What holds before the first sample."""
for _name in ("field", "tilt", "heading"):
    BEFORE_FIRST[_name] = math.nan


def _restored(intervals_s: Sequence[float], params: dict[str, Any], state: dict[str, Any]) -> VQF:
    vqf = VQF(*intervals_s, **params)
    vqf.state = state
    return vqf


def _reduced(vqf: VQF) -> tuple[Any, ...]:
    """Return what `_restored` needs, for pickle and copy: VQF's own `__setstate__` only raises."""
    return _restored, ([vqf.coeffs[name] for name in ("gyrTs", "accTs", "magTs")], vqf.params, vqf.state)


copyreg.pickle(VQF, _reduced)


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
    ahead = np.where(steep[:, np.newaxis], -body[:, :, 2], body[:, :, 0])
    return np.asarray(np.mod(np.arctan2(ahead[:, 0], ahead[:, 1]), 2.0 * np.pi))


class Fusion:
    """Attitude until the next restart or gap; a relative heading begins at `begins_at`, rad."""

    def __init__(self, begins_at: float) -> None:
        self._begins_at = begins_at
        self._first: list[int] = []
        self._mags = 0
        self._vqf: VQF | None = None
        self._interval_s = 0.0
        self._bias_known = False
        self._delta = math.nan
        """Of a relative heading."""
        self.north = False
        """Whether the heading refers to the magnetometer."""
        self.disturbed = False
        """Whether VQF takes the magnetic field for disturbed."""

    @property
    def begun(self) -> bool:
        """Whether there is an attitude."""
        return not math.isnan(self._delta)

    def process(
        self, rows: Rows, time_ns: IntArray, accel: FloatArray, has_mag: BoolArray, bias_known: bool
    ) -> None:
        """Follow rows, (n,), and fill in what is found.

        `accel` (n, 3) is the specific force, m/s², zero where there is none; `has_mag` (n,) is where `field`
        is of this very row.  VQF estimates the bias unless it is known, and the angles are without it.
        """
        start = self._learn_rate(time_ns, accel, has_mag)
        if start == len(rows) or self._vqf is None:
            return
        if bias_known != self._bias_known:
            self._bias_known = bias_known
            self._vqf.setBiasEstimate(np.zeros(3), math.radians(self._vqf.params["biasSigmaInit"]))
            self._vqf.setMotionBiasEstEnabled(not bias_known)
            self._vqf.setRestBiasEstEnabled(not bias_known)
        rows, accel, has_mag = rows[start:], accel[start:], has_mag[start:]
        inputs = [rows["angle"] * (1.0 / self._interval_s), accel]
        with_mag = self.north or bool(has_mag.any())
        if with_mag:
            inputs.append(np.where(has_mag[:, np.newaxis], rows["field"], 0.0))
        found = self._vqf.updateBatchFullState(*inputs)
        for name, of_vqf in (("quat6d", "quat6D"), ("acc_quat", "accQuat"), ("gyr_quat", "gyrQuat")):
            rows[name] = found[of_vqf]
        rows["low_force"] = np.sqrt((found["lastAccLp"] ** 2).sum(1))
        if not self.begun:
            self._delta = float(heading(rows["quat6d"][:1])[0]) - self._begins_at
        rows["delta"] = self._delta
        if not with_mag:
            return
        north = self.north | np.logical_or.accumulate(has_mag)
        rows["north"], rows["delta"] = north, np.where(north, found["delta"], self._delta)
        # Before it has taken a field as its reference VQF calls every field disturbed, and follows it.
        disturbed = found["magDistDetected"] & (found["magRefNorm"] > 0.0)
        rows["follows"] = ~disturbed | (found["magRejectT"] > self._vqf.params["magMaxRejectionTime"])
        self.north, self.disturbed = True, bool(disturbed[-1])

    def _learn_rate(self, time_ns: IntArray, accel: FloatArray, has_mag: BoolArray) -> int:
        """Take the rate from the first intervals; return the first row that the filter may have."""
        start = 0
        while self._vqf is None and start < len(time_ns):
            self._first.append(int(time_ns[start]))
            self._mags += bool(has_mag[start])
            if len(self._first) > RATE_SAMPLES and accel[start].any():
                self._interval_s = max(float(np.median(np.diff(self._first))), 1.0) * 1e-9
                mag_s = self._interval_s * (len(self._first) / self._mags if self._mags else 1.0)
                self._vqf = VQF(self._interval_s, magTs=mag_s, tauAcc=TAU_ACC_S, tauMag=TAU_MAG_S)
            start += 1
        return start
