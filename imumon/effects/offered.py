"""Effects of other packages: checked at load, and whatever one does wrong later is an error that names it."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from types import FunctionType
from typing import Any, get_args

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, Effect, Memory, Scope, Survey
from imumon.errors import ImumonError
from imumon.plugins import Plugin, described

EFFECT = "effect of that name"
"""What a plug-in offers in the group `imumon.plugins.EFFECTS`, in words."""
SURVEY = Survey((7200.0, 7200.0), 30.0, 4, 19.6, 30.0, 3, 25.0, 15.0)
"""Two runs of two hours over 30 °C in which the unit is turned over: they can show nearly any effect."""
TRIED = 5
"""So many effects of the grid are tried at load."""
_FOREIGN_TO_PLUGINS = ("imumon", "pydantic", "builtins", "abc", "typing")


def is_effect(name: str, offered: object) -> bool:
    """Tell whether an effect is offered, under the name that its kind has and that none of imumon's has."""
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
    _check_attributes(plugin, effect)
    for name in dir(effect):
        defined = next((vars(base)[name], base) for base in effect.__mro__ if name in vars(base))
        if name.startswith("_") or defined[1].__module__.partition(".")[0] in _FOREIGN_TO_PLUGINS:
            continue
        what = defined[0]
        if isinstance(what, FunctionType):
            setattr(effect, name, _checked(plugin, name, what))
        elif isinstance(what, classmethod):
            setattr(effect, name, classmethod(_checked(plugin, name, what.__func__)))
        elif isinstance(what, property) and what.fget is not None:
            setattr(effect, name, property(_checked(plugin, name, what.fget)))
    _try(plugin, effect)
    return effect


def _check_attributes(plugin: Plugin, effect: type[Effect]) -> None:
    if not (isinstance(effect.sensors, tuple) and {*effect.sensors} <= {"gyro", "accel"}):
        raise plugin.error(f"has sensors {effect.sensors!r}: expected a tuple of gyro, accel")
    if effect.scope not in get_args(Scope):
        raise plugin.error(f"has scope {effect.scope!r}: expected one of {', '.join(get_args(Scope))}")
    if unknown := sorted({*effect.nonlinear} - effect.model_fields.keys()):
        raise plugin.error(f"has nonlinear parameters that are none of its fields: {', '.join(unknown)}")


def _try(plugin: Plugin, effect: type[Effect]) -> None:
    """Run some effects of the grid over a ramp, whole and in two parts."""
    time_s = np.arange(0.0, 600.0, 10.0)
    turned = np.where(time_s[:, np.newaxis] < 300.0, [0.0, 0.0, 9.8], [9.8, 0.0, 0.0])
    drive = Drive(time_s, 20.0 + 0.02 * time_s, turned)
    parts = [_rows(drive, slice(0, 25)), _rows(drive, slice(25, None))]
    for one in effect.grid(SURVEY)[:TRIED]:
        if not isinstance(one.width, int) or one.width < 1:
            raise plugin.error(f"has width {one.width!r}: expected the number of its columns")
        if one.inputs and {*one.inputs} != {"accel"}:
            continue  # what drives it is not in the trial
        fitted = one.with_coefficients(np.ones(one.width))
        memory = Memory()
        added = np.concatenate([fitted.added(memory, part) for part in parts])
        if not np.array_equal(added, fitted.added(Memory(), drive)):
            raise plugin.error("adds another bias where its samples are divided otherwise")
        fitted.starts(drive)


def _rows(drive: Drive, rows: slice) -> Drive:
    assert drive.accel is not None
    return Drive(drive.time_s[rows], drive.temperature_degc[rows], drive.accel[rows])


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
        if wrong := RESULTS.get(name, _anything)(result, [*given, *named.values()]):
            raise plugin.error(f"returned from {name} {wrong}")
        return result

    return call


def _anything(_: object, __: list[Any]) -> str:
    return ""


def _list_of_effects(result: object, _: list[Any]) -> str:
    if isinstance(result, list) and all(isinstance(one, Effect) for one in result):
        return ""
    return f"a {type(result).__name__}: expected a list of effects"


def _of_each_sample(result: object, given: list[Any]) -> str:
    return _array(result, (len(given[-1]),))


def _matrix(result: object, given: list[Any]) -> str:
    return _array(result, (len(given[-1]), given[0].width))


def _array(result: object, shape: tuple[int, ...]) -> str:
    """Return what is wrong with an array, empty if nothing is."""
    if not isinstance(result, np.ndarray):
        return f"a {type(result).__name__}: expected an array of shape {shape}"
    if result.shape != shape:
        return f"an array of shape {result.shape}: expected {shape}"
    if result.dtype != np.float64:
        return f"{result.dtype}: expected float64"
    values: FloatArray = result
    return "" if np.isfinite(values).all() else "values that are not finite"


RESULTS: Mapping[str, Callable[[object, list[Any]], str]] = {
    "grid": _list_of_effects,
    "driven": _list_of_effects,
    "of_curve": _list_of_effects,
    "refined": _list_of_effects,
    "advance": _matrix,
    "columns": _matrix,
    "added": _of_each_sample,
    "simulate": _of_each_sample,
}
"""What is wrong with the result of a method, by its name."""
