"""The result of an alignment as text."""

from __future__ import annotations

import math

from imumon.estimation.alignment.charting import heading_text
from imumon.estimation.alignment.status import Status
from imumon.geodesy import DEG_PER_H, EARTH_RATE

DEG_PER_SQRT_H = math.pi / 180.0 / 60.0
START_S = 10.0
"""Time at the start that is not reported as a disturbance: the rest detector takes some seconds."""


def rows(status: Status) -> dict[str, str]:
    """Return texts by label: the heading, whether it settled, and the conditions that limit it."""
    texts = {"heading": heading_text(status), "settled": _settled(status)}
    if math.isfinite(status.roll):
        roll, pitch = math.degrees(status.roll), math.degrees(status.pitch)
        texts["roll, pitch"] = f"{roll:.4f}°, {pitch:.4f}°"
    if math.isfinite(status.arw):
        texts["gyro"] = (
            f"noise {_short(status.arw / DEG_PER_SQRT_H)} °/√h, "
            f"σ of a horizontal bias {_short(status.level_bias_sd / DEG_PER_H)} °/h"
        )
    if status.shown is not None and status.observable and not status.bias_declared and status.positions == 1:
        holds = status.shown.sd * status.horizontal_earth_rate / DEG_PER_H
        texts["condition"] = (
            "the gyros' turn-on bias is not declared: sigma is right only if the bias of the gyro that "
            f"points east is below {_short(holds)} °/h, which turns the heading by one sigma; declare it "
            "(gyro_bias_sd_deg_per_h), or measure it with --positions 2"
        )
    if status.shown is not None and status.observable and status.positions == 1:
        per_g = math.sqrt(max((EARTH_RATE / status.horizontal_earth_rate) ** 2 - 1.0, 0.0))  # tan L
        texts["accelerometers"] = (
            f"1 mg of bias of the one that points east turns the heading by "
            f"{_short(math.degrees(1e-3 * per_g))}°; sigma has it for "
            f"{_short(1e3 * status.accel_bias_sd)} mg (accel_bias_sd_ug)"
        )
    texts["data"] = f"{min(status.rest_s, status.elapsed_s):.0f} of {status.elapsed_s:.0f} s counted"
    if status.positions > 1:
        texts["positions"] = f"{status.positions}, the last turned by {math.degrees(status.turned):.1f}°"
    if status.disturbances or status.disturbed_s > START_S:
        texts["disturbed"] = (
            f"{status.disturbed_s:.1f} s; {status.disturbances} times, {status.restarts} times it began anew"
        )
    if status.tilt_probability > 0.5:
        texts["level"] = (
            f"the unit is tilting (probability {status.tilt_probability:.2f}); its sigma allows for that"
        )
    return texts


def _settled(status: Status) -> str:
    wanted = f"σ ≤ {math.degrees(status.wanted_sd):g}°"
    if status.settled_s is not None:
        return f"yes, {status.settled_s:.1f} s after the first sample ({wanted})"
    if status.phase == "disturbed":
        return f"no ({wanted}): the unit is disturbed; let it rest"
    if status.phase in ("waiting", "coarse"):
        return f"no ({wanted}): {status.rest_s:.0f} s of rest do not tell a heading"
    if not status.observable and status.estimator is not None:
        rate = status.horizontal_earth_rate / DEG_PER_H
        return f"no ({wanted}): the earth's horizontal rate here is {rate:.2g} °/h"
    if status.remaining_s is None:
        return (
            f"no ({wanted}): not in reach with the bias of these gyros" if status.shown else f"no ({wanted})"
        )
    return f"no ({wanted}): about {status.remaining_s:.0f} s more would do"


def estimator_rows(status: Status) -> list[tuple[str, str, str]]:
    """Return name, heading and sigma of each estimator in degrees; the one shown is marked."""
    found = []
    for name, estimate in status.estimates.items():
        mark = " *" if name == status.estimator and status.observable else ""
        heading = "-"
        if estimate.known and math.isfinite(estimate.heading):
            heading = f"{math.degrees(estimate.heading) % 360.0:.4f}"
        sd = f"{math.degrees(estimate.sd):.4f}" if estimate.known else "not known"
        found.append((name.replace("_", " ") + mark, heading, sd))
    return found


def _short(value: float) -> str:
    return f"{float(f'{value:.2g}'):g}"
