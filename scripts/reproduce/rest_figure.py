"""The figure of docs/rest-detector.md: what of a knock, a slow turn and a jump of the bias is called rest."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import cast

import matplotlib as mpl
import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

RATE_HZ, SECONDS, SEED = 100.0, 480.0, 9800
DEG = np.pi / 180.0
GYRO_SD, ACCEL_SD = 0.05 * DEG, 0.01
"""White noise of a sample of an industrial sensor, rad/s and m/s²."""
BIAS_DPS = 0.3
KNOCK_S = (90.0, 91.0)
TURN_S, TURN_DPS = (150.0, 210.0), 0.5
JUMP_S, JUMP_DPS = 330.0, 0.05


def simulate() -> tuple[SampleBlock, FloatArray]:
    """Return samples of a unit that lies level and turns about the vertical, and the bias of z in °/s."""
    rng = np.random.default_rng(SEED)
    t = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    gyro, accel = GYRO_SD * rng.standard_normal((len(t), 3)), ACCEL_SD * rng.standard_normal((len(t), 3))
    bias: FloatArray = np.where(t > JUMP_S, BIAS_DPS + JUMP_DPS, BIAS_DPS)
    gyro[:, 2] += DEG * (bias + TURN_DPS * ((t > TURN_S[0]) & (t < TURN_S[1])))
    knocked = (t > KNOCK_S[0]) & (t < KNOCK_S[1])
    gyro[knocked] += 1.5 * DEG * rng.standard_normal((int(knocked.sum()), 3))
    accel[:, 2] += 9.80665
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.round(t * 1e9).astype(np.int64),
        "segment": np.zeros(len(t), np.int64),
    }
    for name, values in (("gyro", gyro), ("accel", accel)):
        columns |= {f"{name}_{axis}": values[:, k] for k, axis in enumerate("xyz")}
    return SampleBlock(columns), bias


def draw(path: Path) -> None:
    """Draw the rate, where the unit is called at rest, and the bias with 2σ."""
    samples, truth = simulate()
    samples = samples.with_columns(RestAndBias().process(samples))
    t = samples["device_time_ns"] * 1e-9
    rate, bias, sd = (samples[name] / DEG for name in ("gyro_z", "gyro_bias_z", "gyro_bias_sd_z"))
    figure, axes = plt.subplots(2, 1, figsize=(8, 5), dpi=80, sharex=True)
    figure.suptitle(
        "A knock (90 s), a turn of 0.5 °/s (150 s), a jump of the bias by 180 °/h (330 s)", fontsize=10
    )
    above, below = (cast(Axes, one) for one in axes)
    each = int(RATE_HZ)
    above.plot(t[::each], rate.reshape(-1, each).mean(1), linewidth=0.9, label="gyro z, means of 1 s")
    above.fill_between(t, -0.2, 1.0, where=samples["at_rest"] == 1, alpha=0.2, color="C2", label="at rest")
    above.set(ylim=(-0.2, 1.0), ylabel="°/s")
    below.fill_between(t, bias - 2.0 * sd, bias + 2.0 * sd, alpha=0.3, label="bias ± 2σ")
    below.plot(t, bias, linewidth=0.9, label="bias")
    below.plot(t, truth, "k--", linewidth=0.9, label="truth")
    below.set(ylim=(0.2, 0.5), ylabel="bias of z, °/s", xlabel="s")
    for axis in (above, below):
        axis.legend(loc="upper right", fontsize=8)
        axis.grid(alpha=0.3)
    plt.tight_layout()
    plt.savefig(path)
    plt.close()


if __name__ == "__main__":
    draw(Path(sys.argv[1]))
