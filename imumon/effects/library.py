"""The effects of imumon and of other packages, by the name of their kind."""

from typing import TYPE_CHECKING, Annotated, Union

from pydantic import AfterValidator, Field

from imumon.plugins import EFFECTS as OFFERED
from imumon.plugins import plugins

from .base import Effect
from .kinds import EFFECT, KINDS, OTHERWISE, SEPARATED_BY, guarded, is_effect

EFFECTS = KINDS | {plugin.name: guarded(plugin) for plugin in plugins(OFFERED, EFFECT, is_effect)}


def effects_for(channel: str) -> list[str]:
    """Return the effects that a channel may have; what is no gyro may have what an accelerometer may."""
    sensor = "gyro" if channel.startswith("gyro") else "accel"
    return [name for name, effect in EFFECTS.items() if sensor in effect.sensors]


def _complete(effect: Effect) -> Effect:
    if len(effect.coefficients) != effect.width:
        raise ValueError(
            f"{effect.name} needs {effect.width} coefficients, there are {len(effect.coefficients)}"
        )
    return effect


if TYPE_CHECKING:
    AnyEffect = Effect
else:
    _EachKind = Union[tuple(EFFECTS.values())]  # noqa: UP007 - made of a list
    AnyEffect = Annotated[_EachKind, Field(discriminator="kind"), AfterValidator(_complete)]
    """An effect as it stands in a model file or a unit file; its kind names it."""


def separated_by(one: str, other: str) -> str:
    """Return what to record to separate two effects, given by their labels."""
    driven = [name for name in (one, other) if "(" in name]
    if one.partition("(")[2] != other.partition("(")[2]:
        return f"a run in which what {' and '.join(driven)} depends on goes another way than the rest"
    if driven:
        return f"a run in which what {one} depends on goes up and down at two rates, and is held in between"
    return SEPARATED_BY.get((min(one, other), max(one, other)), OTHERWISE)


def suspected_by(trait: str) -> tuple[str, ...]:
    """Return the effects that make the innovations of a bias filter do this."""
    return tuple(name for name, effect in EFFECTS.items() if trait in effect.suspected_by)
