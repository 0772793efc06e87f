"""What an alignment came to, as a person reads it."""

from __future__ import annotations

import math

from imumon.estimation.alignment.charting import heading_text
from imumon.estimation.alignment.standing import Standing
from imumon.geodesy import DEG_PER_H

DEG_PER_SQRT_H = math.pi / 180.0 / 60.0
START_S = 10.0
"""It takes the rest detector some seconds to call a unit at rest; that is no disturbance."""


def rows(standing: Standing, wanted_deg: float) -> dict[str, str]:
    """Return label and text: the heading, whether it settled, and what stands in the way."""
    told = {"heading": heading_text(standing), "settled": _settled(standing, wanted_deg)}
    if math.isfinite(standing.roll):
        roll, pitch = math.degrees(standing.roll), math.degrees(standing.pitch)
        told["roll, pitch"] = f"{roll:.4f}°, {pitch:.4f}°"
    if math.isfinite(standing.arw):
        told["gyro"] = (
            f"noise {_short(standing.arw / DEG_PER_SQRT_H)} °/√h, "
            f"σ of a horizontal bias {_short(standing.bias_sd / DEG_PER_H)} °/h"
        )
    undisturbed = f"{standing.time_s:.0f} of {standing.seconds:.0f} s counted after the coarse alignment"
    told["data"] = undisturbed
    if standing.disturbed or standing.shaken_s > START_S:
        told["disturbed"] = (
            f"{standing.shaken_s:.1f} s; {standing.disturbed} times after the coarse alignment, "
            f"{standing.restarts} times it began anew"
        )
    if standing.tilting:
        told["level"] = "the unit is tilting, which the tilt-corrected average does not bear"
    return told


def _settled(standing: Standing, wanted_deg: float) -> str:
    wanted = f"σ ≤ {wanted_deg:g}°"
    if standing.settled_s is not None:
        return f"yes, {standing.settled_s:.1f} s after the first sample ({wanted})"
    if standing.phase == "disturbed":
        return f"no ({wanted}): the unit is disturbed; let it rest"
    if standing.phase in ("waiting", "coarse"):
        return (
            f"no ({wanted}): {standing.coarse_s:.0f} s of rest at the end; the coarse alignment needs "
            f"{standing.coarse_wanted_s:g} s without a break, the fine one more"
        )
    if not standing.observable and standing.chosen is not None:
        return f"no ({wanted}): the earth's horizontal rate here is {standing.earth_rate / DEG_PER_H:.2g} °/h"
    if standing.to_go_s is None:
        return (
            f"no ({wanted}): not in reach with the bias of these gyros"
            if standing.shown
            else f"no ({wanted})"
        )
    return f"no ({wanted}): about {standing.to_go_s:.0f} s more would do"


def estimator_rows(standing: Standing) -> list[tuple[str, str, str]]:
    """Return name, heading and sigma of each estimator in degrees; the one shown is marked."""
    found = []
    for name, estimate in standing.estimates.items():
        mark = " *" if name == standing.chosen and standing.observable else ""
        heading = "-"
        if math.isfinite(estimate.heading):
            heading = f"{math.degrees(estimate.heading) % 360.0:.4f}"
        sd = f"{math.degrees(estimate.sd):.4f}" if math.isfinite(estimate.sd) else "-"
        found.append((name.replace("_", " ") + mark, heading, sd))
    return found


def _short(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
