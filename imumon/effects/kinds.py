"""The effects there are, how to separate them, and those of other packages.

The latter are checked at load; columns that are wrong later are an error that names the package.
"""

import functools
from collections.abc import Callable
from typing import Any, get_args

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import ACCEL, Drive, Effect, Memory, Scope, Survey
from imumon.effects.product import GSensitivity, Product
from imumon.effects.since_power_on import Drift, Periodic, RunOffset, Step, StressRelaxation, WarmUp
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.effects.thermal_lag import DeadTime, Hysteresis, TemperatureRate, ThermalLag
from imumon.errors import ImumonError
from imumon.plugins import Plugin, described

_KINDS: tuple[type[Effect], ...] = (
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
KINDS: dict[str, type[Effect]] = {kind.name: kind for kind in _KINDS}
"""imumon's own, by the name of their kind, in the order in which they are tried."""
SEPARATED_BY: dict[tuple[str, str], str] = {
    ("temperature_rate", "temperature_curve"): "a second ramp at another rate, or downwards",
    ("thermal_lag", "temperature_rate"): "a fast ramp into a soak: the lag goes on for its time constant",
    ("thermal_lag", "hysteresis"): (
        "a soak of more than five time constants after a ramp, and two ramp rates: a lag decays in the"
        " soak, a loop stays"
    ),
    ("thermal_lag", "temperature_curve"): "a second ramp at another rate, or downwards",
    ("thermal_lag", "warm_up"): "power-on in equilibrium with the ambient temperature held",
    ("thermal_lag", "drift"): "a second ramp in the other direction",
    ("dead_time", "temperature_rate"): "a fast ramp into a soak: the delay goes on for its time",
    ("dead_time", "thermal_lag"): (
        "a fast ramp into a soak: a lag bends at once and slowly, a delay later and at once"
    ),
    ("dead_time", "hysteresis"): "two ramp rates: a loop does not care, a delay doubles",
    ("dead_time", "temperature_curve"): "a second ramp at another rate, or downwards",
    ("hysteresis", "temperature_rate"): "two ramp rates: a loop does not care, a rate effect doubles",
    ("hysteresis", "temperature_curve"): "a turn of the temperature inside the range",
    ("hysteresis", "warm_up"): "power-on in equilibrium with the ambient temperature held",
    ("hysteresis", "drift"): "a second ramp in the other direction",
    ("warm_up", "drift"): "a run longer than four time constants of the warm-up",
    ("warm_up", "temperature_rate"): "power-on in equilibrium with the ambient temperature held",
    ("warm_up", "temperature_curve"): "a second run that starts at another temperature",
    ("warm_up", "step"): "another run: a warm-up comes again at the same time",
    ("stress_relaxation", "warm_up"): "a run of ten time constants of the warm-up: a relaxation goes on",
    ("stress_relaxation", "drift"): "a run ten times as long: a relaxation slows down",
    ("stress_relaxation", "thermal_lag"): "power-on in equilibrium with the ambient temperature held",
    ("stress_relaxation", "step"): "another run: a relaxation comes again at the same time",
    ("drift", "temperature_rate"): "a second ramp in the other direction",
    ("drift", "temperature_curve"): "a second ramp in the other direction",
    ("drift", "run_offset"): "longer runs, the device not switched off between them",
    ("drift", "step"): "a longer run: a drift goes on",
    ("step", "run_offset"): "a run with the jump in its middle",
    ("g_sensitivity", "run_offset"): "at least four poses within one run",
    ("g_sensitivity", "step"): "each pose taken twice in one run",
    ("product", "g_sensitivity"): "each pose at several temperatures, and upside down",
    ("product", "temperature_curve"): "a run at one temperature in which the other driver moves",
}
"""What to record to separate two effects."""
EFFECT = "effect of that name"
"""What a plug-in offers in the group `imumon.plugins.EFFECTS`, in words."""
SURVEY = Survey((7200.0, 7200.0), 30.0, 4, 19.6, 30.0, 3, 25.0, 15.0)
"""Two runs of two hours over 30 °C in which the unit is turned over: they can show nearly any effect."""


def is_effect(name: str, offered: object) -> bool:
    """Return whether an effect is offered, under the name that its kind has and that none of imumon's has."""
    if not (isinstance(offered, type) and issubclass(offered, Effect)):
        return False
    kind = offered.model_fields.get("kind")
    named = kind is not None and get_args(kind.annotation) == (name,) and kind.default == name
    return named and name not in KINDS


def guarded(plugin: Plugin) -> type[Effect]:
    """Return the effect of a plug-in, whose columns raise BAD_CONFIG, naming it, for what goes wrong in them.

    Raises BAD_CONFIG when its attributes are wrong, or a trial finds that its numbers are.
    """
    effect: type[Effect] = plugin.offered
    if not (isinstance(effect.sensors, tuple) and {*effect.sensors} <= {"gyro", "accel"}):
        raise plugin.error(f"has sensors {effect.sensors!r}: expected a tuple of gyro, accel")
    if effect.scope not in get_args(Scope):
        raise plugin.error(f"has scope {effect.scope!r}: expected one of {', '.join(get_args(Scope))}")
    if unknown := sorted({*effect.nonlinear} - effect.model_fields.keys()):
        raise plugin.error(f"has nonlinear parameters that are none of its fields: {', '.join(unknown)}")
    advance = effect.advance

    @functools.wraps(advance)
    def checked(self: Effect, memory: Memory, drive: Drive) -> FloatArray:
        columns = _called(plugin, "advance", advance, self, memory, drive)
        if wrong := _wrong(columns, (len(drive), self.width)):
            raise plugin.error(f"returned from advance {wrong}")
        return np.asarray(columns)

    effect.advance = checked  # type: ignore[method-assign]  # of a class that this one stands for from now on
    _try(plugin, effect)
    return effect


def _called(plugin: Plugin, name: str, function: Callable[..., Any], *arguments: object) -> Any:
    """Return what somebody else's code returns; what it raises becomes BAD_CONFIG, naming the plug-in."""
    try:
        return function(*arguments)
    except ImumonError:
        raise
    except Exception as error:
        raise plugin.error(f"failed in {name}: {described(error, __file__)}") from error


def _try(plugin: Plugin, effect: type[Effect]) -> None:
    """Run the first and the last effect of the grid over a ramp, whole and in two parts."""
    time_s = np.arange(0.0, 600.0, 10.0)
    turned = np.where(time_s[:, np.newaxis] < 300.0, [0.0, 0.0, 9.8], [9.8, 0.0, 0.0])
    whole, *parts = (
        Drive(time_s[rows], 20.0 + 0.02 * time_s[rows], turned[rows])
        for rows in (slice(None), slice(0, 25), slice(25, None))
    )
    grid = _called(plugin, "grid", effect.grid, SURVEY)
    if not (isinstance(grid, list) and all(isinstance(one, Effect) for one in grid)):
        raise plugin.error(f"returned from grid a {type(grid).__name__}: expected a list of effects")
    for one in (*grid[:1], *grid[1:][-1:]):
        if not isinstance(one.width, int) or one.width < 1:
            raise plugin.error(f"has width {one.width!r}: expected the number of its columns")
        if not {*one.inputs} <= {ACCEL}:
            continue  # what drives it is not in the trial
        fitted, memory = one.with_coefficients(np.ones(one.width)), Memory()
        added = np.concatenate([fitted.added(memory, part) for part in parts])
        if not np.array_equal(added, fitted.added(Memory(), whole)):
            raise plugin.error("adds another bias where its samples are divided otherwise")
        _called(plugin, "starts", fitted.starts, whole)


def _wrong(columns: object, shape: tuple[int, int]) -> str:
    """Return what is wrong with the columns of an effect; empty if nothing is."""
    if not isinstance(columns, np.ndarray):
        return f"a {type(columns).__name__}: expected an array of shape {shape}"
    if columns.shape != shape:
        return f"an array of shape {columns.shape}: expected {shape}"
    if columns.dtype != np.float64:
        return f"{columns.dtype}: expected float64"
    return "" if np.isfinite(columns).all() else "values that are not finite"
