"""The alignment of Lee et al.: closed forms beside the loop of imumon, and figures 5 to 9."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import figures
import numpy as np
from alignment_loop import Loop, closed_heading, closed_tilt, comparisons, short_heading, simulate
from alignment_site_scenes import ACCEL_BIAS_UG, LATITUDE_DEG, PAPER_ARW
from study import Options, Study, Table

from imumon.blocks import ColumnArray, FloatArray
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.stage import Alignment
from imumon.geodesy import EARTH_RATE
from imumon.papers.self_alignment import Params, SelfAlignment
from imumon.simulation.unit import SimulatedUnit
from imumon.simulation.unit.scenario import Scenario

PAPER_RAD_PER_SQRT_S = math.radians(PAPER_ARW) / 60.0
LEVEL = EARTH_RATE * math.cos(math.radians(LATITUDE_DEG))
AMPLITUDE_UG, TAU_S, SECONDS, RATE_HZ = 83.7, 150.0, 900.0, 200.0
COARSE_S = 36.0
"""From then on the control rates are fitted."""


def bound_known(time_s: FloatArray) -> FloatArray:
    """Return the Cramér-Rao bound of the heading, deg, where white noise alone matters."""
    return np.asarray(np.degrees(PAPER_RAD_PER_SQRT_S / np.sqrt(time_s) / LEVEL))


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
        information = slopes @ slopes.T * (end - begin_s) / len(t) / PAPER_RAD_PER_SQRT_S**2
        scale = 1.0 / np.sqrt(np.diag(information))
        inverse = np.linalg.inv(information * np.outer(scale, scale)) * np.outer(scale, scale)
        result.append(math.degrees(math.sqrt(inverse[0, 0]) / LEVEL))
    return np.array(result)


def warming_up() -> dict[str, ColumnArray]:
    """Return the columns of both alignments once a second: 15 minutes, heading 0, the paper's gyros."""
    unit = {
        "gyro_noise": {"arw_deg_per_sqrt_h": PAPER_ARW},
        "accel_warm_up": {"amplitude_ug": [AMPLITUDE_UG, AMPLITUDE_UG, 0.0], "tau_s": TAU_S},
    }
    scenario = Scenario.model_validate(
        {
            "format": "imumon-scenario/1",
            "unit": unit,
            "rate_hz": RATE_HZ,
            "duration_s": SECONDS,
            "latitude_deg": LATITUDE_DEG,
            "attitude": {"heading_deg": 0.0},
            "chamber": {"start_degc": 25.0},
        }
    )
    sent, _ = SimulatedUnit(scenario, 1).run(scenario.samples)
    declared = AlignmentParameters(accel_bias_sd_ug=ACCEL_BIAS_UG)
    ours = Alignment(declared, LATITUDE_DEG, "FRD").process(sent)
    theirs = SelfAlignment(Params(math.radians(LATITUDE_DEG))).process(sent)
    each = round(RATE_HZ)
    return {name: values[each - 1 :: each] for name, values in {**ours, **theirs}.items()}


def draw_loop() -> Iterator[Path]:
    """Draw figures 5 and 6: 30 µg, 300 s, 2 Hz, 36°, no noise."""
    loop = Loop()
    course = simulate(loop, 900.0)
    every = slice(20, None, 40)
    t = course.time_s[every]
    (ax,) = figures.axes("Figure 5: tilt made by the warm-up", x="s after power-on", y="µrad")
    for axis, name in enumerate(("east", "north")):
        ax.plot(t, 1e6 * course.tilt[axis, every], label=f"about {name}, simulated")
        sign = np.sign(course.tilt[axis, -1])
        label = "" if axis else "equations 16, 17"
        ax.plot(t, 1e6 * sign * closed_tilt(loop, t), "k:", lw=1.0, label=label)
    yield figures.save([ax], "alignment", "figure-05")
    (ax,) = figures.axes("Figure 6: heading error made by the warm-up", x="s after power-on", y="mrad")
    late = course.time_s >= 5.0
    t, rate = course.time_s[late], -course.control[0, late]
    ax.plot(t, 1e3 * rate / LEVEL, label="instantaneous control rate, simulated")
    ax.plot(t, 1e3 * closed_heading(loop, t), "k:", label="equation 19")
    ax.plot(t, 1e3 * short_heading(loop, t), "r--", lw=0.8, label="equation 22")
    mean = np.cumsum(rate) / np.arange(1, len(rate) + 1)
    ax.plot(t, 1e3 * mean / LEVEL, label="total average from 5 s on")
    yield figures.save([ax], "alignment", "figure-06")


def draw_run() -> Iterator[Path]:
    """Draw figures 7, 8 and 9: 83.7 µg, 150 s, navigation-grade gyros, 15 minutes."""
    out = warming_up()
    t = np.arange(1.0, SECONDS + 1.0)
    upper, lower = figures.axes(
        "Figure 7: control rate about east, and its integral", 2, x="s after power-on"
    )
    rate = out["fixed_gain_loop_control_rate_east"]
    upper.plot(t, np.degrees(rate) * 3600.0, ".", ms=1.5, label="control rate, one sample a second")
    angle, kept = np.cumsum(np.nan_to_num(rate)), np.isfinite(rate)
    lower.plot(t, 1e6 * angle, label="integral")
    line = np.polyval(np.polyfit(t[kept], angle[kept], 1), t[kept])
    lower.plot(t[kept], 1e6 * line, "r--", lw=0.8, label="fitted line")
    upper.set_ylabel("°/h")
    lower.set_ylabel("µrad")
    yield figures.save([upper, lower], "alignment", "figure-07")
    (ax,) = figures.axes("Figure 8: drift of roll and pitch of a unit at rest", x="s after power-on", y="µg")
    for name in ("roll", "pitch"):
        ax.plot(t, 1e6 * out[f"{name}_drift"], label=name.replace("_", " "))
    yield figures.save([ax], "alignment", "figure-08")
    upper, lower = figures.axes("Figure 9: heading error, and the Cramér-Rao bound", 2, x="s after power-on")
    shown = {
        "total_average_heading": "k", "curve_fit_heading": "r", "heading_hann_mean": "m", "heading": "g",
    }  # fmt: skip
    for name, color in shown.items():
        error = np.degrees(np.remainder(out[name] + math.pi, 2.0 * math.pi) - math.pi)
        upper.plot(t, error, color, lw=1.0, label=name.replace("_", " "))
        lower.semilogy(t, np.abs(error), color, lw=0.7, label=f"|error| {name.replace('_', ' ')}")
        if f"{name}_sd" in out:
            lower.semilogy(t, np.degrees(out[f"{name}_sd"]), color + "--", lw=0.8)
    known, free = t[t > 5], t[t > COARSE_S + 30]
    lower.semilogy(known, bound_known(known), "b-", lw=2.0, label="bound, level measured by the gyros")
    bound = bound_free(COARSE_S, free, TAU_S, AMPLITUDE_UG)
    lower.semilogy(free, bound, "c-", lw=2.0, label="bound, control rates alone")
    upper.axhspan(-0.05, 0.05, color="0.9")
    upper.set(ylim=(-0.4, 0.4), ylabel="°")
    lower.set(ylim=(1e-4, 1.0), ylabel="° (dashed: sigma)")
    yield figures.save([upper, lower], "alignment", "figure-09")


def draw(_: Options) -> Iterator[Path]:
    """Draw every figure."""
    yield from draw_loop()
    yield from draw_run()


def tables(_: Options) -> Iterator[Table]:
    """Yield the closed forms beside the loop of imumon."""
    found = comparisons(Loop(gyro_deg_per_h=0.01))
    title = "Largest difference between closed form and simulation: 30 µg, 300 s, 0.01 °/h of gyro bias"
    yield Table(title, ["equation", "of the largest"], [[name, f"{value:.3%}"] for name, value in found])


STUDY = Study(tables, draw=draw)
