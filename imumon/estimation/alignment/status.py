"""The state of an alignment, for displays and reports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

ANY_ANGLE_SD = math.pi / math.sqrt(3.0)
"""Standard deviation of an angle that is uniform on the circle, rad."""
HOPELESS_S = 120.0
"""Time at rest after which a bias that hides the north is reported as such."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """A heading, rad clockwise from north, NaN if not observable, and its standard deviation."""

    heading: float
    sd: float

    @property
    def known(self) -> bool:
        """Whether the angle is better known than one that is uniform on the circle."""
        return self.sd < ANY_ANGLE_SD


@dataclass(frozen=True, slots=True)
class PositionHeading:
    """The heading in one position, by all positions together.

    Parameters
    ----------
    run : int
        Number of the device's segment, from 1.
    begun_s, ended_s : float
        Since the first sample of that segment.
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
    """The state of an alignment at the end of a block.

    Parameters
    ----------
    phase : str
        waiting, coarse, aligning, settled, not observable or disturbed.
    estimates : mapping of str to Estimate
        The joint fit, which is the heading shown, and plain and Hann-weighted mean of the gyros; empty before
        the first fit.
    settled_s : float or None
        s from the first sample until the heading settled; None if it is not settled.
    remaining_s : float or None
        Predicted time until the wanted standard deviation is reached; None if unknown or never.
    magnetic : float
        Heading from magnetic north, rad; NaN without a magnetometer.
    device_yaw : float
        The last yaw that the device reported, rad, in its own convention; NaN when it reports none.
    rest_s, disturbed_s, elapsed_s : float
        Time at rest and in motion, and time since the first sample.
    roll, pitch : float
        rad; NaN before the unit rests.
    arw : float
        Angular random walk of the quietest gyro, rad/√s; NaN before the first fit.
    level_bias_sd, accel_bias_sd : float
        Standard deviation of the gyros' bias in the level axes, rad/s, and of the accelerometers' bias, g.
    bias_declared : bool
        Whether the size of the gyros' bias is declared.
    tilt_probability : float
        Probability that the unit tilts, rather than an accelerometer drifts.
    disturbances, restarts : int
        Number of motions left out, and of restarts of the alignment.
    wanted_sd : float
        Standard deviation of the heading that is wanted, rad.
    horizontal_earth_rate : float
        rad/s.
    positions : int
        Number of positions, the present one included.
    position_s, position_sd : float
        Time at rest in the present position, and the standard deviation of the heading by its white noise
        alone, rad.
    turned : float
        Angle about the vertical since the previous position, rad, clockwise; also during a turn.
    """

    phase: str
    observable: bool
    estimates: Mapping[str, Estimate]
    settled_s: float | None
    remaining_s: float | None
    magnetic: float
    device_yaw: float
    rest_s: float
    disturbed_s: float
    elapsed_s: float
    roll: float
    pitch: float
    arw: float
    level_bias_sd: float
    accel_bias_sd: float
    bias_declared: bool
    tilt_probability: float
    disturbances: int
    restarts: int
    wanted_sd: float
    horizontal_earth_rate: float
    positions: int
    position_s: float
    position_sd: float
    turned: float

    @property
    def shown(self) -> Estimate | None:
        """The heading shown, that of the joint fit; None before the first fit."""
        return self.estimates.get("joint")

    @property
    def estimator(self) -> str | None:
        """Name of the estimator whose heading is shown."""
        return next(iter(self.estimates), None)

    @property
    def hopeless(self) -> bool:
        """Whether more time will not bring the wanted sigma, as the gyros' bias limits it."""
        return self.rest_s >= HOPELESS_S and self.remaining_s is None

    @property
    def substitute(self) -> tuple[str, float]:
        """Name and angle, rad, of what is shown where the heading is not observable."""
        if math.isfinite(self.device_yaw):
            return "the device's own yaw", self.device_yaw
        if math.isfinite(self.magnetic):
            return "magnetic, not true north", self.magnetic
        return "nothing", math.nan
