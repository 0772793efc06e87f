"""Ablations of the attitude's sigma: simulated scenes, with and without a magnetometer, and recordings."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from ablations import Change, Outcome, ablation
from attitude_scenes import SCENES, Record, calibrated, simulate
from attitude_table import heading_error, rms, tilt_error
from broad import measured
from samples import without

from imumon.blocks import FloatArray
from imumon.estimation.attitude import sigma
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias

FREE = (
    "by hand", "robot arm", "swing", "drone", "rover", "car", "by hand, consumer gyros",
    "by hand, consumer accelerometers", "at rest, consumer accelerometers", "by hand, gyro z reversed",
)  # fmt: skip
MAGNETIC = ("by hand", "by hand, magnet on the body", "by hand, magnet put on", "at rest, magnet comes near")
RATE_HZ, FLOOR_DEG = 50.0, 0.01
TITLE = "Attitude, °: the angles are those of VQF in all rows, so the first columns are of the median sigma."
_learned: Callable[[sigma.Gyros], float] = sigma.Gyros.variance.fget  # type: ignore[attr-defined]  # mypy takes the property for its value


def _prior(_: sigma.Gyros) -> float:
    return sigma.SCALE_SD**2


def _bounded(gyros: sigma.Gyros) -> float:
    return min(_learned(gyros), sigma.SCALE_SD**2)


def _nothing(*_: Any) -> float:
    return 0.0


VARIANTS: dict[str, Change] = {
    "lag 3 s, which never confirms gyros": [(sigma, "LAG_S", 3.0)],
    "lag 12 s": [(sigma, "LAG_S", 12.0)],
    "scale not learned": [(sigma.Gyros, "variance", property(_prior))],
    "learned scale at most s0": [(sigma.Gyros, "variance", property(_bounded))],
    "s0 1 %": [(sigma, "SCALE_SD", 0.01)],
    "s0 4 %": [(sigma, "SCALE_SD", 0.04)],
    "w0 0.5 rad²": [(sigma, "SCALE_TURN", 0.5)],
    "w0 8 rad²": [(sigma, "SCALE_TURN", 8.0)],
    "no delay": [(sigma.TiltSigma, "not_followed", _nothing)],
    "gyros are always confirmed": [(sigma.Gyros, "confirmed", True)],
    "confirmed at 1 rad²": [(sigma, "CONFIRMING_TURN", 1.0)],
    "largest change 1 %": [(sigma, "LARGEST_CHANGE", 0.01)],
    "largest change 10 %": [(sigma, "LARGEST_CHANGE", 0.1)],
    "a0 5 mg": [(sigma, "ACCEL_SD", 0.05)],
    "a0 15 mg": [(sigma, "ACCEL_SD", 0.15)],
    "force less gravity not used": [(sigma.Accelerometers, "learn", _nothing)],
    "k_iron 1 %": [(sigma, "IRON", 0.01)],
    "k_iron 4 %": [(sigma, "IRON", 0.04)],
    "iron forgotten in 0.1 s": [(sigma, "IRON_MEMORY_S", 0.1)],
    "iron forgotten in 300 s": [(sigma, "IRON_MEMORY_S", 300.0)],
}
"""What is left out or set otherwise."""


@cache
def simulated(name: str, with_mag: bool, seed: int) -> Record:
    """Return a record of a scene as the stage before the attitude leaves it."""
    record = simulate(SCENES[name], RATE_HZ, seed)
    samples = record.samples if with_mag else without(record.samples, "mag")
    return replace(record, samples=samples.with_columns(RestAndBias(mode="learned").process(samples)))


def outcomes(seeds: range, data: Path) -> Iterator[Outcome]:
    """Yield the outcome of every scene; the error is the median sigma, for the angles stay."""
    for name, with_mag in [*((name, False) for name in FREE), *((name, True) for name in MAGNETIC)]:
        found = [_errors(simulated(name, with_mag, seed), with_mag) for seed in seeds]
        tilt, tilt_sd, turn, turn_sd = (np.concatenate(each) for each in zip(*found, strict=True))
        if not with_mag:
            yield _outcome(f"{name}, tilt", tilt, tilt_sd)
        yield _outcome(f"{name}, {'magnetic' if with_mag else 'free'} heading", turn, turn_sd)
    for trial in measured(data, AttitudeParameters()):
        yield _outcome(f"{trial.name}, tilt", trial.tilt, trial.tilt_sd)
        yield _outcome(f"{trial.name}, free heading", trial.turn, trial.turn_sd)


def _errors(given: Record, with_mag: bool) -> list[FloatArray]:
    """Return error and sigma of the tilt, and of the heading, rad, (n,) each."""
    found = AttitudeEstimate(axes=given.axes, magnetometer=calibrated()).process(given.samples)
    q = np.column_stack([found[f"attitude_estimate_{part}"] for part in "wxyz"])
    tilt_sd, heading_sd = (found[f"attitude_estimate_{name}_sd"] for name in ("tilt", "heading"))
    began, since = (int(np.argmax(np.isfinite(of))) for of in (q[:, 0], heading_sd))
    q, truth = q[began:], given.attitude[began:]
    tilt, turn = tilt_error(q, truth), heading_error(q, truth, since - began, not with_mag)
    return [tilt.ravel(), np.repeat(tilt_sd[began:], 2), turn, heading_sd[began:]]


def _outcome(scene: str, error: FloatArray, sd: FloatArray) -> Outcome:
    known = np.isfinite(sd)
    ratio = error[known] / sd[known]
    sigma = float(np.degrees(np.median(sd[known]))) if known.any() else 0.0
    return Outcome(
        scene, sigma, FLOOR_DEG, rms(ratio) if known.any() else 0.0, float(np.abs(ratio).max(initial=0.0))
    )


STUDY = ablation(TITLE, VARIANTS, outcomes)
