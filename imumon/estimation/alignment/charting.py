"""Charts of the alignment."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.charts import GREEN, GREY, ORANGE, RED, Axis, Chart, Curve
from imumon.estimation.alignment.status import Status

PLACE = "Alignment"
ESTIMATOR_COLORS = {"joint": GREEN, "gyro_mean": RED, "hann_mean": ORANGE}


def heading_text(status: Status) -> str:
    """Return the heading with its sigma, or the reason why there is none and what is shown instead."""
    if status.shown is None:
        return "no heading yet"
    if not status.observable:
        name, angle = status.substitute
        other = f"; shown instead: {name}" + (f" {_turn(angle):.1f}°" if math.isfinite(angle) else "")
        return "heading not observable with this gyro" + other
    sd = math.degrees(status.shown.sd)
    if math.isnan(status.shown.heading):
        return f"no heading yet: σ {sd:.1f}°"
    return f"{_turn(status.shown.heading):.3f}° ± {sd:.3f}°"


def _turn(angle: float) -> float:
    return math.degrees(angle) % 360.0


def to_go_text(status: Status) -> str:
    """Return the predicted time to the wanted sigma."""
    wanted = f"{math.degrees(status.wanted_sd):g}°"
    if status.phase in ("settled", "disturbed"):
        return status.phase
    if status.phase in ("coarse", "waiting") or status.shown is None:
        return f"coarse, {status.rest_s:.0f} s of rest"
    if status.remaining_s is None:
        return f"{wanted} not in reach"
    return f"about {status.remaining_s:.0f} s to {wanted}"


def headings(status: Status) -> Chart:
    """Return all estimators with their 2σ, as differences from the heading that is shown."""
    curves = []
    reference = status.shown.heading if status.shown is not None else math.nan
    names = tuple(name.replace("_", " ") for name in status.estimates)
    for k, (name, (key, estimate)) in enumerate(zip(names, status.estimates.items(), strict=True)):
        off = math.degrees(math.remainder(estimate.heading - reference, 2.0 * math.pi))
        reach = 2.0 * math.degrees(estimate.sd)
        x, y = (
            np.array([k, k, np.nan, k - 0.1, k + 0.1]),
            np.array([off - reach, off + reach, np.nan, off, off]),
        )
        curves.append(Curve(name, x, y, ESTIMATOR_COLORS[key], width=3.0, listed=False))
    x_axis, y_axis = Axis("estimator", names=names), Axis("heading less the one shown [°]")
    return Chart(
        "alignment_headings",
        PLACE,
        "Headings of all estimators, 2σ",
        x_axis,
        y_axis,
        tuple(curves),
        headline=heading_text(status),
    )


def progress(status: Status, time_s: FloatArray, sd: FloatArray) -> Chart:
    """Return the sigma of the heading against time at rest, and the wanted sigma."""
    ends = np.array([max(float(time_s[0]), 1.0), max(float(time_s[-1]), 10.0)])
    curves = (
        Curve("σ", time_s, np.degrees(sd), GREEN, width=2.0),
        Curve("wanted", ends, np.full(2, math.degrees(status.wanted_sd)), GREY),
    )
    x, y = Axis("observed time [s]", log=True), Axis("σ [°]", log=True)
    text = to_go_text(status)
    return Chart("alignment_progress", PLACE, "Sigma of the heading shown", x, y, curves, headline=text)
