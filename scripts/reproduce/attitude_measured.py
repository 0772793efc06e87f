"""Error over sigma of the estimated attitude on measured motion with optical truth: BROAD recordings.

Laidig, Caruso, Cereatti, Seel, "BROAD: a benchmark for robust inertial orientation estimation", Data 6(7):72,
2021, doi 10.3390/data6070072.  A file a trial, with arrays gyr, rad/s, acc, m/s², opt_quat and movement.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from samples import sent
from scipy.spatial.transform import Rotation
from study import Cells, largest, rms

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.estimation.attitude.parameters import AttitudeParameters
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias

HEADS = (
    "trial, during motion", "tilt °", "z rms", "max", "σ °", "free heading °", "z rms", "max", "σ °",
    "claimed %",
)  # fmt: skip
FORMATS = ("", ".2f", ".2f", ".1f", ".2f", ".2f", ".2f", ".1f", ".2f", ".0f")
UP = np.array([0.0, 0.0, 1.0])
TRUTH_SD = np.radians(0.05)
"""Of the optical heading, rad."""


@dataclass(frozen=True, eq=False)
class Trial:
    """Errors in motion and sigmas, rad, (n,): of the tilt the total angle, of the heading its change."""

    name: str
    tilt: FloatArray
    tilt_sd: FloatArray
    turn: FloatArray
    turn_sd: FloatArray


def measured_rows(folder: Path, given: AttitudeParameters) -> Iterator[Cells]:
    """Yield the cells of each trial in a folder."""
    for trial in measured(folder, given):
        claimed = 100.0 * float(np.isfinite(trial.turn_sd).mean())
        yield [trial.name, *_row(trial.tilt, trial.tilt_sd), *_row(trial.turn, trial.turn_sd), claimed]


def measured(folder: Path, given: AttitudeParameters) -> Iterator[Trial]:
    """Yield each trial in a folder; none where it is missing."""
    for path in sorted(folder.glob("*.npz")):
        samples, truth, scored = _trial(path)
        found = AttitudeEstimate(given).process(samples)
        q = np.column_stack([found[f"attitude_estimate_{part}"] for part in "wxyz"])
        scored = scored & np.isfinite(q[:, 0])
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


@cache
def _trial(path: Path) -> tuple[SampleBlock, FloatArray, BoolArray]:
    """Return a trial as the stages before leave it, the true attitude and which rows are scored."""
    with np.load(path) as data:
        gyro, accel = (data[name].astype(np.float64) for name in ("gyr", "acc"))
        samples = sent(np.arange(len(gyro)) / float(data["sampling_rate"]), gyro=gyro, accel=accel)
        truth = data["opt_quat"]
        scored = data["movement"] & np.isfinite(truth).all(1)
    samples = samples.with_columns(RestAndBias(mode="learned").process(samples))
    return samples, truth, scored


def _row(error: FloatArray, sd: FloatArray) -> list[float]:
    """Return rms error, rms and largest error over sigma, and median sigma."""
    ratio = error / sd
    return [float(np.degrees(rms(error))), rms(ratio), largest(ratio), float(np.degrees(np.nanmedian(sd)))]
