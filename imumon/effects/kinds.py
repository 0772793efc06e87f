"""The effects there are, how to separate them, and those of other packages: their errors name the package."""

import functools
from typing import get_args

import numpy as np

from imumon.blocks import FloatArray
from imumon.plugins import Plugin, described

from .base import Drive, Effect, Memory
from .product import GSensitivity, Product
from .since_power_on import Drift, Periodic, RunOffset, Step, StressRelaxation, WarmUp
from .temperature_curve import TemperatureCurve
from .thermal_lag import DeadTime, Hysteresis, TemperatureRate, ThermalLag

KINDS: dict[str, type[Effect]] = {
    kind.name: kind
    for kind in (
        TemperatureCurve,
        TemperatureRate,
        ThermalLag,
        DeadTime,
        Hysteresis,
        WarmUp,
        StressRelaxation,
        Drift,
        Step,
        RunOffset,
        Periodic,
        GSensitivity,
        Product,
    )
}
"""imumon's own, by the name of their kind, in the order in which they are tried."""
SEPARATED_BY = {
    ("dead_time", "hysteresis"): "two ramp rates: a loop stays the same, a delay doubles",
    ("dead_time", "temperature_rate"): "a fast ramp into a soak: the delay goes on for its time",
    ("dead_time", "thermal_lag"): (
        "a fast ramp into a soak: a lag begins at once and slowly, a delay later and at once"
    ),
    ("drift", "run_offset"): "longer runs, the device not switched off between them",
    ("drift", "step"): "a longer run: a drift goes on",
    ("drift", "stress_relaxation"): "a run ten times as long: a relaxation slows down",
    ("drift", "warm_up"): "a run longer than four time constants of the warm-up",
    ("g_sensitivity", "run_offset"): "at least four poses within one run",
    ("g_sensitivity", "step"): "each pose taken twice in one run",
    ("hysteresis", "temperature_curve"): "a turn of the temperature inside the range",
    ("hysteresis", "temperature_rate"): "two ramp rates: a loop stays the same, a rate effect doubles",
    ("hysteresis", "thermal_lag"): (
        "a soak of more than five time constants after a ramp, and two ramp rates: a lag decays in the"
        " soak, a loop stays"
    ),
    ("run_offset", "step"): "a run with the jump in its middle",
    ("step", "stress_relaxation"): "another run: a relaxation comes again at the same time",
    ("step", "warm_up"): "another run: a warm-up comes again at the same time",
    ("stress_relaxation", "warm_up"): "a run of ten time constants of the warm-up: a relaxation goes on",
    ("temperature_rate", "thermal_lag"): "a fast ramp into a soak: the lag goes on for its time constant",
}
"""What to record to separate two effects, by their names in order..."""
OTHERWISE = "power-on in equilibrium with the ambient held, then ramps at another rate and downwards"
"""...and any others."""
EFFECT = "effect of that name"
"""What a plug-in offers in the group `imumon.plugins.EFFECTS`, in words."""


def is_effect(name: str, offered: object) -> bool:
    """Return whether an effect is offered, under the name that its kind has and that none of imumon's has."""
    if not (isinstance(offered, type) and issubclass(offered, Effect)):
        return False
    kind = offered.model_fields.get("kind")
    named = kind is not None and get_args(kind.annotation) == (name,) and kind.default == name
    return named and name not in KINDS


def guarded(plugin: Plugin) -> type[Effect]:
    """Return the effect of a plug-in, whose wrong columns raise BAD_CONFIG, naming it."""
    effect: type[Effect] = plugin.offered
    advance = effect.advance

    @functools.wraps(advance)
    def checked(self: Effect, memory: Memory, drive: Drive) -> FloatArray:
        try:
            columns = advance(self, memory, drive)
        except Exception as error:
            raise plugin.error(f"failed in advance: {described(error, __file__)}") from error
        shape = len(drive), self.width
        found = getattr(columns, "shape", type(columns).__name__), getattr(columns, "dtype", "")
        if found != (shape, np.dtype(np.float64)):
            raise plugin.error(f"returned from advance {found}: expected an array of float64, shape {shape}")
        if not np.isfinite(columns).all():
            raise plugin.error("returned from advance values that are not finite")
        return columns

    effect.advance = checked  # type: ignore[method-assign]  # of a class that this one stands for from now on
    return effect
