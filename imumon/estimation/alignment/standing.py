"""Where an alignment stands, for those who show or report it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

PATIENCE_S = 120.0
"""So much undisturbed time must show whether a gyro sees the north."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A heading, rad clockwise from north, and its standard deviation."""

    heading: float
    sd: float


@dataclass(frozen=True, slots=True)
class Standing:
    """Where the alignment stands.

    Parameters
    ----------
    phase : str
        waiting, coarse, aligning, settled, not observable or disturbed.
    chosen : str or None
        The estimator whose heading is shown.
    shown : Estimate or None
        Its heading; NaN where the gyro cannot see the north.
    settled_s : float or None
        s from the first sample until the heading settled, if it still is.
    to_go_s : float or None
        s until the sigma wanted is reached; None when it cannot be told, or never.
    estimates : mapping of str to Estimate
        A heading is NaN where its sigma says that the gyro does not see the north.
    magnetic : float
        rad from magnetic north; NaN without a magnetometer.
    device_yaw : float
        The last yaw that the device reported, rad, in its own convention; NaN when it reports none.
    time_s : float
        Undisturbed time of the fine alignment.
    roll, pitch : float
        rad; NaN before the fine alignment.
    arw, bias_sd : float
        Noise of the gyros in rad/√s, and standard deviation of a horizontal gyro's bias in rad/s.
    tilting : bool
        Whether the unit tilts, rather than an accelerometer drifts.
    seconds, coarse_s, shaken_s : float
        Since the first sample; gathered by the coarse alignment; disturbed.
    coarse_wanted_s, wanted : float
        What the coarse alignment needs, s, and the sigma wanted, rad.
    earth_rate : float
        Its horizontal part, rad/s.
    disturbed, restarts : int
        How often something was left out, and how often the alignment began anew.
    """

    phase: str
    observable: bool
    chosen: str | None
    shown: Estimate | None
    settled_s: float | None
    to_go_s: float | None
    estimates: Mapping[str, Estimate]
    magnetic: float
    device_yaw: float
    time_s: float
    roll: float
    pitch: float
    arw: float
    bias_sd: float
    tilting: bool
    restarts: int
    disturbed: int
    seconds: float
    coarse_s: float
    shaken_s: float
    coarse_wanted_s: float
    wanted: float
    earth_rate: float

    @property
    def hopeless(self) -> bool:
        """Whether waiting will not bring the sigma wanted: the gyro's bias, not its noise, is in the way."""
        return self.time_s >= PATIENCE_S and self.to_go_s is None


def instead(standing: Standing) -> tuple[str, float]:
    """Return what is shown where the gyro does not see the north, and its angle, rad."""
    if math.isfinite(standing.device_yaw):
        return "the device's own yaw", standing.device_yaw
    if math.isfinite(standing.magnetic):
        return "magnetic, not true north", standing.magnetic
    return "nothing", math.nan
