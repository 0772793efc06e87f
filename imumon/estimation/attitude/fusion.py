"""The filter VQF (Laidig and Seel, Information Fusion 2023, doi 10.1016/j.inffus.2022.10.014) over samples.

VQF takes samples at a constant rate.  Here the rate is that of the first samples, and each angular rate is
multiplied by its own interval over the usual one: so the angle is right whatever the intervals are.
"""

from __future__ import annotations

import copyreg
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, IntArray
from imumon.estimation.attitude.angles import heading

LEARNED = 16
"""Intervals that the rate is taken from."""
TAU_ACC_S, TAU_MAG_S = 3.0, 9.0
"""VQF's defaults: so slowly the vertical follows the accelerometers, and the heading the magnetometer."""


def _stored(filter_: VQF) -> tuple[Callable[..., VQF], tuple[Any, ...]]:
    """Tell pickle what a filter is made of, so that a stage can be stored and go on."""
    rates = [filter_.coeffs[name] for name in ("gyrTs", "accTs", "magTs")]
    return _restored, (rates, filter_.params, filter_.state)


def _restored(rates: list[float], parameters: dict[str, Any], state: dict[str, Any]) -> VQF:
    filter_ = VQF(*rates, **parameters)
    filter_.state = state
    return filter_


copyreg.pickle(VQF, _stored)


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Rows that have a time and a rate.

    Parameters
    ----------
    time_ns : array of int64 (n,)
    angle, accel, mag : array (n, 3)
        Turn since the row before, rad, m/s² and any unit; of accel and mag zero where there is none.
    has_mag : array of bool (n,)
    """

    time_ns: IntArray
    angle: FloatArray
    accel: FloatArray
    mag: FloatArray
    has_mag: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """What the filter finds, row by row; NaN and 0 where it has not begun.

    Parameters
    ----------
    q : array (n, 4)
        w, x, y, z, from body axes to north, or to level axes of its own.
    levelling : array (n, 4)
        From where the gyros alone have carried the level axes to where the filter has them.
    north : array of int64 (n,)
        Whether q refers to north.
    """

    q: FloatArray
    levelling: FloatArray
    north: IntArray


class Fusion:
    """Attitude from one begin to the next: a restart, a gap."""

    def __init__(self) -> None:
        self._first: list[int] = []
        self._seen_mag = 0
        self._vqf: VQF | None = None
        self._interval_s = 0.0
        self._bias_known = False
        self.first_heading = 0.0
        """Heading in axes of its own that the body began with, rad."""
        self.north = False
        """Whether the heading refers to the magnetometer."""
        self.disturbed = False
        """Whether VQF takes the magnetic field for disturbed."""
        self.last = np.full(4, np.nan)
        """The latest quaternion, w, x, y, z, (4,), from body axes to level axes of its own."""

        self.levelling = np.full(4, np.nan)
        """The latest of `Found`."""

    @property
    def begun(self) -> bool:
        """Whether there is an attitude."""
        return not math.isnan(self.last[0])

    def follows(self) -> float:
        """Return how fast the heading follows the field: 1 as usual, 0 not at all, between: slower."""
        if self._vqf is None or not self.disturbed:
            return 1.0
        given = self._vqf.params
        rejected = self._vqf.state["magRejectT"] <= given["magMaxRejectionTime"]
        return 0.0 if rejected else float(1.0 / given["magRejectionFactor"])

    @property
    def to_north(self) -> float:
        """How far the field has turned the heading from level axes of its own, rad; NaN while it is free."""
        return float(self._vqf.getDelta()) if self._vqf is not None and self.north else math.nan

    def lose_north(self) -> None:
        """Let the heading be free from here; it began with where the gyros have it now."""
        self.north = self.disturbed = False
        self.first_heading = float(heading(self.last[np.newaxis])[0])

    def process(self, readings: Readings, start: int, stop: int, bias_known: bool, found: Found) -> None:
        """Follow rows start..stop, and fill in what is found."""
        start = self._learn(readings, start, stop)
        if start == stop or self._vqf is None:
            return
        self._know_bias(self._vqf, bias_known)
        level = start
        if not self.north:
            # Up to here nothing says where north is.
            has_mag = readings.has_mag[start:stop]
            level = start + int(np.argmax(has_mag)) if has_mag.any() else stop
        gyro = readings.angle[start:stop] * (1.0 / self._interval_s)
        if start < level:
            said = self._vqf.updateBatchFullState(gyro[: level - start], readings.accel[start:level])
            found.q[start:level], found.levelling[start:level] = said["quat6D"], said["accQuat"]
            if not self.begun:
                self.first_heading = float(heading(said["quat6D"][:1])[0])
        if level < stop:
            self.north = True
            mag = readings.mag[level:stop]
            said = self._vqf.updateBatchFullState(gyro[level - start :], readings.accel[level:stop], mag)
            found.q[level:stop], found.levelling[level:stop] = said["quat9D"], said["accQuat"]
            # Before it has taken a field as its reference VQF calls every field disturbed, and follows it.
            self.disturbed = bool(said["magDistDetected"][-1]) and self._vqf.getMagRefNorm() > 0.0
            found.north[level:stop] = 1
        self.last, self.levelling = said["quat6D"][-1].copy(), said["accQuat"][-1].copy()

    def _learn(self, readings: Readings, start: int, stop: int) -> int:
        """Take the rate from the first intervals; return the first row that the filter may have."""
        while self._vqf is None and start < stop:
            self._first.append(int(readings.time_ns[start]))
            self._seen_mag += bool(readings.has_mag[start])
            if len(self._first) > LEARNED and readings.accel[start].any():
                self._begin()
            start += 1
        return start

    def _begin(self) -> None:
        intervals = np.diff(self._first)
        usual = intervals[intervals <= 1.5 * np.median(intervals)]
        self._interval_s = max(float(usual.mean()), 1.0) * 1e-9
        between_mag = len(self._first) / self._seen_mag if self._seen_mag else 1.0
        self._vqf = VQF(
            self._interval_s, magTs=between_mag * self._interval_s, tauAcc=TAU_ACC_S, tauMag=TAU_MAG_S
        )

    def _know_bias(self, vqf: VQF, known: bool) -> None:
        """Let VQF estimate the bias while nobody else knows it."""
        if known == self._bias_known:
            return
        self._bias_known = known
        vqf.setBiasEstimate(np.zeros(3), math.radians(vqf.params["biasSigmaInit"]))
        vqf.setMotionBiasEstEnabled(not known)
        vqf.setRestBiasEstEnabled(not known)
