"""What the axes of a sensor lack together, by what effects gain on each."""

from __future__ import annotations

import math

import pytest

from imumon.diagnosis.gains import PROVEN
from imumon.diagnosis.lacks import Gains, Ways, lacks

EFFECTS = ("drift", "warm_up", "curve(pressure)")
PRICE = 2.0 * math.log(2 * 7)
"""Of two usual effects on any of the seven sets of three channels."""


def ways(choice: float = 0.0, **shared: float) -> Ways:
    """Return the ways of three effects with own parameters, the last of another driver, and shared ones."""
    effect = {name: name for name in EFFECTS} | {f"{name}, shared": name for name in shared}
    cost = {"drift": 0.0, "warm_up": 0.0, "curve(pressure)": choice}
    return Ways(effect, cost | {f"{name}, shared": paid for name, paid in shared.items()}, 2)


def axes(drift: tuple[float, ...], warm_up: tuple[float, ...] = (-9.0, -9.0, -9.0)) -> dict[str, Gains]:
    """Return what these gain on the axes."""
    return {
        axis: {"drift": one, "warm_up": other, "curve(pressure)": -9.0}
        for axis, one, other in zip("xyz", drift, warm_up, strict=True)
    }


def test_what_no_axis_proves_is_named_where_they_prove_it_together() -> None:
    each = (PRICE + PROVEN) / 3.0 + 0.1
    assert lacks({"x": axes((each,) * 3)["x"]}, ways()) == []
    (one,) = lacks(axes((each,) * 3), ways())
    assert (one.names, one.channels) == (["drift"], ["x", "y", "z"])
    assert one.gain == pytest.approx(3.0 * each - PRICE)
    assert lacks(axes((each, each, -9.0)), ways()) == []


def test_an_axis_agrees_with_the_others_unless_it_proves_another_by_itself() -> None:
    (one,) = lacks(axes((60.0, 60.0, 12.0), (0.0, 0.0, 24.0)), ways())
    assert (one.names, one.channels) == (["drift"], ["x", "y", "z"])
    both = lacks(axes((60.0, 60.0, 12.0), (0.0, 0.0, 60.0)), ways())
    assert {name: one.channels for one in both for name in one.names} == {
        "drift": ["x", "y"],
        "warm_up": ["z"],
    }


def test_what_is_not_told_apart_is_named_the_likelier_first() -> None:
    (one,) = lacks(axes((40.0, 40.0, 40.0), (43.0, 41.0, 35.0)), ways())
    assert one.names == ["drift", "warm_up"]


def test_shared_parameters_are_paid_for_once() -> None:
    gains = {axis: {**own, "warm_up, shared": 22.0} for axis, own in axes((20.0,) * 3, (16.0,) * 3).items()}
    (one,) = lacks(gains, ways(warm_up=5.0))
    assert (one.way, one.names) == ("warm_up, shared", ["warm_up", "drift"])


def test_another_driver_pays_for_the_choice_once_for_all_axes() -> None:
    own = {"drift": -9.0, "warm_up": -9.0, "curve(pressure)": 20.0}
    (one,) = lacks(dict.fromkeys("xyz", own), ways(choice=11.0))
    assert one.gain == pytest.approx(60.0 - 11.0 - PRICE)
    assert lacks({"x": own}, ways(choice=11.0)) == []
