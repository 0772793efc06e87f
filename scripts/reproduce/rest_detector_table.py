"""Turns and scenes outside the bench, what is counted of a detector, and the rest detection of VQF."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from rest_detector_scenes import BIAS, Scene
from study import matrix
from vqf import VQF

from imumon.blocks import BoolArray, FloatArray, SampleBlock

FULL_RATE_HZ, TURN_RATE_HZ = 100.0, 25.0
SECONDS = 200.0
TURNS = (
    (0.05, 10.0, 0.5, 0.0), (0.1, 10.0, 10.0, 0.0), (0.5, 10.0, 0.5, 0.0), (0.5, 10.0, 120.0, 0.0),
    (0.5, 60.0, 120.0, 0.0), (0.5, 10.0, 120.0, 45.0), (0.5, 10.0, 120.0, 90.0), (5.0, 12.0, 5.0, 0.0),
    (30.0, 30.0, 120.0, 0.0), (300.0, 10.0, 20.0, 0.0),
)  # fmt: skip
"""deg/s, minutes, seconds in which it begins and ends, and degrees from the vertical to the axis."""
FIELD = ("tilted slowly, 1 deg in 60 s", "breathing, 0.1 deg/s", "idling engine", "driving in town",
         "driving on a smooth road", "held in a hand", "fan")  # fmt: skip


@dataclass
class Tally:
    """Sums over runs: seconds of rest and of motion, and those found and missed."""

    rest: float = 0.0
    rest_found: float = 0.0
    motion: float = 0.0
    motion_missed: float = 0.0

    def add(self, t: FloatArray, rest: BoolArray, found: BoolArray) -> None:
        """Add a run: times, truth, and what was found."""
        dt = t[1] - t[0]
        self.rest += rest.sum() * dt
        self.rest_found += (rest & found).sum() * dt
        self.motion += (~rest).sum() * dt
        self.motion_missed += (~rest & found).sum() * dt

    def percent(self) -> tuple[float, float]:
        """Return the shares of motion taken for rest, and of rest found, NaN without any."""
        missed = 100.0 * self.motion_missed / self.motion if self.motion else np.nan
        return missed, 100.0 * self.rest_found / self.rest if self.rest else np.nan


def vqf_rest(samples: SampleBlock) -> BoolArray:
    """Return what the rest detection of the PyPI package vqf says, with its default settings.

    It is given gyros without their bias at the start, for it takes more than 2 deg/s for motion.
    """
    t = samples["device_time_ns"] * 1e-9
    gyro, accel = matrix(samples, "gyro"), matrix(samples, "accel")
    found = VQF(float(t[1] - t[0])).updateBatch(
        np.ascontiguousarray(gyro - BIAS), np.ascontiguousarray(accel)
    )
    return np.asarray(found["restDetected"], np.bool_)


def bias_over_sigma(samples: SampleBlock, truth: FloatArray) -> FloatArray:
    """Return the error of the bias over its sigma, (n, 3), NaN where there is no estimate.

    The hypothesis of a turn is part of the sigma that the estimator gives.
    """
    return (matrix(samples, "gyro_bias") - truth) / matrix(samples, "gyro_bias_sd")


def the_same(scene: Scene, seed: int) -> Scene:
    """Return a scene that is the same for every seed."""
    del seed
    return scene
