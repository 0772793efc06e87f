"""Charts whose horizontal axis is not time: a bias over temperature, an Allan deviation over tau.

Plain data: who makes a chart knows nothing of who draws it.
"""

from typing import NamedTuple

from .blocks import FloatArray

Color = tuple[int, int, int]
"""Red, green, blue, 0 to 255 each."""
RED: Color = (232, 72, 72)
GREEN: Color = (40, 165, 85)
BLUE: Color = (66, 133, 244)
ORANGE: Color = (235, 140, 20)
VIOLET: Color = (165, 95, 215)
GREY: Color = (135, 140, 150)
COLOR_NAMES = {
    RED: "red", GREEN: "green", BLUE: "blue", ORANGE: "orange", VIOLET: "violet", GREY: "grey",
}  # fmt: skip
"""What a person calls them."""
AXIS_COLORS = {"x": RED, "y": GREEN, "z": BLUE}
"""These read on the viewer's dark and on its light theme."""


class Axis(NamedTuple):
    """One axis: what it shows with its unit, and whether it is logarithmic."""

    label: str
    log: bool = False


class Curve(NamedTuple):
    """Points in the units of the axes, (n,) each; NaN interrupts a line."""

    name: str
    x: FloatArray
    y: FloatArray
    color: Color
    points: bool = False
    """Draw points, not a line."""
    width: float = 1.6
    """Of the line, or the diameter of the points, in pixels."""
    listed: bool = True
    """Whether the legend names it."""
    dashed: bool = False
    """Draw a dashed line."""


class Chart(NamedTuple):
    """Curves on two axes."""

    key: str
    """Unique among the charts of a run; a later chart of the same key replaces the earlier."""
    place: str
    """The tab it stands in."""
    title: str
    x: Axis
    y: Axis
    curves: tuple[Curve, ...]
    headline: str = ""
    """What matters most, large."""
    notes: tuple[str, ...] = ()
    """Values that belong to the curves, a line each."""
