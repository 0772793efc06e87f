"""Effects of other packages: what is wrong with one is an error that names it and its package."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Literal, Self

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.effects.base import Drive, DrivenEffect, Effect, Memory, Survey
from imumon.effects.kinds import guarded, is_effect
from imumon.effects.since_power_on import Drift
from imumon.errors import ImumonError, Reason
from imumon.plugins import EFFECTS, Plugin


def creep(columns: Callable[[FloatArray], Any]) -> type[Effect]:
    """Return a new effect of another package, which makes its columns of the time."""

    class Creep(Effect):
        kind: Literal["creep"] = "creep"

        @classmethod
        def grid(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - as an effect has it
            return [cls()]

        def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - as an effect has it
            result: FloatArray = columns(drive.time_s)
            return result

    return Creep


def plugin(effect: type[Effect]) -> Plugin:
    return Plugin(EFFECTS, "creep", "their-package", "1.2", effect)


def hours(time_s: FloatArray) -> FloatArray:
    return time_s[:, np.newaxis] / 3600.0


def fails(_: FloatArray) -> FloatArray:
    raise ZeroDivisionError("of theirs")


def until_an_hour(time_s: FloatArray) -> FloatArray:
    return np.where(time_s < 3600.0, 1.0, np.nan)[:, np.newaxis]


def test_an_effect_without_fault_gives_its_own_numbers() -> None:
    effect = guarded(plugin(creep(hours)))
    drive = Drive(np.array([0.0, 3600.0]), np.full(2, 25.0))
    assert effect().with_coefficients([2.0]).simulate(drive).tolist() == [0.0, 2.0]


def test_an_effect_of_a_driver_needs_no_operator() -> None:
    class Creep(DrivenEffect):
        kind: Literal["creep"] = "creep"
        free_start = True

        @classmethod
        def grid(cls, survey: Survey) -> list[Self]:  # noqa: ARG003 - as an effect has it
            return [cls()]

        def advance(self, memory: Memory, drive: Drive) -> FloatArray:  # noqa: ARG002 - as an effect has it
            return drive.of(self.driver)[:, np.newaxis]

    effect = guarded(plugin(Creep))
    assert issubclass(effect, DrivenEffect)
    assert [effect().label, effect(driver="supply").label] == ["creep", "creep(supply)"]


def test_an_effect_may_have_a_field_in_degrees() -> None:
    """Its name lost its end, as keys of the first format do."""

    class Stuck(DrivenEffect):
        kind: Literal["stuck"] = "stuck"
        gap_degc: float = 0.5

    assert Stuck.model_validate({"gap_degc": 2.0}).gap_degc == 2.0


@pytest.mark.parametrize(
    ("columns", "said"),
    [
        (fails, "failed in advance: ZeroDivisionError: of theirs (at "),
        (lambda t: t, "returned from advance ((2,), dtype('float64')): expected an array of float64"),
        (lambda t: np.ones((len(t), 2)), "advance ((2, 2), dtype('float64')): expected an array of float64"),
        (lambda t: np.ones((len(t), 1), np.float32), "advance ((2, 1), dtype('float32')): expected an array"),
        (until_an_hour, "from advance values that are not finite"),
        (lambda _: None, "from advance ('NoneType', ''): expected an array"),
    ],
)
def test_what_is_wrong_with_columns_is_an_error_that_names_the_package(
    columns: Callable[[FloatArray], Any], said: str
) -> None:
    effect = guarded(plugin(creep(columns)))().with_coefficients([1.0])
    for use in (effect.simulate, lambda drive: effect.added(Memory(), drive)):
        with pytest.raises(ImumonError) as caught:
            use(Drive(np.array([0.0, 7200.0]), np.full(2, 25.0)))
        assert caught.value.reason is Reason.BAD_CONFIG
        assert caught.value.seen.startswith("the plug-in creep of their-package (imumon.effects) ")
        assert said in caught.value.seen


def test_an_effect_has_the_name_under_which_it_is_offered() -> None:
    class Typed(Drift):
        kind: str = "creep"  # type: ignore[assignment]

    assert is_effect("creep", creep(hours))
    for name, offered in (("other", creep(hours)), ("drift", Drift), ("creep", 3), ("creep", Typed)):
        assert not is_effect(name, offered)
