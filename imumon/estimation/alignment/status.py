"""Where an alignment stands, for those who show or report it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

ANY_ANGLE_SD = math.pi / math.sqrt(3.0)
"""Standard deviation, rad, of an angle of which nothing is known."""
PATIENCE_S = 120.0
"""So much undisturbed time must show whether a gyro sees the north."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A heading, rad clockwise from north, and its standard deviation."""

    heading: float
    sd: float

    @property
    def tells(self) -> bool:
        """Whether anything is known of the angle."""
        return self.sd < ANY_ANGLE_SD


@dataclass(frozen=True, slots=True)
class Position:
    """Where the unit stood still, and what all poses together say of its heading there.

    Parameters
    ----------
    run : int
        How often the device had begun, from 1.
    begun_s, ended_s : float
        Since the first sample of that run.
    heading, sd : float
        rad; the heading is NaN where it is not observable.
    """

    run: int
    begun_s: float
    ended_s: float
    heading: float
    sd: float


@dataclass(frozen=True, slots=True)
class Status:
    """Where the alignment stands.

    Parameters
    ----------
    phase : str
        waiting, coarse, aligning, settled, not observable or disturbed.
    shown : Estimate or None
        The heading; NaN where the gyro cannot see the north.
    settled_s : float or None
        s from the first sample until the heading settled, if it still is.
    to_go_s : float or None
        s until the sigma wanted is reached; None when it cannot be told, or never.
    estimates : mapping of str to Estimate
        The joint fit, which is shown, and plain and Hann-weighted mean of the gyros beside it.  A heading is
        NaN where its sigma says that the gyro does not see the north.
    magnetic : float
        rad from magnetic north; NaN without a magnetometer.
    device_yaw : float
        The last yaw that the device reported, rad, in its own convention; NaN when it reports none.
    time_s : float
        Undisturbed time.
    roll, pitch : float
        rad; NaN before the unit rests.
    arw, bias_sd : float
        Noise of the gyros in rad/√s, and what their bias may be wrong by, rad/s.
    tilting : float
        Probability that the unit tilts, rather than an accelerometer drifts.
    seconds, shaken_s : float
        Since the first sample; disturbed.
    wanted : float
        The sigma wanted, rad.
    earth_rate : float
        Its horizontal part, rad/s.
    disturbed, restarts : int
        How often something was left out, and how often the alignment began anew.
    positions : int
        Poses that count, with that of now.
    position_s : float
        Undisturbed time in the pose of now.
    position_sd : float
        What white noise leaves of this pose alone, rad.
    turned : float
        Angle about the vertical since the pose before, rad, clockwise; also while the unit is being turned.
    bias_declared : bool
        Whether the pipeline file says how large the gyros' biases are.
    force_sd : float
        Standard deviation of the accelerometers' bias, g.
    """

    phase: str
    observable: bool
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
    tilting: float
    restarts: int
    disturbed: int
    seconds: float
    shaken_s: float
    wanted: float
    earth_rate: float
    positions: int
    position_s: float
    position_sd: float
    turned: float
    bias_declared: bool
    force_sd: float

    @property
    def chosen(self) -> str | None:
        """The estimator whose heading is shown."""
        return None if self.shown is None else "joint"

    @property
    def hopeless(self) -> bool:
        """Whether waiting will not bring the sigma wanted: the gyro's bias, not its noise, is in the way."""
        return self.time_s >= PATIENCE_S and self.to_go_s is None


def instead(status: Status) -> tuple[str, float]:
    """Return what is shown where the gyro does not see the north, and its angle, rad."""
    if math.isfinite(status.device_yaw):
        return "the device's own yaw", status.device_yaw
    if math.isfinite(status.magnetic):
        return "magnetic, not true north", status.magnetic
    return "nothing", math.nan
