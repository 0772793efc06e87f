"""What a unit file holds: one inertial unit, its biases over temperature, its noise and its thermometers."""

from typing import Annotated, Any, Generic, Literal, TypeVar

from pydantic import BeforeValidator, Field

from imumon.config import StrictModel
from imumon.effects.library import AnyEffect

Positive = Annotated[float, Field(gt=0.0)]
NotNegative = Annotated[float, Field(ge=0.0)]


def _one_or_three(value: Any) -> Any:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return (value,) * 3
    if isinstance(value, list | tuple) and len(value) == 3:
        return tuple(value)
    raise ValueError(f"expected a number, or three for x, y and z, got {value!r}")


Three = Annotated[tuple[float, float, float], BeforeValidator(_one_or_three)]
"""A number for each of x, y, z; one number stands for all three."""
ThreePositive = Annotated[tuple[NotNegative, NotNegative, NotNegative], BeforeValidator(_one_or_three)]
"""The same, none of them negative."""
NONE = (0.0, 0.0, 0.0)


class Shape(StrictModel):
    """amplitude tanh(u) or amplitude sin(u), u = (T - at_degc) / width_degc."""

    amplitude: float
    at_degc: float
    width_degc: Positive
    kind: Literal["tanh", "sin"]


class Polynomial(StrictModel):
    """c0 + c1 u + c2 u² ..., u = (T - at_degc) / width_degc."""

    kind: Literal["polynomial"]
    coefficients: list[float] = Field(min_length=1, max_length=12)
    at_degc: float = 0.0
    width_degc: Positive = 1.0


Term = Annotated[Shape | Polynomial, Field(discriminator="kind")]


Item = TypeVar("Item")


class OfAxes(StrictModel, Generic[Item]):
    """What each axis has."""

    x: list[Item] = Field(default_factory=list)
    y: list[Item] = Field(default_factory=list)
    z: list[Item] = Field(default_factory=list)


class Curves(OfAxes[Term]):
    """A bias over temperature of each axis, as a sum of terms; the key that holds it names the unit."""


class Effects(OfAxes[AnyEffect]):
    """Effects of each axis as in a model file, with coefficients in the unit of the key that holds it."""


class Hysteresis(StrictModel):
    """A loop h y(T) on top of the bias curve, with y between -1 (cooled) and 1 (heated), 0 at power-on."""

    kind: Literal["smooth", "play"] = "smooth"
    """y' = (T' - |T'| y) / w; or y = (T - p) / w with the play p, which follows T at a distance w."""
    half_width_deg_per_h: Three
    """h."""
    width_degc: Positive
    """w."""


class GyroFlicker(StrictModel):
    """One Gauss-Markov process on each gyro, in equilibrium at power-on."""

    sd_deg_per_h: ThreePositive
    tau_s: Positive


class AccelFlicker(StrictModel):
    """One Gauss-Markov process on each accelerometer, in equilibrium at power-on."""

    sd_ug: ThreePositive
    tau_s: Positive


class GyroNoise(StrictModel):
    """Angular random walk, bias instability as a sum of Gauss-Markov processes, and bias random walk."""

    arw_deg_per_sqrt_h: ThreePositive = NONE
    flicker: list[GyroFlicker] = Field(default_factory=list)
    random_walk_deg_per_h_per_sqrt_s: ThreePositive = NONE


class AccelNoise(StrictModel):
    """Velocity random walk and bias instability."""

    vrw_m_per_s_per_sqrt_s: ThreePositive = NONE
    flicker: list[AccelFlicker] = Field(default_factory=list)


class GyroTurnOn(StrictModel):
    """A constant on each gyro: given, plus one drawn anew for every seed."""

    offset_deg_per_h: Three = NONE
    sd_deg_per_h: ThreePositive = NONE


class AccelTurnOn(StrictModel):
    """A constant on each accelerometer: given, plus one drawn anew for every seed."""

    offset_mg: Three = NONE
    sd_mg: ThreePositive = NONE


class AccelWarmUp(StrictModel):
    """Bias after power-on: amplitude (1 - exp(-t / tau))."""

    amplitude_ug: Three
    tau_s: Positive


class SelfHeating(StrictModel):
    """Temperature of each sensor above its surroundings after power-on: rise (1 - exp(-t / tau))."""

    rise_degc: Three
    tau_s: Positive


class Thermometer(StrictModel):
    """One thermometer at each gyro and one on the board."""

    step_degc: NotNegative = 0.05
    noise_degc: NotNegative = 0.005
    """Quantization step (0: none), and standard deviation of a reading before it is quantized."""
    rate_hz: Positive | None = None
    """New readings per second, held in between; None for one with each packet."""


class UnitParameters(StrictModel):
    """A unit.  Every key has a default, which is to be without that error."""

    format: Literal["imumon-unit/1"] = "imumon-unit/1"
    title: str = ""
    gyro_bias_deg_per_s: Curves = Curves()
    gyro_turn_on: GyroTurnOn = GyroTurnOn()
    gyro_hysteresis: Hysteresis | None = None
    gyro_lag_s: ThreePositive = NONE
    gyro_effects_deg_per_h: Effects = Effects()
    gyro_noise: GyroNoise = GyroNoise()
    accel_bias_mg: Curves = Curves()
    accel_turn_on: AccelTurnOn = AccelTurnOn()
    accel_warm_up: AccelWarmUp | None = None
    accel_effects_ug: Effects = Effects()
    accel_noise: AccelNoise = AccelNoise()
    self_heating: SelfHeating | None = None
    thermometer: Thermometer = Thermometer()
    low_pass_hz: Positive | None = None
