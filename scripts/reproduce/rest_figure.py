"""A knock, a slow turn and a jump of the bias: what of them is called rest, and the bias meanwhile."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import figures
import numpy as np
from samples import sent
from study import Cells, Options, Study, Table

from imumon.blocks import FloatArray, SampleBlock
from imumon.estimation.gyro_bias.stage import RestAndBias

RATE_HZ, SECONDS, SEED = 100.0, 480.0, 9800
DEG = np.pi / 180.0
GYRO_SD, ACCEL_SD = 0.05 * DEG, 0.01
"""White noise of a sample of an industrial sensor, rad/s and m/s²."""
BIAS_DPS = 0.3
KNOCK_S = (90.0, 91.0)
TURN_S, TURN_DPS = (150.0, 210.0), 0.5
JUMP_S, JUMP_DPS = 330.0, 0.05


def estimated() -> tuple[SampleBlock, FloatArray]:
    """Return the estimates of a level unit that turns about the vertical, and its bias of z in °/s."""
    rng = np.random.default_rng(SEED)
    t = np.arange(int(SECONDS * RATE_HZ)) / RATE_HZ
    gyro, accel = GYRO_SD * rng.standard_normal((len(t), 3)), ACCEL_SD * rng.standard_normal((len(t), 3))
    bias: FloatArray = np.where(t > JUMP_S, BIAS_DPS + JUMP_DPS, BIAS_DPS)
    gyro[:, 2] += DEG * (bias + TURN_DPS * ((t > TURN_S[0]) & (t < TURN_S[1])))
    knocked = (t > KNOCK_S[0]) & (t < KNOCK_S[1])
    gyro[knocked] += 1.5 * DEG * rng.standard_normal((int(knocked.sum()), 3))
    accel[:, 2] += 9.80665
    samples = sent(t, gyro=gyro, accel=accel)
    return samples.with_columns(RestAndBias().process(samples)), bias


def tables(_: Options) -> Iterator[Table]:
    """Yield how much of each part is called rest."""
    rest = estimated()[0]["at_rest"] == 1
    parts = {"knock": KNOCK_S, "turn": TURN_S, "after the jump": (JUMP_S, SECONDS)}
    rows: list[Cells] = []
    for name, (begin, end) in parts.items():
        rows.append([name, 100.0 * float(rest[int(begin * RATE_HZ) : int(end * RATE_HZ)].mean())])
    yield Table("", ["part", "called rest, %"], rows, formats=("", ".0f"))


def draw(_: Options) -> Iterator[Path]:
    """Draw the rate, where the unit is called at rest, and the bias with 2σ."""
    samples, truth = estimated()
    t, each = samples["device_time_ns"] * 1e-9, int(RATE_HZ)
    rate, bias, sd = (samples[name] / DEG for name in ("gyro_z", "gyro_bias_z", "gyro_bias_sd_z"))
    title = "A knock (90 s), a turn of 0.5 °/s (150 s), a jump of the bias by 180 °/h (330 s)"
    above, below = figures.axes(title, 2, x="s", size=(8.0, 5.0))
    above.plot(t[::each], rate.reshape(-1, each).mean(1), linewidth=0.9, label="gyro z, means of 1 s")
    above.fill_between(t, -0.2, 1.0, where=samples["at_rest"] == 1, alpha=0.2, color="C2", label="at rest")
    above.set(ylim=(-0.2, 1.0), ylabel="°/s")
    below.fill_between(t, bias - 2.0 * sd, bias + 2.0 * sd, alpha=0.3, label="bias ± 2σ")
    below.plot(t, bias, linewidth=0.9, label="bias")
    below.plot(t, truth, "k--", linewidth=0.9, label="truth")
    below.set(ylim=(0.2, 0.5), ylabel="bias of z, °/s")
    yield figures.save([above, below], "rest", "turn-or-bias")


STUDY = Study(tables, draw=draw)
