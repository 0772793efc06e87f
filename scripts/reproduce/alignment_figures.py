"""Figures 5 to 9 of Lee et al., from the loop and the stage of imumon."""

from __future__ import annotations

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from alignment_loop import Loop, closed_heading, closed_tilt, short_heading, simulate
from alignment_runs import ARW, LATITUDE_DEG, Case, align, plan

from imumon.blocks import FloatArray
from imumon.geodesy import EARTH_RATE

mpl.use("Agg")
from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

ARW_SI = math.radians(ARW) / 60.0
LEVEL = EARTH_RATE * math.cos(math.radians(LATITUDE_DEG))


def bound_known(time_s: FloatArray) -> FloatArray:
    """Return the Cramér-Rao bound of the heading, deg, where white noise alone matters."""
    return np.asarray(np.degrees(ARW_SI / np.sqrt(time_s) / LEVEL))


def bound_free(begin_s: float, end_s: FloatArray, tau_s: float, amplitude_ug: float) -> FloatArray:
    """Return the bound, deg, from control rates alone, with amplitude and time constant of the warm-up free.

    The rate is c + a exp(-t / tau) / tau in white noise of the density ARW²: the information matrix of
    (c, a, tau) over the span.
    """
    result = []
    for end in end_s:
        t = np.linspace(begin_s, end, 2000)
        fade = np.exp(-t / tau_s)
        by_tau = amplitude_ug * 1e-6 * fade * (t / tau_s - 1.0) / tau_s**2
        slopes = np.vstack([np.ones_like(t), fade / tau_s * 1e-6, by_tau])
        information = slopes @ slopes.T * (end - begin_s) / len(t) / ARW_SI**2
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        result.append(math.degrees(math.sqrt(inverse[0, 0]) / LEVEL))
    return np.array(result)


def _axes(title: str, rows: int = 1, x: str = "s after power-on") -> tuple[Figure, list[Axes]]:
    figure, axes = plt.subplots(rows, 1, figsize=(8, 2.7 * rows + 1.0), dpi=80, squeeze=False)
    figure.suptitle(title, fontsize=10)
    axes[-1, 0].set_xlabel(x)
    for ax in axes[:, 0]:
        ax.grid(alpha=0.3)
    return figure, list(axes[:, 0])


def _write(figure: Figure, ax: list[Axes], folder: Path, name: str) -> None:
    for one in ax:
        one.legend(fontsize=8, loc="upper right")
    figure.tight_layout()
    figure.savefig(folder / name, metadata={"Software": None})
    plt.close(figure)


def draw_loop(folder: Path) -> None:
    """Draw figures 5 and 6: 30 µg, 300 s, 2 Hz, 36°, no noise."""
    loop = Loop()
    course = simulate(loop, 900.0)
    every = slice(20, None, 40)
    t = course.time_s[every]
    figure, ax = _axes("Figure 5: tilt made by the warm-up")
    ax[0].plot(t, 1e6 * course.tilt[0, every], label="about east, simulated")
    ax[0].plot(t, 1e6 * course.tilt[1, every], label="about north, simulated")
    sign = np.sign(course.tilt[:, -1])
    for axis in range(2):
        label = "equations 16, 17" if axis == 0 else None
        ax[0].plot(t, 1e6 * sign[axis] * closed_tilt(loop, t), "k:", lw=1.0, label=label)
    ax[0].set_ylabel("µrad")
    _write(figure, ax, folder, "figure-05.png")
    figure, ax = _axes("Figure 6: heading error made by the warm-up")
    late = course.time_s >= 5.0
    t, rate = course.time_s[late], -course.control[0, late]
    ax[0].plot(t, 1e3 * rate / LEVEL, label="instantaneous control rate, simulated")
    ax[0].plot(t, 1e3 * closed_heading(loop, t), "k:", label="equation 19")
    ax[0].plot(t, 1e3 * short_heading(loop, t), "r--", lw=0.8, label="equation 22")
    mean = np.cumsum(rate) / np.arange(1, len(rate) + 1)
    ax[0].plot(t, 1e3 * mean / LEVEL, label="total average from 5 s on")
    ax[0].set_ylabel("mrad")
    _write(figure, ax, folder, "figure-06.png")


def draw_run(folder: Path) -> None:
    """Draw figures 7, 8 and 9: 83.7 µg, 150 s, navigation-grade gyros, 15 minutes."""
    tau = 150.0
    run = align(plan(Case("figures"), tau, 0.0, 900.0), 1, Case("figures").parameters)
    t = np.arange(1, len(run.error["shown"]) + 1, dtype=float)
    figure, ax = _axes("Figure 7: control rate about east, and its integral", 2)
    rate = np.degrees(run.columns["fixed_gain_loop_control_rate_east"]) * 3600.0
    ax[0].plot(t, rate, ".", ms=1.5, label="control rate, one sample a second")
    ax[0].set_ylabel("°/h")
    angle = np.cumsum(np.nan_to_num(run.columns["fixed_gain_loop_control_rate_east"]))
    kept = np.isfinite(rate)
    ax[1].plot(t, 1e6 * angle, label="integral")
    slope, start = np.polyfit(t[kept], angle[kept], 1)
    ax[1].plot(t[kept], 1e6 * (slope * t[kept] + start), "r--", lw=0.8, label="fitted line")
    ax[1].set_ylabel("µrad")
    _write(figure, ax, folder, "figure-07.png")
    figure, ax = _axes("Figure 8: drift of roll and pitch of a unit at rest")
    for name in ("roll", "pitch"):
        ax[0].plot(t, 1e6 * run.columns[f"{name}_drift"], label=name)
    ax[0].set_ylabel("µg")
    _write(figure, ax, folder, "figure-08.png")
    figure, ax = _axes("Figure 9: heading error, and the Cramér-Rao bound", 2)
    colors = {"total_average": "k", "curve_fit": "r", "hann_mean": "m", "shown": "g"}
    begin = 36.0
    known = bound_known(t[t > 5])
    free = bound_free(begin, t[t > begin + 30], tau, 83.7)
    for name, color in colors.items():
        label = name.replace("_", " ")
        ax[0].plot(t, run.error[name], color, lw=1.0, label=label)
        ax[1].semilogy(t, np.abs(run.error[name]), color, lw=0.7, label=f"|error| {label}")
        ax[1].semilogy(t, run.sd[name], color + "--", lw=0.8)
    ax[0].axhspan(-0.05, 0.05, color="0.9")
    ax[0].set_ylim(-0.4, 0.4)
    ax[0].set_ylabel("°")
    ax[1].semilogy(t[t > 5], known, "b-", lw=2.0, label="bound, level seen by the gyros")
    ax[1].semilogy(t[t > begin + 30], free, "c-", lw=2.0, label="bound, control rates alone")
    ax[1].set_ylim(1e-4, 1.0)
    ax[1].set_ylabel("° (dashed: sigma)")
    _write(figure, ax, folder, "figure-09.png")


def draw_all(folder: Path) -> None:
    """Draw every figure into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    draw_loop(folder)
    draw_run(folder)
