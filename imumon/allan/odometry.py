"""The noise as visual-inertial odometry reads it: Kalibr, OpenVINS, VINS-Mono and VINS-Fusion.

Each has one number for three axes: the largest.  White noise N and bias random walk K are continuous-time
densities, N in rad/s/√Hz or m/s²/√Hz, K in rad/s²/√Hz or m/s³/√Hz.

- Kalibr's imu.yaml and OpenVINS' kalibr_imu_chain.yaml have N and K as they are (Kalibr's wiki, IMU Noise
  Model).
- VINS has standard deviations of a sample, N √f and K √f at the rate f: its propagation adds acc_w² Δt² a
  step for K² Δt (read in integration_base.h).  Its midpoint rule takes the mean of two samples as independent
  in each step, so that of the white noise it counts 1/√2.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from imumon.allan.analysis import Result
from imumon.allan.output import value_of
from imumon.config import dump_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import write_text
from imumon.geodesy import STANDARD_GRAVITY

SENSORS = {"accel": ("accelerometer", "acc"), "gyro": ("gyroscope", "gyr")}
"""Names of a sensor: ours, Kalibr's and that of VINS."""
OPENCV = "%YAML:1.0\n"
"""The first line of a file that OpenCV's FileStorage reads."""


def write_kalibr(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write Kalibr's imu.yaml.

    Raises BAD_DATA when a sensor is missing or shows no white noise; OSError when the file cannot be written.
    """
    body, head = _densities(results, source)
    write_text(path, head + dump_yaml(body, flow=False))


def write_openvins(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write OpenVINS' kalibr_imu_chain.yaml, without intrinsics or lever arm; raises as `write_kalibr`."""
    body, head = _densities(results, source)
    # Made anew each time: YAML writes a list that comes twice as a reference, which OpenCV does not read.
    chain: dict[str, Any] = {
        "T_i_b": np.eye(4).tolist(),
        **body,
        "time_offset": 0.0,
        "model": "kalibr",
        **{name: np.eye(3).tolist() for name in ("Tw", "R_IMUtoGYRO", "Ta", "R_IMUtoACC")},
        "Tg": np.zeros((3, 3)).tolist(),
    }
    # OpenCV refuses a list that stands at the column of its key.
    text = re.sub(r"^( *)- ", r"\1  - ", dump_yaml({"imu0": chain}, flow=None), flags=re.MULTILINE)
    write_text(path, OPENCV + head + text)


def write_vins(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write the IMU's lines of a configuration of VINS-Mono or VINS-Fusion; raises as `write_kalibr`."""
    body, head = _densities(results, source)
    rate = body["update_rate"]
    head += f"# Of one sample at {rate:g} Hz: the densities times the root of the rate.\n"
    values = {}
    for name, short in SENSORS.values():
        values[f"{short}_n"] = _rounded(math.sqrt(rate) * body[f"{name}_noise_density"])
        values[f"{short}_w"] = _rounded(math.sqrt(rate) * body[f"{name}_random_walk"])
    values["g_norm"] = STANDARD_GRAVITY
    write_text(path, OPENCV + head + dump_yaml(values, flow=False))


def _densities(results: Mapping[str, Result], source: Path) -> tuple[dict[str, Any], str]:
    """Return densities, rate and topic by Kalibr's names, and the comments above them."""
    head = (
        f"# Noise of {source.name}, by Allan deviation; the largest of the three axes.\n"
        "# rostopic is a guess: name your own.\n"
    )
    body: dict[str, Any] = {}
    for group, (name, _) in SENSORS.items():
        axes = [results.get(f"{group}_{axis}") for axis in "xyz"]
        white, walk = (
            max((value for result in axes if (value := value_of(result, term)) is not None), default=None)
            for term in ("angle_random_walk", "rate_random_walk")
        )
        if white is None:
            raise ImumonError(
                Reason.BAD_DATA, f"odometry needs a noise density of the {name}, and the data show none"
            )
        if walk is None:
            head += f"# {name}_random_walk: the data show none; 0 is not a fact of the sensor.\n"
        body[f"{name}_noise_density"] = white
        body[f"{name}_random_walk"] = 0.0 if walk is None else walk
    some = next(result for name, result in results.items() if name.startswith("gyro"))
    return {**body, "rostopic": "/imu0", "update_rate": _rounded(some.series.rate_hz)}, head


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")
