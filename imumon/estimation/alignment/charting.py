"""Charts of the alignment; what changes is told by the labels of the axes, for titles stand for ever."""

from __future__ import annotations

import math

import numpy as np

from imumon.blocks import FloatArray
from imumon.charts import BLUE, GREEN, GREY, ORANGE, RED, VIOLET, Axis, Chart, Curve
from imumon.estimation.alignment.standing import Standing, instead

PLACE = "Alignment"
ESTIMATOR_COLORS = {
    "total_average": RED,
    "curve_fit": ORANGE,
    "line_exponential": VIOLET,
    "tilt_corrected": GREEN,
    "known_warm_up": BLUE,
}
_AXES = (("east", RED), ("north", BLUE))


def heading_text(standing: Standing) -> str:
    """Return the heading with its sigma in a line, or why there is none and what is shown instead."""
    if standing.shown is None:
        return "no heading yet"
    if not standing.observable:
        name, angle = instead(standing)
        other = f"; shown instead: {name}" + (f" {_turn(angle):.1f}°" if math.isfinite(angle) else "")
        return "heading not observable with this gyro" + other
    sd = math.degrees(standing.shown.sd)
    if math.isnan(standing.shown.heading):
        return f"no heading yet: σ {sd:.1f}°"
    by = (standing.chosen or "").replace("_", " ")
    return f"{_turn(standing.shown.heading):.3f}° ± {sd:.3f}° ({by})"


def _turn(angle: float) -> float:
    return math.degrees(angle) % 360.0


def to_go_text(standing: Standing, wanted_deg: float) -> str:
    """Return how far it is to the sigma wanted."""
    if standing.phase in ("settled", "disturbed"):
        return standing.phase
    if standing.phase in ("coarse", "waiting"):
        return f"{standing.coarse_s:.0f} of {standing.coarse_wanted_s:g} s of coarse alignment"
    if standing.shown is None:
        return "the loop settles"
    if standing.to_go_s is None:
        return f"{wanted_deg:g}° not in reach"
    return f"about {standing.to_go_s:.0f} s to {wanted_deg:g}°"


def headings(standing: Standing) -> Chart:
    """Return all estimators with their 2σ, as differences from the heading that is shown."""
    curves = []
    reference = standing.shown.heading if standing.shown is not None else math.nan
    for k, (name, estimate) in enumerate(standing.estimates.items(), 1):
        off = math.degrees(math.remainder(estimate.heading - reference, 2.0 * math.pi))
        reach = 2.0 * math.degrees(estimate.sd)
        x, y = (
            np.array([k, k, np.nan, k - 0.1, k + 0.1]),
            np.array([off - reach, off + reach, np.nan, off, off]),
        )
        curves.append(Curve(name.replace("_", " "), x, y, ESTIMATOR_COLORS[name], width=3.0))
    x_axis, y_axis = Axis(f"estimator · {heading_text(standing)}"), Axis("heading less the one shown [°]")
    return Chart("alignment_headings", PLACE, "Headings of all estimators, 2σ", x_axis, y_axis, tuple(curves))


def progress(standing: Standing, time_s: FloatArray, sd: FloatArray, wanted_deg: float) -> Chart:
    """Return the sigma of the heading shown over observed time, and the sigma wanted."""
    ends = np.array([max(float(time_s[0]), 1.0), max(float(time_s[-1]), 10.0)])
    curves = (
        Curve("σ", time_s, np.degrees(sd), GREEN, width=2.0),
        Curve("wanted", ends, np.full(2, wanted_deg), GREY),
    )
    x, y = Axis(f"observed time [s] · {to_go_text(standing, wanted_deg)}", log=True), Axis("σ [°]", log=True)
    return Chart("alignment_progress", PLACE, "Sigma of the heading shown", x, y, curves)


def integrals(time_s: FloatArray, angles: FloatArray, line: FloatArray) -> Chart:
    """Return the integrated control rates, (n, 2) rad, with the lines fitted; `line` is the state's."""
    curves = []
    spread = line[0] * line[2] - line[1] ** 2
    ends = time_s[[0, -1]]
    for axis, (name, color) in enumerate(_AXES):
        curves.append(Curve(name, time_s, 1e6 * angles[:, axis], color, points=True, width=3.0))
        slope = (line[0] * line[5 + axis] - line[1] * line[3 + axis]) / spread if spread > 0.0 else math.nan
        start = (line[3 + axis] - slope * line[1]) / line[0] if spread > 0.0 else math.nan
        curves.append(Curve(f"line {name}", ends, 1e6 * (start + slope * ends), color))
    x, y = Axis("observed time [s]"), Axis("angle [µrad]")
    title = "Integrated control rates, with their lines"
    return Chart("alignment_integral", PLACE, title, x, y, tuple(curves))
