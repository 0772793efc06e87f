"""Effects of other packages: checked at load, and columns that are wrong later are an error that names it."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, get_args

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import ACCEL, Drive, Effect, Memory, Scope, Survey
from imumon.effects.kinds import KINDS
from imumon.errors import ImumonError
from imumon.plugins import Plugin, described

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
