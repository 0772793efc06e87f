"""The panels of the live view: which columns are drawn where.

A panel for another estimator is one more entry here.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from imumon.charts import AXIS_COLORS, BLUE, GREEN, GREY, ORANGE, RED, VIOLET, Color
from imumon.view.layout import Attitude, Bands, Line, Strip

Panel = Strip | Attitude

THERMAL, BIAS, RESIDUAL = "Temperature", "Gyro bias", "Residual"
ATTITUDE, PRESSURE, ALIGNMENT, LINK = "Attitude", "Pressure", "Alignment", "Link"
METHODS = "Published"
"""Tabs: the last is that of the methods that `--published` chooses, each beside the default."""
LEAST_DEGC = 0.04
"""The axis of a reading spans so much at least: four steps of the last digit of the card."""
TILT = {"roll": RED, "pitch": GREEN}
CORRECTED = dict(zip("xyz", (ORANGE, VIOLET, GREY), strict=True))
"""Colours of roll and pitch, and of axes that stand beside others."""


def _lines(
    column: str, parts: Mapping[str, Color] = AXIS_COLORS, name: str = "{}", sd: str | None = None
) -> tuple[Line, ...]:
    """Return a line for each part of a quantity, whose name stands for ``{}`` in those of column and line."""
    return tuple(Line(column.format(part), name.format(part), color, sd) for part, color in parts.items())


def _estimate(column: str, name: str, color: Color) -> Line:
    """Return an estimate with its standard deviation: ``_sd`` stands before the axis in its column's name."""
    quantity, _, axis = column.rpartition("_")
    return Line(column, name, color, f"{quantity}_sd_{axis}" if axis in AXIS_COLORS else f"{column}_sd")


def _estimates(quantity: str) -> tuple[Line, ...]:
    return tuple(_estimate(f"{quantity}_{axis}", axis, color) for axis, color in AXIS_COLORS.items())


def _thermal(suffixes: Mapping[str, Color], readings: str) -> Iterator[Panel]:
    """Yield the panels of temperature and rate for sensors whose columns end so, with their colours."""
    for name, title, unit, beside, card in (
        ("temperature_estimate", "Temperature, readings and 2σ", "°C", readings, "temperature"),
        ("temperature_rate", "Temperature rate, 2σ", "°C/h", None, "temperature rate"),
    ):
        lines = tuple(_estimate(name + end, end[1:] or "sensor", color) for end, color in suffixes.items())
        yield Bands(name + "".join(suffixes), title, lines, unit, THERMAL, beside=beside, card=card)


def _published(
    method: str, quantity: str, title: str, unit: str, default: str, color: Color = VIOLET, line: str = ""
) -> Panel:
    """Return the panel of a quantity by a published method, with the entity of the default beside.

    A `line` is named, and its value has no sigma; otherwise the method's name stands there, in a 2σ band.
    """
    column, text = f"{method}_{quantity}", f"{title} ({method}) beside the default"
    drawn = Line(column, line, color) if line else _estimate(column, method, color)
    text = text if line else f"{text}, 2σ"
    return Bands(column, text, (drawn,), unit, METHODS, beside=f"/view/{default}/**")


def _methods() -> Iterator[Panel]:
    """Yield the panels of the published methods."""
    for suffix, default in (("", ""), *((f"_{axis}", "_x_y_z") for axis in "xyz")):
        for name, title, unit in (
            ("temperature_estimate", "Temperature", "°C"),
            ("temperature_rate", "Temperature rate", "°C/h"),
        ):
            text = title + suffix.replace("_", " ")
            yield _published("fir", name + suffix, text, unit, name + default)
    for method in ("stf", "sr_ukf", "sr_rsukf"):
        for axis, color in AXIS_COLORS.items():
            name, default = f"random_error_{axis}", f"gyro_random_error_{axis}"
            yield _published(method, name, f"Random error {axis}", "°/h", default, color)
    for method in ("sr_ukf", "sr_rsukf"):
        yield Bands(f"{method}_phi", f"φ ({method}), 2σ", _estimates(f"{method}_phi"), "", METHODS)
    for method in ("dense_zupt", "dense_tczupt"):
        for axis, color in AXIS_COLORS.items():
            yield _published(method, f"gyro_bias_{axis}", f"Gyro bias {axis}", "°/h", "gyro_bias", color)
    yield _published("fixed_gain_loop", "heading", "Heading", "°", "heading", GREY, "now")
    yield _published("total_average", "heading", "Heading", "°", "heading", RED, "average")
    yield _published("curve_fit", "heading", "Heading", "°", "heading", ORANGE, "curve-fit")
    rate, title = "fixed_gain_loop_control_rate", "Horizontal control rates (fixed_gain_loop)"
    yield Bands(rate, title, _lines(f"{rate}_{{}}", {"east": RED, "north": BLUE}), "°/h", METHODS)
    for axis in "xyz":
        mean = Line(f"gyro_rest_mean_{axis}", "mean", VIOLET)
        hold = Line(f"gyro_rest_hold_{axis}", "hold", GREY)
        title = f"Gyro {axis}: exponential mean at rest, and the beginning held"
        yield Bands(f"gyro_rest_{axis}", title, (mean, hold), "°/h", METHODS)


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
    Strip("gyro", "Angular rate", _lines("gyro_{}"), "°/s", card="angular rate"),
    Strip("accel", "Specific force", _lines("accel_{}"), card="specific force"),
    Strip("mag", "Magnetic field", _lines("mag_{}"), card="magnetic field"),
    Strip(
        "angles", "Attitude as reported", _lines("{}", TILT | {"yaw": BLUE}), "°", ATTITUDE, card="reported"
    ),
    *(
        Strip(key, "Temperature", lines, look="steps", least=LEAST_DEGC, card="temperature read")
        for key, lines in (
            ("temperature", _lines("temperature", {"sensor": ORANGE})),
            ("temperature_axes", _lines("temperature_{}")),
        )
    ),
    *_thermal({"": ORANGE}, "/samples/temperature"),
    *_thermal({f"_{axis}": color for axis, color in AXIS_COLORS.items()}, "/samples/temperature_axes"),
    Bands("gyro_bias", "Gyro bias, 2σ", _estimates("gyro_bias"), "°/h", BIAS, card="gyro bias"),
    Bands(
        "gyro_bias_smoothed",
        "Gyro bias with what came later, 2σ",
        _estimates("gyro_bias_smoothed"),
        "°/h",
        BIAS,
        card="gyro bias, smoothed",
    ),
    Strip(
        "gyro_corrected",
        "Angular rate, raw and corrected",
        _lines("gyro_corrected_{}", CORRECTED, "{} corrected"),
        "°/s",
        BIAS,
        beside="/view/gyro",
    ),
    Strip(
        "zupt_innovation",
        "Zero-velocity innovations over their σ, limits 3σ",
        _lines("zupt_innovation_{}"),
        place=BIAS,
        look="points",
        limits=(-3.0, 3.0),
    ),
    Strip(
        "turn_hypothesis",
        "Not decided, turn or change of the bias",
        _lines("turn_hypothesis_{}"),
        "°/h",
        BIAS,
        look="steps",
        silent=0.0,
    ),
    Bands(
        "attitude_estimate_level",
        "Roll and pitch by the estimator, 2σ",
        _lines("attitude_estimate_{}", TILT, sd="attitude_estimate_tilt_sd"),
        "°",
        ATTITUDE,
        card="estimated",
    ),
    Bands(
        "attitude_estimate_heading",
        "Heading by the estimator, from magnetic north or free, 2σ",
        (_estimate("attitude_estimate_heading", "heading", BLUE),),
        "°",
        ATTITUDE,
        card="estimated heading",
    ),
    # A panel for each axis: beside the turn-on bias of another its drift would not be visible.
    *(
        Bands(
            line.column,
            f"Gyro bias {line.name} less the model's curve (all of it without a model), 2σ",
            (line,),
            "°/h",
            RESIDUAL,
            card="bias less model",
        )
        for line in _estimates("gyro_random_error")
    ),
    Bands(
        "heading",
        "Heading from true north, 2σ",
        (
            _estimate("heading_gyro_mean", "gyro-mean", RED),
            _estimate("heading_hann_mean", "Hann-mean", ORANGE),
            _estimate("heading", "shown", BLUE),
        ),
        "°",
        ALIGNMENT,
        card="heading by",
        headline=True,
    ),
    *(
        Bands(key, title, lines, "°", ALIGNMENT, card=card)
        for key, title, lines, card in (
            (
                "heading_smoothed",
                "Heading with what came later, 2σ",
                (_estimate("heading_smoothed", "smoothed", VIOLET),),
                "heading, smoothed",
            ),
            (
                "heading_magnetic",
                "Heading from magnetic north",
                _lines("heading_magnetic", {"magnetic": VIOLET}),
                "magnetic heading",
            ),
            ("level", "Roll and pitch by the alignment", _lines("aligned_{}", TILT), "level"),
        )
    ),
    Bands(
        "level_drift",
        "Drift of roll and pitch since the first rest",
        _lines("{}_drift", TILT),
        "µg",
        ALIGNMENT,
    ),
    *_methods(),
    Strip("pressure", "Pressure", (Line("pressure", "static", VIOLET),), place=PRESSURE, card="pressure"),
    # A count over 2 s is known to half a packet a second.
    Strip(
        "packet_rate",
        "Packet rate",
        (Line("packet_rate", "packets", BLUE),),
        "1/s",
        LINK,
        "steps",
        least=4.0,
        card="packets",
    ),
    Strip(
        "link_load", "Link load", (Line("link_load", "load", ORANGE),), "%", LINK, "steps", card="link load"
    ),
    Strip(
        "losses",
        "Packets so far",
        _lines("packets_{}", {"lost": RED, "damaged": VIOLET}),
        place=LINK,
        look="steps",
        least=4.0,  # whole packets
    ),
)
"""All panels, in the order in which they stand.  The attitude that comes first turns the body."""
