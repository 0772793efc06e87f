"""What the axes of a sensor lack together, by what effects gain on each."""

from __future__ import annotations

import numpy as np

from imumon.effects.since_power_on import Drift, WarmUp
from imumon.lab.diagnosis.candidates import Candidate, GainTable, Part, Scored
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.search import Selection, gain_bar, select
from tests.lab.diagnosis.units import three

BAR = gain_bar(2, 3)


def axes(drift: tuple[float, ...], warm_up: tuple[float, ...] = (-9.0, -9.0, -9.0)) -> dict[str, GainTable]:
    """Return what these gain on the axes."""
    made = {"drift": Part(Drift()), "warm_up": Part(WarmUp(time_constant_s=200.0))}
    return {
        axis: {
            name: Scored(Candidate((made[name],)), gain, gain)
            for name, gain in (("drift", one), ("warm_up", other))
        }
        for axis, one, other in zip("xyz", drift, warm_up, strict=True)
    }


def lacks(tables: dict[str, GainTable], bar: float) -> list[Selection]:
    """Return what the axes lack, each one effect."""
    found, left = list[Selection](), dict(tables)
    while (lack := select(left, bar)) is not None:
        found.append(lack)
        left = {name: table for name, table in left.items() if name not in lack.channels}
    return found


def test_what_no_axis_proves_is_named_where_they_prove_it_together() -> None:
    each = BAR / 3.0 + 0.1
    assert lacks({"x": axes((each,) * 3)["x"]}, BAR) == []
    (one,) = lacks(axes((each,) * 3), BAR)
    assert ([one.family, *one.alternatives], one.channels) == (["drift"], ["x", "y", "z"])
    assert lacks(axes((each, each, -9.0)), BAR) == []


def test_an_axis_agrees_with_the_others_unless_it_proves_another_by_itself() -> None:
    (one,) = lacks(axes((60.0, 60.0, 12.0), (0.0, 0.0, 24.0)), BAR)
    assert ([one.family, *one.alternatives], one.channels) == (["drift"], ["x", "y", "z"])
    both = lacks(axes((60.0, 60.0, 12.0), (0.0, 0.0, 60.0)), BAR)
    assert {name: one.channels for one in both for name in [one.family, *one.alternatives]} == {
        "drift": ["x", "y"],
        "warm_up": ["z"],
    }


def test_what_is_not_told_apart_is_named_the_likelier_first() -> None:
    (one,) = lacks(axes((40.0, 40.0, 40.0), (43.0, 41.0, 35.0)), BAR)
    assert [one.family, *one.alternatives] == ["drift", "warm_up"]


def test_half_of_a_pair_is_dropped_whose_other_half_was_refused() -> None:
    """It stayed as a single finding, with what it gains beside the other alone."""
    walk = 0.1 * np.cumsum(np.random.default_rng(3).standard_normal(2400))
    train, test = three(lambda _, degc: walk + 0.0 * degc)
    (verdict,) = diagnose(train, test).verdicts
    axis, drift = verdict.search, Candidate((Part(Drift()),))
    for partner in ("", "warm_up"):
        axis.findings, axis.tables = [], [{"drift": Scored(drift, 55.0, 60.0, partner)}]
        assert axis.add(Selection("drift", [], ["gyro_x"], 55.0))
        axis.eliminate()
        assert [one.name for one in axis.findings] == ([] if partner else ["drift"])
