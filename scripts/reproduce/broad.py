"""Measured motion with optical truth: estimates on BROAD recordings, a rest, minutes in a hand, and a rest.

Laidig, Caruso, Cereatti, Seel, "BROAD: a benchmark for robust inertial orientation estimation", Data 6(7):72,
2021, doi 10.3390/data6070072.  A file a trial, with arrays gyr, rad/s, acc, m/s², opt_quat and movement.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from samples import sent
from scipy.spatial.transform import Rotation
from study import Cells, largest, matrix, rms

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import Mode, RestAndBias

HEADS = (
    "trial, during motion", "tilt °", "z rms", "max", "σ °", "free heading °", "z rms", "max", "σ °",
    "claimed %",
)  # fmt: skip
FORMATS = ("", ".2f", ".2f", ".1f", ".2f", ".2f", ".2f", ".1f", ".2f", ".0f")
UP = np.array([0.0, 0.0, 1.0])
TRUTH_SD = np.radians(0.05)
"""Of the optical heading, rad."""
SETTLED_S, REST_S = 1.0, 20.0
"""After the motion, and how long the mean of the gyros is that the bias is compared with."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Errors in motion and sigmas, rad, (n,): of the tilt the total angle, of the heading its change."""

    name: str
    tilt: FloatArray
    tilt_sd: FloatArray
    turn: FloatArray
    turn_sd: FloatArray


def load(path: Path, mode: Mode | None) -> tuple[SampleBlock, FloatArray, BoolArray]:
    """Return a trial with rest and bias estimated, the true attitude, (n, 4), and which rows move."""
    with np.load(path) as data:
        gyro, accel = (data[name].astype(np.float64) for name in ("gyr", "acc"))
        samples = sent(np.arange(len(gyro)) / float(data["sampling_rate"]), gyro=gyro, accel=accel)
        truth, moving = data["opt_quat"], data["movement"]
    stage = RestAndBias(mode=mode) if mode else RestAndBias()
    return samples.with_columns(stage.process(samples)), truth, moving


_loaded = cache(load)
"""For ablations of the attitude, before which nothing changes."""


def attitude_rows(data: Path) -> Iterator[Cells]:
    """Yield the cells of each trial below a folder of recordings."""
    for trial in measured(data, AttitudeParameters()):
        claimed = 100.0 * float(np.isfinite(trial.turn_sd).mean())
        angles = [*cells(trial.tilt[None], trial.tilt_sd), *cells(trial.turn[None], trial.turn_sd)]
        yield [trial.name, *angles, claimed]


def measured(data: Path, given: AttitudeParameters) -> Iterator[Trial]:
    """Yield the attitude of each trial below a folder of recordings; none where they are missing."""
    for path in sorted((data / "broad").glob("*.npz")):
        samples, truth, moving = _loaded(path, "learned")
        found = AttitudeEstimate(given).process(samples)
        q = np.column_stack([found[f"attitude_estimate_{part}"] for part in "wxyz"])
        scored = moving & np.isfinite(truth).all(1) & np.isfinite(q[:, 0])
        tilt_sd, heading_sd = (found[f"attitude_estimate_{name}_sd"][scored] for name in ("tilt", "heading"))
        ours, true = (Rotation.from_quat(each[scored], scalar_first=True) for each in (q, truth))
        cosine = (ours.inv().apply(UP) * true.inv().apply(UP)).sum(1)
        off = (ours * true.inv()).as_quat()
        turn = np.unwrap(2.0 * np.arctan2(off[:, 2], off[:, 3]))
        yield Trial(
            name=path.stem.replace("_", " "),
            tilt=np.arccos(np.clip(cosine, -1.0, 1.0)),
            tilt_sd=np.sqrt(2.0) * tilt_sd,
            turn=turn - turn[np.argmax(np.isfinite(heading_sd))],
            turn_sd=np.hypot(heading_sd, TRUTH_SD),
        )


def bias_errors(path: Path) -> tuple[FloatArray, FloatArray, float]:
    """Return error, rad/s, and error over sigma of the bias at the end of the motion, (3,), and the share of
    motion called rest, %.

    The bias is not known, so it is compared with the mean of the gyros over the rest that follows.
    """
    samples, _, moving = load(path, None)
    end = int(np.flatnonzero(moving)[-1])
    since_s = (samples["device_time_ns"] - samples["device_time_ns"][end]) * 1e-9
    after = (since_s >= SETTLED_S) & (since_s < SETTLED_S + REST_S)
    bias, sd = (matrix(samples, name)[end] for name in ("gyro_bias", "gyro_bias_sd"))
    error = bias - matrix(samples, "gyro")[after].mean(0)
    return error, error / sd, 100.0 * float(samples["at_rest"][moving].mean())


def cells(errors: FloatArray, sd: FloatArray) -> list[float]:
    """Return the cells of an angle, °: rms error by each method, rms and largest z of the first, its sigma.

    errors (methods, n) and sd (n,) in rad.
    """
    ratio = errors[0] / sd
    by_method = [float(np.degrees(rms(error))) for error in errors]
    return [*by_method, rms(ratio), largest(ratio), float(np.degrees(np.nanmedian(sd)))]
