"""The full-scale range of gyros and accelerometers, where a device file, a pipeline file or a map has it."""

import math

from pydantic import Field

from imumon.config import StrictModel, parse_yaml
from imumon.geodesy import STANDARD_GRAVITY

ROUNDED = 2.0**-9
"""Share of a range: data sheets round it and its scale, 16.4 for 16.384 counts per °/s, 0.1 %; twice that."""


class Ranges(StrictModel):
    """What a sensor reads at most, either way; beyond, it reads the end of its range.

    Parameters
    ----------
    gyro_deg_per_s, accel_g : float, optional
    """

    gyro_deg_per_s: float | None = Field(default=None, gt=0.0, le=1e5)
    accel_g: float | None = Field(default=None, gt=0.0, le=1e5)

    def over(self, other: "Ranges") -> "Ranges":
        """Return these, and what only the other declares."""
        return other.model_copy(update=self.model_dump(exclude_none=True))

    def limits(self) -> dict[str, tuple[float, float, str]]:
        """Return for each column the least and largest reading inside, SI units, and what it is beyond."""
        found = dict[str, tuple[float, float, str]]()
        for sensor, end, unit, name in (
            ("gyro", self.gyro_deg_per_s, math.pi / 180.0, "deg/s"),
            ("accel", self.accel_g, STANDARD_GRAVITY, "g"),
        ):
            if end is not None:
                most = math.nextafter((1.0 - ROUNDED) * end * unit, 0.0)
                label = f"at its range of {end:g} {name}"
                found |= {f"{sensor}_{axis}": (-most, most, label) for axis in "xyz"}
        return found


class _Declaring(StrictModel, extra="ignore"):
    range: Ranges = Ranges()


def declared(text: str | None, source: str) -> Ranges:
    """Return the range that the text of a pipeline file or a map declares; none where there is no text."""
    return Ranges() if text is None else parse_yaml(text, _Declaring, source).range
