"""What a user reads of an alignment: its state, and texts of the result."""

import math
from collections.abc import Mapping
from typing import NamedTuple

ANY_ANGLE_SD = math.pi / math.sqrt(3.0)  # standard deviation of an angle that is uniform on the circle, rad
NOT_OBSERVABLE_S = 30.0  # time at rest after which "not observable" is reported


class Estimate(NamedTuple):
    """A heading, rad clockwise from north, and its standard deviation; NaN if unknown or not observable."""

    heading: float = math.nan
    sd: float = math.nan


class PositionHeading(NamedTuple):
    """Heading in one position by all positions, rad; NaN where it is not observable."""

    run: int  # of the device's segments, from 1
    begun_s: float  # since its first sample
    ended_s: float
    heading: float
    sd: float


class Status(NamedTuple):
    """State of an alignment at the end of a block, rad and s."""

    wanted_sd: float
    elapsed_s: float  # since the first sample
    moving: bool
    rest_s: float = 0.0
    estimates: Mapping[str, Estimate] = {}  # joint fit and means of the gyros; empty before the first fit
    settled_s: float | None = None  # since the first sample; None if it is not settled
    remaining_s: float = math.inf  # predicted; infinite if unknown or never
    positions: int = 0  # the present one included
    position_s: float = 0.0  # at rest in it
    position_sd: float = math.inf  # of its heading by white noise alone
    turned: float = 0.0  # since the previous position, also while `moving`

    @property
    def shown(self) -> Estimate:
        """The heading shown, that of the joint fit."""
        return self.estimates.get("joint", Estimate())

    @property
    def observable(self) -> bool:
        """Whether there is a heading that is known well enough to be shown."""
        return math.isfinite(self.shown.heading)

    @property
    def phase(self) -> str:
        """Waiting, coarse, aligning, settled, not observable or disturbed."""
        if self.elapsed_s == 0.0:
            return "waiting"
        if self.moving:
            return "disturbed"
        if self.observable:
            return "aligning" if self.settled_s is None else "settled"
        return "not observable" if self.rest_s > NOT_OBSERVABLE_S else "coarse"

    @property
    def heading_text(self) -> str:
        """The heading with its sigma, or the reason why there is none."""
        if self.observable:
            return f"{math.degrees(self.shown.heading):.3f}° ± {math.degrees(self.shown.sd):.3f}°"
        return "heading not observable" if self.phase == "not observable" else "no heading yet"

    @property
    def to_go_text(self) -> str:
        """The predicted time to the wanted sigma, or why there is none."""
        phase, wanted = self.phase, f"{math.degrees(self.wanted_sd):g}°"
        if phase == "disturbed":
            return f"disturbed, turned by {math.degrees(self.turned):.0f}°"
        if phase == "coarse":
            return f"coarse, {self.rest_s:.0f} s of rest"
        if phase in ("waiting", "settled"):
            return phase
        if math.isinf(self.remaining_s):
            return f"{wanted} not in reach: bias of the sensors, or slow motion of the unit"
        return f"about {self.remaining_s:.0f} s to {wanted}"
