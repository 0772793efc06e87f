"""The model file: the bias of each channel over temperature, hard and soft iron, and where it comes from."""

from pathlib import Path
from typing import Annotated, Final, Literal, Self

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, Field, FiniteFloat, NonNegativeInt, model_validator

from imumon.blocks import BoolArray, FloatArray
from imumon.columns import BodyAxes
from imumon.config import StrictModel, dump_yaml, load_yaml
from imumon.effects.base import NotNegative, Positive
from imumon.effects.library import AnyEffect
from imumon.errors import ImumonError, bad_config
from imumon.files import as_path, write_text

from .curves.network import NetworkCurve
from .curves.polynomial import PolynomialCurve
from .curves.spline import SplineCurve

FORMAT: Final = "imumon-bias-model/2"
READ: Final = ("imumon-bias-model/1", FORMAT)
"""Formats that are read; the first knew no driver of an effect but temperature, time and specific force."""
UNITS = {
    **{f"gyro_{axis}": "rad/s" for axis in "xyz"},
    **{f"accel_{axis}": "m/s^2" for axis in "xyz"},
}
"""The channels that a model may have, and their units."""
REACH = 0.1
"""Outside the range the curve goes on along its end's tangent for this share of the range, then it is held.

A tangent errs by half the curvature times the distance squared, a held value by the slope times the distance:
near the end the tangent is better; far off both are guesses, and the held value is at least bounded."""

Curve = Annotated[PolynomialCurve | SplineCurve | NetworkCurve, Field(discriminator="kind")]
_Range = Annotated[list[FiniteFloat], Field(min_length=2, max_length=2)]
_Three = Annotated[list[FiniteFloat], Field(min_length=3, max_length=3)]
_Matrix = Annotated[list[_Three], Field(min_length=3, max_length=3)]


class ChannelModel(StrictModel):
    """Bias of one channel over temperature."""

    unit: Literal["rad/s", "m/s^2"]
    """Of all values of the channel."""
    temperature_column: Annotated[str, Field(pattern="^temperature(_estimate)?(_[xyz])?$")]
    """Column of the samples that the curve is over."""
    temperature_range_degc: _Range
    """Where the curve is supported by data."""
    residual_sd: NotNegative
    """Standard deviation of the bias about the curve, from levels that were left out of the fit."""
    held_out_rms: dict[str, NotNegative] = Field(default_factory=dict)
    """rms error at levels that were left out, for each candidate curve."""
    curve: Curve
    effects: list[AnyEffect] = Field(default_factory=list)
    """What the bias has beyond the curve, with coefficients; `value` and `slope` are without them."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        low, high = self.temperature_range_degc
        if low >= high:
            raise ValueError(f"temperature_range_degc {low} to {high} is empty")
        for effect in self.effects:
            if effect.scope in ("run", "event"):
                raise ValueError(f"{effect.name} is another in each run: no model can predict it")
        return self

    @property
    def reach_degc(self) -> float:
        """How far outside the range the end's tangent is followed, °C."""
        low, high = self.temperature_range_degc
        return REACH * (high - low)

    def value(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return the bias at temperatures in °C, in `unit`; outside the range see `REACH`."""
        return self.value_and_slope(temperature)[0]

    def slope(self, temperature: npt.ArrayLike) -> FloatArray:
        """Return db/dT at temperatures in °C, in `unit` per °C: the exact derivative of `value`."""
        return self.value_and_slope(temperature)[1]

    def value_and_slope(self, temperature: npt.ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return both."""
        t = np.asarray(temperature, np.float64)
        low, high = self.temperature_range_degc
        near = np.clip(t, low, high)
        beyond, slope = t - near, self.curve.slope(near)
        bounded = np.clip(beyond, -self.reach_degc, self.reach_degc)
        value = self.curve.value(near) + np.where(beyond == 0.0, 0.0, slope * bounded)
        return value, np.where(np.abs(beyond) > self.reach_degc, 0.0, slope)

    def inside(self, temperature: npt.ArrayLike) -> BoolArray:
        """Return which temperatures in °C the curve is supported at."""
        t = np.asarray(temperature, np.float64)
        low, high = self.temperature_range_degc
        return (t >= low) & (t <= high)


class MagnetometerModel(StrictModel):
    """Field = soft_iron (reading - hard_iron), as `imumon magnetometer` finds it."""

    unit: str
    """Of readings and field, as the device has it."""
    hard_iron: _Three
    hard_iron_sd: _Three
    """Reading where there is no field."""
    soft_iron: _Matrix
    soft_iron_sd: _Matrix
    """Symmetric; it leaves the mean strength of the field as it was read."""
    field: Positive
    """Strength of the field."""
    residual_sd: NotNegative
    """What a reading is off from that strength after the correction, noise and all."""
    coverage: Annotated[FiniteFloat, Field(ge=0.0, le=1.0)]
    """Share of the directions that were measured, 0 to 1."""
    session: str | None = None
    sha256: str | None = None
    """The recording."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if np.linalg.eigvalsh(np.array(self.soft_iron)).min() <= 0.0:
            raise ValueError("soft_iron is not a stretching: an eigenvalue is not positive")
        return self

    def corrected(self, mag: FloatArray) -> FloatArray:
        """Return the field in body axes of readings, (n, 3)."""
        return np.asarray((mag - np.array(self.hard_iron)) @ np.array(self.soft_iron).T)

    @property
    def fit_sd(self) -> float:
        """Standard deviation of a component of the field by what the fit does not know."""
        return float(np.hypot(max(self.hard_iron_sd), self.field * np.array(self.soft_iron_sd).max()))

    @property
    def error_sd(self) -> float:
        """Standard deviation of a component of the field by that and by what is left over."""
        return float(np.hypot(self.residual_sd, self.fit_sd))


class TrainedOn(StrictModel):
    """A run that a model was made from: a session, or the part of one up to a restart or another pose.

    `offset` is what its bias differs by from the mean of all runs, per channel and in the channel's unit;
    it has only the channels where it could be determined.
    """

    session: str
    run: NonNegativeInt = 0
    sha256: Annotated[str, Field(pattern="^[0-9a-f]{64}$")]
    rest_s: NotNegative
    blocks: NonNegativeInt
    temperature_range_degc: _Range
    offset: dict[str, FiniteFloat] = Field(default_factory=dict)


class BiasModel(StrictModel):
    """Bias over temperature of a unit, as `imumon calibrate` finds it and `imumon diagnose` extends it."""

    format: Annotated[
        Literal["imumon-bias-model/2"], BeforeValidator(lambda given: FORMAT if given in READ else given)
    ] = FORMAT
    made_by: str
    created: str
    """Version of imumon, and UTC time."""
    device: str | None = None
    serial: str | None = None
    """Device name and the unit's serial number."""
    axes: BodyAxes | None = None
    """Body axes of the data."""
    earth_rate: Literal["included", "removed"] = "included"
    """Whether the constant of the gyro curves holds the earth rate of the place and attitude of the test."""
    latitude_deg: Annotated[FiniteFloat, Field(ge=-90.0, le=90.0)] | None = None
    heading_deg: FiniteFloat | None = None
    """With which it was removed."""
    block_s: Positive | None = None
    levels_degc: list[FiniteFloat] = Field(default_factory=list)
    trained_on: list[TrainedOn] = Field(default_factory=list)
    """The data."""
    channels: dict[str, ChannelModel] = Field(default_factory=dict)
    """gyro_x and so on.  The curve of an accelerometer is the change from the middle of its range, for its
    constant cannot be separated from gravity."""
    magnetometer: MagnetometerModel | None = None
    """Hard and soft iron."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if not self.channels and self.magnetometer is None:
            raise ValueError("there is neither a channel nor a magnetometer")
        for name, channel in self.channels.items():
            if name not in UNITS:
                raise ValueError(f"channel {name!r} is not known; there are {', '.join(UNITS)}")
            if channel.unit != UNITS[name]:
                raise ValueError(f"channel {name} is in {UNITS[name]}, not {channel.unit}")
        return self

    def of_another(self, serial: str | None, axes: BodyAxes | None = None) -> str:
        """Return a warning where this is the model of another unit, or in other body axes; else ""."""
        for what, own, other in (("of unit", self.serial, serial), ("in body axes", self.axes, axes)):
            if None not in (own, other) and own != other:
                return f"the bias model is {what} {own}, this is {other}"
        return ""

    def write(self, path: Path) -> None:
        """Write the model file; what `load_model` reads from it equals this model, to the bit.

        Raises OSError when it cannot be written; a file that was there before is untouched.
        """
        write_text(path, self.to_yaml())

    def to_yaml(self) -> str:
        """Return the text of the model file."""
        return dump_yaml(self.model_dump(), flow=None)


def load_model(path: str | Path) -> BiasModel:
    """Read a model file.

    Raises BAD_CONFIG, naming file and line, what was found and what was expected.
    """
    try:
        return load_yaml(as_path(path), BiasModel)
    except ImumonError as error:
        hint = error.hint or f"a model file is what imumon calibrate writes, of format {FORMAT}"
        raise bad_config(error.seen, hint) from error
