"""Sketches of the terms: six ways in which a bias follows the temperature, and the axes of a case."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imumon.blocks import FloatArray

STEP_S, RAMP_S, HOLD_S = 10.0, 1200.0, 600.0
COLD, WARM = 20.0, 50.0
"""°C: a unit is held, warmed, held, cooled and held."""
LAG_S, DEAD_S, HALF_LOOP = 180.0, 180.0, 3.0
WARM_UP_S, WARM_UP = 400.0, 40.0
STEP_AT, STEP_SIZE = 0.35, 30.0
"""Share of the time at which the bias steps, and by how much, °/h."""
ARW, INSTABILITY, WALK = 0.28, 2.33, 2.0
"""Terms of the Allan curve that is drawn: N in °/√h, B in °/h, K in °/h/√h."""


def curve(degc: FloatArray) -> FloatArray:
    """Return the bias over temperature, °/h, (n,)."""
    u = (degc - COLD) / (WARM - COLD)
    return np.asarray(100.0 * u - 60.0 * u**2)


def biases(degc: FloatArray) -> dict[str, FloatArray]:
    """Return the bias of each sketch, °/h, (n,)."""
    late, loop = np.array(degc), np.array(degc)
    for k in range(1, len(degc)):
        late[k] = late[k - 1] + STEP_S / LAG_S * (degc[k] - late[k - 1])
        loop[k] = np.clip(loop[k - 1], degc[k] - HALF_LOOP, degc[k] + HALF_LOOP)
    delay = round(DEAD_S / STEP_S)
    dead = np.concatenate([np.full(delay, degc[0]), degc[:-delay]])
    time_s = STEP_S * np.arange(len(degc))
    return {
        "curve": curve(degc),
        "lag": curve(late),
        "dead time": curve(dead),
        "loop (hysteresis)": curve(loop),
        "warm-up": curve(degc) + WARM_UP * np.exp(-time_s / WARM_UP_S),
        "step": curve(degc) + STEP_SIZE * (np.arange(len(degc)) > STEP_AT * len(degc)),
    }


def biases_over_temperature() -> list[Axes]:
    """Draw the bias over temperature of each sketch, warming and cooling in two colours."""
    ramp, hold = np.linspace(0.0, 1.0, round(RAMP_S / STEP_S)), round(HOLD_S / STEP_S)
    shape = np.concatenate([np.zeros(hold), ramp, np.ones(hold), ramp[::-1], np.zeros(hold)])
    degc = np.asarray(COLD + (WARM - COLD) * shape)
    turned = len(degc) // 2
    figure = Figure(figsize=(9.0, 5.0), dpi=100)
    for panel, (name, bias) in zip(
        figure.subplots(2, 3, sharex=True, sharey=True).flat, biases(degc).items(), strict=True
    ):
        panel.plot(degc[:turned], bias[:turned], color="C3", label="while it warms")
        panel.plot(degc[turned:], bias[turned:], color="C0", linestyle="--", label="while it cools")
        panel.set_title(name)
        panel.grid(alpha=0.3)
    axes = figure.axes
    for panel in axes[3:]:
        panel.set_xlabel("temperature [°C]")
    for panel in axes[::3]:
        panel.set_ylabel("bias [°/h]")
    return figure.axes


def allan_curve() -> list[Axes]:
    """Draw the Allan deviation of a gyro with three terms, and what each part of it means."""
    tau_s = np.geomspace(1.0, 30000.0, 200)
    hours = tau_s / 3600.0
    white, flat, walk = ARW / np.sqrt(hours), 0.664 * INSTABILITY + 0.0 * hours, WALK * np.sqrt(hours / 3.0)
    figure = Figure(figsize=(8.0, 4.6), dpi=100)
    panel = figure.subplots()
    panel.loglog(tau_s, np.sqrt(white**2 + flat**2 + walk**2), color="C0", lw=2.5, label="Allan deviation")
    parts = {
        "angle random walk": (white, "C1"),
        "bias instability": (flat, "C2"),
        "rate random walk": (walk, "C3"),
    }
    for name, (values, color) in parts.items():
        panel.loglog(tau_s, values, color=color, linewidth=1.0, linestyle="--", label=name)
    panel.plot([3600.0], [ARW], "o", color="C1")
    marks = (
        ((6.0, ARW / np.sqrt(6.0 / 3600.0)), (12.0, 18.0), "averaging helps:\nslope −1/2", "C1"),
        ((3600.0, ARW), (5000.0, 0.45), f"at 1 h this line is at\nN = {ARW} °/√h", "C1"),
        (
            (60.0, 0.664 * INSTABILITY),
            (1.5, 0.65),
            f"0.664 B, here B = {INSTABILITY:g} °/h:\nno averaging gets below",
            "C2",
        ),
        (
            (25000.0, WALK * np.sqrt(25000.0 / 3600.0 / 3.0)),
            (1000.0, 5.0),
            "the bias itself walks away:\nslope +1/2",
            "C3",
        ),
    )
    for to, at, text, color in marks:
        panel.annotate(text, to, at, color=color, arrowprops={"arrowstyle": "->", "color": color})
    panel.set(xlabel="averaging time τ [s]", ylabel="Allan deviation [°/h]", ylim=(0.2, 30.0))
    panel.grid(alpha=0.3, which="both")
    return figure.axes


def body_axes() -> list[Axes]:
    """Draw FRD and FLU on a case."""
    figure = Figure(figsize=(8.0, 3.6), dpi=100)
    # A flat box in oblique projection, its front to the upper right.
    forward, side, up = np.array([0.5, 0.25]), np.array([0.4, -0.21]), np.array([0.0, 0.18])
    top = [a * forward + b * side + up for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    bottom = [corner - 2.0 * up for corner in top]
    front, flank = (top[3], top[2], bottom[2], bottom[3]), (top[0], top[3], bottom[3], bottom[0])
    for panel, (name, right, down) in zip(
        figure.subplots(1, 2), (("FRD", 1.0, 1.0), ("FLU", -1.0, -1.0)), strict=True
    ):
        for face, color in ((top, "0.8"), (front, "0.6"), (flank, "0.7")):
            panel.fill(*zip(*face, strict=True), color=color)
        sideways, vertical = ("right", "down") if right > 0 else ("left", "up")
        _arrow(panel, (0.9, 0.45), "x forward", "C3")
        _arrow(panel, (0.75 * right, -0.4 * right), f"y {sideways}", "C2")
        _arrow(panel, (0.0, -0.95 * down), f"z {vertical}", "C0")
        reads = "−9.81" if down > 0 else "+9.81"
        panel.set_title(f"{name}: at rest and level z reads {reads} m/s²")
        panel.set(xlim=(-1.5, 1.9), ylim=(-1.3, 1.3), aspect="equal")
        panel.axis("off")
    return figure.axes


def _arrow(panel: Axes, to: tuple[float, float], text: str, color: str) -> None:
    panel.annotate("", to, (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 2.5})
    panel.text(1.15 * to[0], 1.15 * to[1], text, color=color, ha="center", va="center", fontsize=11)
