"""Effects of other packages: checked at load, and whatever one does wrong later is an error that names it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any, get_args

import numpy as np

from imumon.effects.base import ACCEL, Drive, Effect, Memory, Scope, Survey
from imumon.errors import ImumonError
from imumon.plugins import Plugin, described

EFFECT = "effect of that name"
"""What a plug-in offers in the group `imumon.plugins.EFFECTS`, in words."""
SURVEY = Survey((7200.0, 7200.0), 30.0, 4, 19.6, 30.0, 3, 25.0, 15.0)
"""Two runs of two hours over 30 °C in which the unit is turned over: they can show nearly any effect."""
_FOREIGN_TO_PLUGINS = ("imumon", "pydantic", "builtins", "abc", "typing")


def is_effect(name: str, offered: object) -> bool:
    """Return whether an effect is offered, under the name that its kind has and that none of imumon's has."""
    if not (isinstance(offered, type) and issubclass(offered, Effect)):
        return False
    kind = offered.model_fields.get("kind")
    taken = Path(__file__).with_name(f"{name}.py").exists()
    return kind is not None and get_args(kind.annotation) == (name,) and kind.default == name and not taken


def guarded(plugin: Plugin) -> type[Effect]:
    """Return the effect of a plug-in, whose methods raise BAD_CONFIG, naming it, for what goes wrong in them.

    Raises BAD_CONFIG when its attributes are wrong, or a trial finds that its numbers are.
    """
    effect: type[Effect] = plugin.offered
    if not (isinstance(effect.sensors, tuple) and {*effect.sensors} <= {"gyro", "accel"}):
        raise plugin.error(f"has sensors {effect.sensors!r}: expected a tuple of gyro, accel")
    if effect.scope not in get_args(Scope):
        raise plugin.error(f"has scope {effect.scope!r}: expected one of {', '.join(get_args(Scope))}")
    if unknown := sorted({*effect.nonlinear} - effect.model_fields.keys()):
        raise plugin.error(f"has nonlinear parameters that are none of its fields: {', '.join(unknown)}")
    own = [base for base in effect.__mro__ if base.__module__.partition(".")[0] not in _FOREIGN_TO_PLUGINS]
    defined = {name: what for base in reversed(own) for name, what in vars(base).items()}
    for name, what in defined.items():
        if name.startswith("_"):
            continue
        if isinstance(what, FunctionType):
            setattr(effect, name, _checked(plugin, name, what))
        elif isinstance(what, classmethod):
            setattr(effect, name, classmethod(_checked(plugin, name, what.__func__)))
        elif isinstance(what, property) and what.fget is not None:
            setattr(effect, name, property(_checked(plugin, name, what.fget)))
    _try(plugin, effect)
    return effect


def _try(plugin: Plugin, effect: type[Effect]) -> None:
    """Run the first and the last effect of the grid over a ramp, whole and in two parts."""
    time_s = np.arange(0.0, 600.0, 10.0)
    turned = np.where(time_s[:, np.newaxis] < 300.0, [0.0, 0.0, 9.8], [9.8, 0.0, 0.0])
    whole, *parts = (
        Drive(time_s[rows], 20.0 + 0.02 * time_s[rows], turned[rows])
        for rows in (slice(None), slice(0, 25), slice(25, None))
    )
    grid = effect.grid(SURVEY)
    for one in (*grid[:1], *grid[1:][-1:]):
        if not isinstance(one.width, int) or one.width < 1:
            raise plugin.error(f"has width {one.width!r}: expected the number of its columns")
        if not {*one.inputs} <= {ACCEL}:
            continue  # what drives it is not in the trial
        fitted, memory = one.with_coefficients(np.ones(one.width)), Memory()
        added = np.concatenate([fitted.added(memory, part) for part in parts])
        if not np.array_equal(added, fitted.added(Memory(), whole)):
            raise plugin.error("adds another bias where its samples are divided otherwise")
        fitted.starts(whole)


def _checked(plugin: Plugin, name: str, method: Callable[..., Any]) -> Callable[..., Any]:
    """Return a method that raises BAD_CONFIG, naming the plug-in, for what it raises or wrongly returns."""

    @functools.wraps(method)
    def call(*given: Any, **named: Any) -> Any:
        try:
            result = method(*given, **named)
        except ImumonError:
            raise
        except Exception as error:  # whatever somebody else's code raises
            raise plugin.error(f"failed in {name}: {described(error, __file__)}") from error
        if wrong := _wrong(name, result, [*given, *named.values()]):
            raise plugin.error(f"returned from {name} {wrong}")
        return result

    return call


def _wrong(name: str, result: object, given: list[Any]) -> str:
    """Return what is wrong with the result of a method; empty if nothing is."""
    if name in ("grid", "driven", "of_curve", "refined"):
        is_list = isinstance(result, list) and all(isinstance(one, Effect) for one in result)
        return "" if is_list else f"a {type(result).__name__}: expected a list of effects"
    if name not in ("added", "simulate", "advance", "columns"):
        return ""
    n = len(given[-1])
    shape = (n,) if name in ("added", "simulate") else (n, given[0].width)
    if not isinstance(result, np.ndarray):
        return f"a {type(result).__name__}: expected an array of shape {shape}"
    if result.shape != shape:
        return f"an array of shape {result.shape}: expected {shape}"
    if result.dtype != np.float64:
        return f"{result.dtype}: expected float64"
    return "" if np.isfinite(result).all() else "values that are not finite"
