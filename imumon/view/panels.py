"""The panels of the live view: which columns are drawn where.

A panel for another estimator is one more entry here.
"""

from __future__ import annotations

from collections.abc import Iterator

from imumon.charts import AXIS_COLORS, BLUE, GREEN, GREY, ORANGE, RED, VIOLET, Color
from imumon.view.bands import Band, band_panel, with_sd
from imumon.view.layout import EARTH, LINK, Panel, attitude, from_euler, from_wxyz, strip

THERMAL = "Temperature"
"""Tab of the temperature estimates."""
BIAS = "Gyro bias"
"""Tab of the bias estimates."""
ATTITUDE = "Attitude"
"""Tab of the attitude by the estimator, apart from what a device reports."""
PUBLISHED = "SR-RSUKF"
"""Tab of the published filter and what it must be compared with."""
ALIGNMENT = "Alignment"
"""Tab of the heading by the earth rate; its charts stand there, too."""
METHODS = "Published"
"""Tab of the published methods that `--published` chooses, each beside the default."""


def _axes(name: str) -> dict[str, str]:
    return {f"{name}_{axis}": axis for axis in "xyz"}


def _axis_bands(name: str) -> list[Band]:
    return [with_sd(f"{name}_{axis}", axis, color) for axis, color in AXIS_COLORS.items()]


def _north_and_east(name: str) -> list[Band]:
    return [Band(f"{name}_east", "east", RED), Band(f"{name}_north", "north", BLUE)]


def _means_at_rest(axis: str) -> list[Band]:
    return [Band(f"gyro_rest_mean_{axis}", "mean", VIOLET), Band(f"gyro_rest_hold_{axis}", "hold", GREY)]


def _thermal(suffixes: dict[str, Color], readings: str) -> Iterator[Panel]:
    """Yield the panels of temperature and rate for sensors whose columns end so, with their colours."""
    rows = (
        ("temperature_estimate", "Temperature: readings, estimate, 2σ", "°C", readings),
        ("temperature_rate", "Temperature rate, 2σ", "°C/h", None),
    )
    for name, title, unit, beside in rows:
        bands = [with_sd(name + suffix, suffix[1:] or "sensor", color) for suffix, color in suffixes.items()]
        yield band_panel(name + "".join(suffixes), THERMAL, title, bands, unit, beside=beside)


def _published_temperature(suffix: str, default: str) -> Iterator[Panel]:
    """Yield the panels of the FIR filter for the channel with this ending."""
    rows = (("temperature_estimate", "Temperature", "°C"), ("temperature_rate", "Temperature rate", "°C/h"))
    for name, title, unit in rows:
        column = f"fir_{name}{suffix}"
        title = f"{title}{suffix.replace('_', ' ')} (fir) beside the default, 2σ"
        beside = f"/view/{name}{default}/**"
        yield band_panel(column, METHODS, title, [with_sd(column, "fir", VIOLET)], unit, beside=beside)


def _published_gyro(method: str, title: str, quantity: str, default: str) -> Iterator[Panel]:
    """Yield the panels of a method, one for each gyro, with the entity of the default beside."""
    for axis, color in AXIS_COLORS.items():
        column = f"{method}_{quantity}_{axis}"
        bands = [with_sd(column, method, color)]
        beside = f"/view/{default.format(axis=axis)}/**"
        text = f"{title} {axis} ({method}) beside the default, 2σ"
        yield band_panel(column, METHODS, text, bands, "°/h", beside=beside)


def _published_heading(method: str, name: str, color: Color) -> Panel:
    """Return the panel of a heading without a sigma."""
    column, title = f"{method}_heading", f"Heading ({method}) beside the default"
    return band_panel(column, METHODS, title, [Band(column, name, color)], "°", beside="/view/heading/**")


PANELS: tuple[Panel, ...] = (
    attitude("attitude", ("q_w", "q_x", "q_y", "q_z"), from_wxyz),
    attitude("attitude_from_angles", ("roll", "pitch", "yaw"), from_euler),
    attitude("attitude_estimate", tuple(f"attitude_estimate_{part}" for part in "wxyz"), from_wxyz, EARTH),
    strip("gyro", "Angular rate", _axes("gyro"), shown="°/s"),
    strip("accel", "Specific force", _axes("accel")),
    strip("mag", "Magnetic field", _axes("mag")),
    strip("angles", "Attitude as reported", {name: name for name in ("roll", "pitch", "yaw")}, shown="°"),
    strip("temperature", "Temperature", {"temperature": "sensor"}, colors=[ORANGE], steps=True),
    strip("temperature_axes", "Temperature", _axes("temperature"), steps=True),
    *_thermal({"": ORANGE}, "/samples/temperature"),
    *_thermal({f"_{axis}": color for axis, color in AXIS_COLORS.items()}, "/samples/temperature_axes"),
    band_panel("gyro_bias", BIAS, "Gyro bias, 2σ", _axis_bands("gyro_bias"), "°/h"),
    band_panel(
        "gyro_bias_smoothed",
        BIAS,
        "Gyro bias with what came later, 2σ",
        _axis_bands("gyro_bias_smoothed"),
        "°/h",
    ),
    strip(
        "gyro_corrected",
        "Angular rate: raw and corrected",
        {f"gyro_corrected_{axis}": f"corrected {axis}" for axis in "xyz"},
        colors=[ORANGE, VIOLET, GREY],
        shown="°/s",
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
    band_panel(
        "attitude_estimate_level",
        ATTITUDE,
        "Roll and pitch by the estimator, 2σ",
        [
            Band(f"attitude_estimate_{name}", name, color, "attitude_estimate_tilt_sd")
            for name, color in (("roll", RED), ("pitch", GREEN))
        ],
        "°",
    ),
    band_panel(
        "attitude_estimate_heading",
        ATTITUDE,
        "Heading by the estimator, from magnetic north or free, 2σ",
        [with_sd("attitude_estimate_heading", "heading", BLUE)],
        "°",
    ),
    # A panel for each axis: beside the turn-on bias of another its drift could not be seen.
    *(
        band_panel(band.value, BIAS, f"Gyro bias {band.name} less the model's curve, 2σ", [band], "°/h")
        for band in _axis_bands("gyro_random_error")
    ),
    *(
        band_panel(
            f"gyro_beside_{axis}",
            PUBLISHED,
            f"Gyro {axis}: SR-RSUKF ({axis}) beside the default, the mean at rest and the held beginning, 2σ",
            [with_sd(f"gyro_drift_{axis}", "default", ORANGE), *_means_at_rest(axis)],
            "°/h",
            beside=f"/view/gyro_random_error_{axis}/**",
        )
        for axis in "xyz"
    ),
    band_panel("gyro_phi", PUBLISHED, "φ of SR-RSUKF, 2σ", _axis_bands("gyro_phi"), "", y_range=(-1.0, 1.0)),
    band_panel(
        "heading",
        ALIGNMENT,
        "Heading from true north, 2σ",
        [
            with_sd("heading_gyro_mean", "gyro-mean", RED),
            with_sd("heading_hann_mean", "Hann-mean", ORANGE),
            with_sd("heading", "shown", BLUE),
        ],
        "°",
    ),
    band_panel(
        "heading_magnetic",
        ALIGNMENT,
        "Heading from magnetic north",
        [Band("heading_magnetic", "magnetic", GREY)],
        "°",
    ),
    band_panel(
        "level",
        ALIGNMENT,
        "Roll and pitch by the alignment",
        [Band("aligned_roll", "roll", RED), Band("aligned_pitch", "pitch", GREEN)],
        "°",
    ),
    band_panel(
        "level_drift",
        ALIGNMENT,
        "Drift of roll and pitch since the first rest",
        [Band("roll_drift", "roll", RED), Band("pitch_drift", "pitch", GREEN)],
        "µg",
    ),
    *_published_temperature("", ""),
    *(panel for axis in "xyz" for panel in _published_temperature(f"_{axis}", "_x_y_z")),
    *_published_gyro("stf", "Random error", "random_error", "gyro_random_error_{axis}"),
    *_published_gyro("sr_ukf", "Random error", "random_error", "gyro_random_error_{axis}"),
    *_published_gyro("sr_rsukf", "Random error", "random_error", "gyro_random_error_{axis}"),
    *(
        band_panel(name, METHODS, f"φ ({method}), 2σ", _axis_bands(name), "", y_range=(-1.0, 1.0))
        for method in ("sr_ukf", "sr_rsukf")
        for name in [f"{method}_phi"]
    ),
    *_published_gyro("dense_zupt", "Gyro bias", "gyro_bias", "gyro_bias"),
    *_published_gyro("dense_tczupt", "Gyro bias", "gyro_bias", "gyro_bias"),
    _published_heading("fixed_gain_loop", "now", GREY),
    _published_heading("total_average", "average", RED),
    _published_heading("curve_fit", "curve-fit", ORANGE),
    band_panel(
        "fixed_gain_loop_control_rate",
        METHODS,
        "Horizontal control rates (fixed_gain_loop)",
        _north_and_east("fixed_gain_loop_control_rate"),
        "°/h",
    ),
    *(
        band_panel(
            f"gyro_rest_{axis}",
            METHODS,
            f"Gyro {axis}: exponential mean at rest, and the beginning held",
            _means_at_rest(axis),
            "°/h",
        )
        for axis in "xyz"
    ),
    strip("pressure", "Pressure", {"pressure": "static"}, colors=[VIOLET]),
    strip(
        "packet_rate",
        "Packet rate",
        {"packet_rate": "packets"},
        colors=[BLUE],
        shown="1/s",
        place=LINK,
        steps=True,
    ),
    strip(
        "link_load",
        "Link load",
        {"link_load": "load"},
        colors=[ORANGE],
        shown="%",
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
"""All panels, in the order in which they stand.  The attitude that comes first turns the body."""
