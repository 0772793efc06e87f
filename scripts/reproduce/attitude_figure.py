"""The figure of docs/attitude.md: error of the tilt and of a free heading beside their sigmas."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import matplotlib as mpl
import numpy as np
from attitude_scenes import SCENES, simulate

from imumon.blocks import SampleBlock
from imumon.estimation.attitude.fusion import heading
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

RATE_HZ, SEED = 50.0, 9700


def draw(path: Path) -> None:
    """Draw a unit that is turned by hand, without a magnetometer."""
    record = simulate(SCENES["by hand"], RATE_HZ, SEED)
    columns = record.samples.columns.items()
    samples = SampleBlock({name: each for name, each in columns if not name.startswith("mag")})
    for stage in (RestAndBias(mode="learned"), AttitudeEstimate()):
        samples = samples.with_columns(stage.process(samples))
    q = np.column_stack([samples[f"attitude_estimate_{part}"] for part in "wxyz"])
    true_up = record.attitude[:, 2]
    w, x, y, z = q.T
    up = np.column_stack([2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)])
    tilt = np.arccos(np.clip((up * true_up).sum(1), -1.0, 1.0))
    true_heading = np.arctan2(record.attitude[:, 0, 0], record.attitude[:, 1, 0])
    heading_sd = samples["attitude_estimate_heading_sd"]
    off = heading(q) - true_heading
    turn = np.abs(np.angle(np.exp(1j * (off - off[np.argmax(np.isfinite(heading_sd))]))))
    t = samples["device_time_ns"] * 1e-9
    figure, axes = plt.subplots(2, 1, figsize=(8, 5), dpi=80, sharex=True)
    figure.suptitle("Turned by hand for 30 s, at rest for 10 s, and so on; no magnetometer", fontsize=10)
    drawn = ((tilt, np.sqrt(2.0) * samples["attitude_estimate_tilt_sd"]), (turn, heading_sd))
    for ax, name, (error, sd) in zip(axes, ("tilt", "free heading"), drawn, strict=True):
        axis = cast(Axes, ax)
        axis.fill_between(t, np.degrees(sd), alpha=0.3, label=f"sigma of the {name}")
        axis.plot(t, np.degrees(error), linewidth=0.8, label="error")
        axis.set_ylabel(f"{name}, deg")
        axis.legend(loc="upper left", fontsize=8)
        axis.grid(alpha=0.3)
    axes[-1].set_xlabel("s")
    plt.tight_layout()
    plt.savefig(path)
    plt.close()
