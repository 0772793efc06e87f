"""The panels of the live view: which columns are drawn where.

A panel for another estimator is one more entry here.
"""

from __future__ import annotations

from collections.abc import Iterator

from imumon.charts import AXIS_COLORS, BLUE, GREEN, GREY, ORANGE, RED, VIOLET, Color
from imumon.view.attitude import Attitude
from imumon.view.layout import Bands, Line, Strip

Panel = Strip | Attitude

THERMAL = "Temperature"
"""Tab of the temperature estimates."""
BIAS = "Gyro bias"
"""Tab of the bias estimates."""
RESIDUAL = "Residual"
"""Tab of what the bias model leaves over; its chart stands there, too."""
ATTITUDE = "Attitude"
"""Tab of the attitude: what a device reports, and the estimator's, each a strip of its own."""
PRESSURE = "Pressure"
ALIGNMENT = "Alignment"
"""Tab of the heading by the earth rate; its charts stand there, too."""
LINK = "Link"
"""Tab of the port: rates, load, losses."""
METHODS = "Published"
"""Tab of the published methods that `--published` chooses, each beside the default."""
LEAST_DEGC = 0.04
"""The axis of a reading spans so much at least: four steps of the last digit of the card."""


def _with_sd(column: str, name: str, color: Color) -> Line:
    """Return an estimate with its standard deviation: ``_sd`` stands before the axis in its column's name."""
    quantity, _, axis = column.rpartition("_")
    return Line(column, name, color, f"{quantity}_sd_{axis}" if axis in AXIS_COLORS else f"{column}_sd")


def _axes(name: str) -> tuple[Line, ...]:
    return tuple(Line(f"{name}_{axis}", axis, color) for axis, color in AXIS_COLORS.items())


def _axes_with_sd(name: str) -> tuple[Line, ...]:
    return tuple(_with_sd(f"{name}_{axis}", axis, color) for axis, color in AXIS_COLORS.items())


def _thermal(suffixes: dict[str, Color], readings: str) -> Iterator[Panel]:
    """Yield the panels of temperature and rate for sensors whose columns end so, with their colours."""
    rows = (
        ("temperature_estimate", "Temperature, readings and 2σ", "°C", readings),
        ("temperature_rate", "Temperature rate, 2σ", "°C/h", None),
    )
    for name, title, unit, beside in rows:
        lines = tuple(_with_sd(name + end, end[1:] or "sensor", color) for end, color in suffixes.items())
        card = "temperature rate" if unit == "°C/h" else "temperature"
        yield Bands(name + "".join(suffixes), title, lines, unit, THERMAL, beside=beside, card=card)


def _published(
    method: str, quantity: str, title: str, unit: str, default: str, line: str = "", color: Color = VIOLET
) -> Panel:
    """Return the panel of a quantity by a published method, with the entity of the default beside.

    A `line` is named, and its value has no sigma; otherwise the method's name stands there, in a 2σ band.
    """
    column, text = f"{method}_{quantity}", f"{title} ({method}) beside the default"
    drawn = Line(column, line, color) if line else _with_sd(column, method, color)
    text = text if line else f"{text}, 2σ"
    return Bands(column, text, (drawn,), unit, METHODS, beside=f"/view/{default}/**")


def _published_temperature(suffix: str, default: str) -> Iterator[Panel]:
    """Yield the panels of the FIR filter for the channel with this ending."""
    for name, title, unit in (
        ("temperature_estimate", "Temperature", "°C"),
        ("temperature_rate", "Temperature rate", "°C/h"),
    ):
        yield _published("fir", name + suffix, title + suffix.replace("_", " "), unit, name + default)


PANELS: tuple[Panel, ...] = (
    Attitude("attitude", ("q_w", "q_x", "q_y", "q_z")),
    Attitude("attitude_from_angles", ("roll", "pitch", "yaw")),
    Attitude(
        "attitude_estimate",
        tuple(f"attitude_estimate_{part}" for part in "wxyz"),
        "/attitude_estimate",
        "Attitude by the estimator",
        ("east", "north", "up"),
        up=1.0,
    ),
    Strip("gyro", "Angular rate", _axes("gyro"), "°/s", card="angular rate"),
    Strip("accel", "Specific force", _axes("accel"), card="specific force"),
    Strip("mag", "Magnetic field", _axes("mag"), card="magnetic field"),
    Strip(
        "angles",
        "Attitude as reported",
        (Line("roll", "roll", RED), Line("pitch", "pitch", GREEN), Line("yaw", "yaw", BLUE)),
        "°",
        ATTITUDE,
        card="reported",
    ),
    Strip(
        "temperature",
        "Temperature",
        (Line("temperature", "sensor", ORANGE),),
        look="steps",
        least=LEAST_DEGC,
        card="temperature read",
    ),
    Strip(
        "temperature_axes",
        "Temperature",
        _axes("temperature"),
        look="steps",
        least=LEAST_DEGC,
        card="temperature read",
    ),
    *_thermal({"": ORANGE}, "/samples/temperature"),
    *_thermal({f"_{axis}": color for axis, color in AXIS_COLORS.items()}, "/samples/temperature_axes"),
    Bands("gyro_bias", "Gyro bias, 2σ", _axes_with_sd("gyro_bias"), "°/h", BIAS, card="gyro bias"),
    Bands(
        "gyro_bias_smoothed",
        "Gyro bias with what came later, 2σ",
        _axes_with_sd("gyro_bias_smoothed"),
        "°/h",
        BIAS,
        card="gyro bias, smoothed",
    ),
    Strip(
        "gyro_corrected",
        "Angular rate, raw and corrected",
        tuple(
            Line(f"gyro_corrected_{axis}", f"{axis} corrected", color)
            for axis, color in zip("xyz", (ORANGE, VIOLET, GREY), strict=True)
        ),
        "°/s",
        BIAS,
        beside="/view/gyro",
    ),
    Strip(
        "zupt_innovation",
        "Zero-velocity innovations over their σ, limits 3σ",
        _axes("zupt_innovation"),
        place=BIAS,
        look="points",
        limits=(-3.0, 3.0),
    ),
    Strip(
        "turn_hypothesis",
        "Not decided, turn or change of the bias",
        _axes("turn_hypothesis"),
        "°/h",
        BIAS,
        look="steps",
        silent=0.0,
    ),
    Bands(
        "attitude_estimate_level",
        "Roll and pitch by the estimator, 2σ",
        tuple(
            Line(f"attitude_estimate_{name}", name, color, "attitude_estimate_tilt_sd")
            for name, color in (("roll", RED), ("pitch", GREEN))
        ),
        "°",
        ATTITUDE,
        card="estimated",
    ),
    Bands(
        "attitude_estimate_heading",
        "Heading by the estimator, from magnetic north or free, 2σ",
        (_with_sd("attitude_estimate_heading", "heading", BLUE),),
        "°",
        ATTITUDE,
        card="estimated heading",
    ),
    # A panel for each axis: beside the turn-on bias of another its drift could not be seen.
    *(
        Bands(
            line.column,
            f"Gyro bias {line.name} less the model's curve (all of it without a model), 2σ",
            (line,),
            "°/h",
            RESIDUAL,
            card="bias less model",
        )
        for line in _axes_with_sd("gyro_random_error")
    ),
    Bands(
        "heading",
        "Heading from true north, 2σ",
        (
            _with_sd("heading_gyro_mean", "gyro-mean", RED),
            _with_sd("heading_hann_mean", "Hann-mean", ORANGE),
            _with_sd("heading", "shown", BLUE),
        ),
        "°",
        ALIGNMENT,
        card="heading by",
        headline=True,
    ),
    Bands(
        "heading_smoothed",
        "Heading with what came later, 2σ",
        (_with_sd("heading_smoothed", "smoothed", VIOLET),),
        "°",
        ALIGNMENT,
        card="heading, smoothed",
    ),
    Bands(
        "heading_magnetic",
        "Heading from magnetic north",
        (Line("heading_magnetic", "magnetic", VIOLET),),
        "°",
        ALIGNMENT,
        card="magnetic heading",
    ),
    Bands(
        "level",
        "Roll and pitch by the alignment",
        (Line("aligned_roll", "roll", RED), Line("aligned_pitch", "pitch", GREEN)),
        "°",
        ALIGNMENT,
        card="level",
    ),
    Bands(
        "level_drift",
        "Drift of roll and pitch since the first rest",
        (Line("roll_drift", "roll", RED), Line("pitch_drift", "pitch", GREEN)),
        "µg",
        ALIGNMENT,
    ),
    *_published_temperature("", ""),
    *(panel for axis in "xyz" for panel in _published_temperature(f"_{axis}", "_x_y_z")),
    *(
        _published(
            method,
            f"random_error_{axis}",
            f"Random error {axis}",
            "°/h",
            f"gyro_random_error_{axis}",
            color=color,
        )
        for method in ("stf", "sr_ukf", "sr_rsukf")
        for axis, color in AXIS_COLORS.items()
    ),
    *(
        Bands(
            f"{method}_phi",
            f"φ ({method}), 2σ",
            _axes_with_sd(f"{method}_phi"),
            "",
            METHODS,
        )
        for method in ("sr_ukf", "sr_rsukf")
    ),
    *(
        _published(method, f"gyro_bias_{axis}", f"Gyro bias {axis}", "°/h", "gyro_bias", color=color)
        for method in ("dense_zupt", "dense_tczupt")
        for axis, color in AXIS_COLORS.items()
    ),
    *(
        _published(method, "heading", "Heading", "°", "heading", line, color)
        for method, line, color in (
            ("fixed_gain_loop", "now", GREY),
            ("total_average", "average", RED),
            ("curve_fit", "curve-fit", ORANGE),
        )
    ),
    Bands(
        "fixed_gain_loop_control_rate",
        "Horizontal control rates (fixed_gain_loop)",
        (
            Line("fixed_gain_loop_control_rate_east", "east", RED),
            Line("fixed_gain_loop_control_rate_north", "north", BLUE),
        ),
        "°/h",
        METHODS,
    ),
    *(
        Bands(
            f"gyro_rest_{axis}",
            f"Gyro {axis}: exponential mean at rest, and the beginning held",
            (Line(f"gyro_rest_mean_{axis}", "mean", VIOLET), Line(f"gyro_rest_hold_{axis}", "hold", GREY)),
            "°/h",
            METHODS,
        )
        for axis in "xyz"
    ),
    Strip("pressure", "Pressure", (Line("pressure", "static", VIOLET),), place=PRESSURE, card="pressure"),
    Strip(
        "packet_rate",
        "Packet rate",
        (Line("packet_rate", "packets", BLUE),),
        "1/s",
        LINK,
        "steps",
        least=4.0,  # a count over 2 s is known to half a packet a second
        card="packets",
    ),
    Strip(
        "link_load", "Link load", (Line("link_load", "load", ORANGE),), "%", LINK, "steps", card="link load"
    ),
    Strip(
        "losses",
        "Packets so far",
        (Line("packets_lost", "lost", RED), Line("packets_damaged", "damaged", VIOLET)),
        place=LINK,
        look="steps",
        least=4.0,  # whole packets
    ),
)
"""All panels, in the order in which they stand.  The attitude that comes first turns the body."""
