"""The panels of the live view: which columns are drawn where.

A panel for another estimator is one more entry here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imumon.charts import AXIS_COLORS, BLUE, GREEN, GREY, ORANGE, RED, VIOLET, Color
from imumon.view.bands import Band, band_panel
from imumon.view.layout import (
    LINK,
    Panel,
    attitude,
    from_euler,
    from_wxyz,
    strip,
)

DEG = float(np.rad2deg(1.0))


def _axes(name: str) -> dict[str, str]:
    return {f"{name}_{axis}": axis for axis in "xyz"}


THERMAL = "Temperature"
"""Tab of the temperature estimates."""


def _thermal(suffixes: Mapping[str, Color], readings: str) -> tuple[Panel, Panel]:
    """Return the panels of temperature and rate for sensors whose columns end so, with their colours."""
    key = "".join(suffixes)
    temperature, rate = (
        [
            Band(
                f"temperature_{what}{suffix}", f"temperature_{what}_sd{suffix}", suffix[1:] or "sensor", color
            )
            for suffix, color in suffixes.items()
        ]
        for what in ("estimate", "rate")
    )
    return (
        band_panel(
            f"temperature_estimate{key}",
            THERMAL,
            "Temperature: readings, estimate, 2σ",
            temperature,
            unit="°C",
            beside=readings,
        ),
        band_panel(
            f"temperature_rate{key}", THERMAL, "Temperature rate, 2σ", rate, unit="°C/h", factor=3600.0
        ),
    )


BIAS = "Gyro bias"
"""Tab of the bias estimates."""
PUBLISHED = "SR-RSUKF"
"""Tab of the published filter and what it must be compared with."""
ALIGNMENT = "Alignment"
"""Tab of the heading by the earth rate; its charts stand there, too."""
DEG_PER_HOUR = DEG * 3600.0


def _axis_bands(value: str, sd: str) -> list[Band]:
    return [Band(f"{value}_{axis}", f"{sd}_{axis}", axis, color) for axis, color in AXIS_COLORS.items()]


def _random_error(axis: str, color: Color) -> Panel:
    """Return the panel of one axis: beside the turn-on bias of another its drift could not be seen."""
    return band_panel(
        f"gyro_random_error_{axis}",
        BIAS,
        f"Gyro bias {axis} less the model's curve, 2σ",
        [Band(f"gyro_random_error_{axis}", f"gyro_random_error_sd_{axis}", axis, color)],
        unit="°/h",
        factor=DEG_PER_HOUR,
    )


def _beside_published(axis: str) -> Panel:
    """Return the panel of one axis that shows SR-RSUKF, the default estimate and the plain ones together."""
    return band_panel(
        f"gyro_beside_{axis}",
        PUBLISHED,
        f"Gyro {axis}: SR-RSUKF ({axis}) beside the default, the mean at rest and the held beginning, 2σ",
        [
            Band(f"gyro_drift_{axis}", f"gyro_drift_sd_{axis}", "default", ORANGE),
            Band(f"gyro_rest_mean_{axis}", None, "mean", VIOLET),
            Band(f"gyro_rest_hold_{axis}", None, "hold", GREY),
        ],
        unit="°/h",
        factor=DEG_PER_HOUR,
        beside=f"/view/gyro_random_error_{axis}/**",
    )


PANELS: tuple[Panel, ...] = (
    attitude("attitude", ("q_w", "q_x", "q_y", "q_z"), from_wxyz),
    attitude("attitude_from_angles", ("roll", "pitch", "yaw"), from_euler),
    strip("gyro", "Angular rate", _axes("gyro"), shown=(DEG, "°/s")),
    strip("accel", "Specific force", _axes("accel")),
    strip("mag", "Magnetic field", _axes("mag")),
    strip(
        "angles", "Attitude as reported", {name: name for name in ("roll", "pitch", "yaw")}, shown=(DEG, "°")
    ),
    strip("temperature", "Temperature", {"temperature": "sensor"}, colors=[ORANGE], steps=True),
    strip("temperature_axes", "Temperature", _axes("temperature"), steps=True),
    *_thermal({"": ORANGE}, "/samples/temperature"),
    *_thermal({f"_{axis}": color for axis, color in AXIS_COLORS.items()}, "/samples/temperature_axes"),
    band_panel(
        "gyro_bias",
        BIAS,
        "Gyro bias, 2σ",
        _axis_bands("gyro_bias", "gyro_bias_sd"),
        unit="°/h",
        factor=DEG_PER_HOUR,
    ),
    strip(
        "gyro_corrected",
        "Angular rate: raw and corrected",
        {f"gyro_corrected_{axis}": f"corrected {axis}" for axis in "xyz"},
        colors=[ORANGE, VIOLET, GREY],
        shown=(DEG, "°/s"),
        place=BIAS,
        beside="/view/gyro",
    ),
    strip(
        "zupt_innovation",
        "Zero-velocity innovations over their σ, limits 3σ",
        _axes("zupt_innovation"),
        place=BIAS,
        limits=(-3.0, 3.0),
        sparse=True,
    ),
    *(_random_error(axis, color) for axis, color in AXIS_COLORS.items()),
    *(_beside_published(axis) for axis in "xyz"),
    band_panel(
        "gyro_phi",
        PUBLISHED,
        "φ of SR-RSUKF, 2σ",
        _axis_bands("gyro_phi", "gyro_phi_sd"),
        unit="",
        y_range=(-1.0, 1.0),
    ),
    band_panel(
        "heading",
        ALIGNMENT,
        "Heading from true north, 2σ",
        [
            Band("heading_total_average", "heading_total_average_sd", "average", RED),
            Band("heading_curve_fit", "heading_curve_fit_sd", "curve-fit", ORANGE),
            Band("heading_tilt_corrected", "heading_tilt_corrected_sd", "tilt-corrected", GREEN),
            Band("heading", "heading_sd", "shown", BLUE),
        ],
        unit="°",
        factor=DEG,
    ),
    band_panel(
        "heading_line_exponential",
        ALIGNMENT,
        "Heading by line and exponential, 2σ",
        [Band("heading_line_exponential", "heading_line_exponential_sd", "line-exponential", VIOLET)],
        unit="°",
        factor=DEG,
    ),
    band_panel(
        "heading_magnetic",
        ALIGNMENT,
        "Heading from magnetic north",
        [Band("heading_magnetic", None, "magnetic", GREY)],
        unit="°",
        factor=DEG,
    ),
    band_panel(
        "control_rate",
        ALIGNMENT,
        "Horizontal control rates",
        [Band("control_rate_east", None, "east", RED), Band("control_rate_north", None, "north", BLUE)],
        unit="°/h",
        factor=DEG_PER_HOUR,
    ),
    band_panel(
        "control_angle",
        ALIGNMENT,
        "Integral of the control rates",
        [Band("control_angle_east", None, "east", RED), Band("control_angle_north", None, "north", BLUE)],
        unit="°",
        factor=DEG,
    ),
    band_panel(
        "level",
        ALIGNMENT,
        "Roll and pitch by the alignment",
        [Band("aligned_roll", None, "roll", RED), Band("aligned_pitch", None, "pitch", GREEN)],
        unit="°",
        factor=DEG,
    ),
    band_panel(
        "level_drift",
        ALIGNMENT,
        "Drift of roll and pitch since the coarse alignment",
        [Band("roll_drift", None, "roll", RED), Band("pitch_drift", None, "pitch", GREEN)],
        unit="µg",
        factor=1e6,
    ),
    strip("pressure", "Pressure", {"pressure": "static"}, colors=[VIOLET]),
    strip(
        "packet_rate",
        "Packet rate",
        {"packet_rate": "packets"},
        colors=[BLUE],
        shown=(1.0, "1/s"),
        place=LINK,
        steps=True,
    ),
    strip(
        "link_load",
        "Link load",
        {"link_load": "load"},
        colors=[ORANGE],
        shown=(100.0, "%"),
        place=LINK,
        steps=True,
        y_range=(0.0, 100.0),
    ),
    strip(
        "losses",
        "Packets lost and damaged, so far",
        {"packets_lost": "lost", "packets_damaged": "damaged"},
        colors=[RED, VIOLET],
        place=LINK,
        steps=True,
    ),
)
"""All panels, in the order in which they stand.  Whichever of two attitudes comes first turns the body."""
