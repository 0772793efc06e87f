"""The effects there are, and what it takes to tell one from another."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from imumon.effects.axis_coupling import AxisCoupling
from imumon.effects.base import Effect
from imumon.effects.drift import Drift
from imumon.effects.g_sensitivity import GSensitivity
from imumon.effects.hysteresis import Hysteresis
from imumon.effects.periodic import Periodic
from imumon.effects.run_offset import RunOffset
from imumon.effects.step import Step
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.effects.temperature_rate import TemperatureRate
from imumon.effects.thermal_lag import ThermalLag
from imumon.effects.warm_up import WarmUp

EFFECTS: dict[str, type[Effect]] = {
    effect.name: effect
    for effect in (
        TemperatureCurve,
        TemperatureRate,
        ThermalLag,
        Hysteresis,
        WarmUp,
        Drift,
        Step,
        RunOffset,
        Periodic,
        GSensitivity,
        AxisCoupling,
    )
}

AnyEffect = Annotated[
    TemperatureCurve
    | TemperatureRate
    | ThermalLag
    | Hysteresis
    | WarmUp
    | Drift
    | Step
    | RunOffset
    | Periodic
    | GSensitivity
    | AxisCoupling,
    Field(discriminator="kind"),
]
"""An effect as it stands in a model file; its kind says which."""

_SEPARATED_BY: dict[frozenset[str], str] = {
    frozenset(pair): text
    for pair, text in {
        ("temperature_rate", "thermal_lag"): "a fast ramp into a soak: the lag goes on for its time constant",
        ("temperature_rate", "hysteresis"): "two ramp rates: a loop does not care, a rate effect doubles",
        (
            "thermal_lag",
            "hysteresis",
        ): "a soak of more than five time constants after a ramp, and two ramp rates:"
        " a lag decays in the soak, a loop stays",
        ("hysteresis", "temperature_curve"): "a turn of the temperature inside the range",
        ("thermal_lag", "temperature_curve"): "a second ramp at another rate, or downwards",
        ("temperature_rate", "temperature_curve"): "a second ramp at another rate, or downwards",
        ("warm_up", "drift"): "a run longer than four time constants of the warm-up",
        ("warm_up", "thermal_lag"): "power-on in equilibrium with the ambient temperature held",
        ("warm_up", "hysteresis"): "power-on in equilibrium with the ambient temperature held",
        ("warm_up", "temperature_rate"): "power-on in equilibrium with the ambient temperature held",
        ("warm_up", "temperature_curve"): "a second run that starts at another temperature",
        ("warm_up", "step"): "another run: a warm-up comes again at the same time",
        ("drift", "thermal_lag"): "a second ramp in the other direction",
        ("drift", "hysteresis"): "a second ramp in the other direction",
        ("drift", "temperature_rate"): "a second ramp in the other direction",
        ("drift", "temperature_curve"): "a second ramp in the other direction",
        ("drift", "run_offset"): "longer runs, the device not switched off between them",
        ("step", "run_offset"): "a run with the jump in its middle",
        ("step", "drift"): "a longer run: a drift goes on",
        ("g_sensitivity", "run_offset"): "at least four poses within one run",
        ("g_sensitivity", "axis_coupling"): "known turns about each axis",
        ("g_sensitivity", "step"): "each pose taken twice in one run",
    }.items()
}
_OTHERWISE = "another run with a different course of temperature, the ambient held after power-on"


def separated_by(one: str, other: str) -> str:
    """Return the excitation that would tell two effects apart."""
    return _SEPARATED_BY.get(frozenset((one, other)), _OTHERWISE)
