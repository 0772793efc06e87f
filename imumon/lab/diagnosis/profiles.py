"""Courses of temperature, and poses, that a next experiment may be: from simple to long."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from imumon.effects.base import LEAST_SPAN_DEGC
from imumon.simulation.unit.motion import Turn
from imumon.simulation.unit.scenario import Chamber, Step
from imumon.simulation.unit.thermal import chamber_knots

SHORTEST_S = 1800.0
SETTLED = 5.0
"""Time constants after which a lag has decayed, or a warm-up."""
SOAKS_S = (300.0, 1800.0)
REPEATS = (1, 2, 4, 8)
HELD_S = (3600.0, 7200.0, 14400.0, 28800.0)
SLOWER = 4.0
"""Two rates of temperature that a lag tells apart well."""
POSES = (Turn(kind="turn", at_s=0.0, duration_s=10.0, roll_deg=90.0),) * 3 + (
    Turn(kind="turn", at_s=0.0, duration_s=10.0, roll_deg=90.0, pitch_deg=90.0),
    Turn(kind="turn", at_s=0.0, duration_s=10.0, pitch_deg=-180.0),
)
"""From level to each side, upside down, and to both ends."""


@dataclass(frozen=True, slots=True)
class Profile:
    """One experiment."""

    title: str
    chamber: Chamber
    duration_s: float
    turns: tuple[Turn, ...] = ()


def profiles(
    low: float, high: float, fastest: float, slowest_s: float, most_s: float, poses: bool
) -> list[Profile]:
    """Return the experiments that last at most `most_s`, the shortest first.

    The unit was trained from `low` to `high`, °C, and reached the rate `fastest`, °C/min; `slowest_s` is the
    longest time constant of the effects in question (0 without one); with `poses` it has to be turned.
    """
    found = [_held(0.5 * (low + high), held_s) for held_s in HELD_S]
    if high - low >= LEAST_SPAN_DEGC and fastest > 0.0:
        soaks = {*SOAKS_S, min(max(SETTLED * slowest_s, SOAKS_S[0]), 2.0 * SOAKS_S[1])}
        found += [
            one
            for soak_s in sorted(soaks)
            for count in REPEATS
            for one in _thermal(low, high, fastest, soak_s, count)
        ]
    if poses:
        found = [_in_poses(one) for one in found]
    return sorted((one for one in found if one.duration_s <= most_s), key=lambda one: one.duration_s)


def _held(at: float, held_s: float) -> Profile:
    title = f"switched on in equilibrium at {at:.0f} °C and held"
    return Profile(title, Chamber(start_degc=at, steps=[Step(hold_s=held_s)]), held_s)


def _thermal(low: float, high: float, rate: float, soak_s: float, count: int) -> list[Profile]:
    def to(target: float, how_fast: float = rate, soak: float = soak_s) -> Step:
        return Step(to_degc=target, rate_degc_per_min=how_fast, hold_s=soak)

    quarter = 0.25 * (high - low)
    stairs = [to(low + at * quarter) for at in (1, 2, 3, 4, 3, 2, 1, 0)]
    inner = [to(low + at * quarter, soak=0.0) for at in (4, 2, 4, 0, 2, 0)]
    soak = f"soaks of {soak_s / 60:.0f} min"
    shapes: list[tuple[str, Sequence[Step]]] = [
        (f"warmed and cooled at {rate:.2g} °C/min with {soak}", [to(high), to(low)]),
        (
            f"warmed and cooled at {rate:.2g} and {rate / SLOWER:.2g} °C/min with {soak}",
            [to(high), to(low), to(high, rate / SLOWER), to(low, rate / SLOWER)],
        ),
        (f"in stairs of a quarter of the span with {soak}", stairs),
        ("turned round inside the span", inner),
    ]
    return [_profile(title, low, steps, count) for title, steps in shapes]


def _profile(title: str, start: float, steps: Sequence[Step], count: int) -> Profile:
    chamber = Chamber(start_degc=start, steps=[*steps] * count)
    duration_s = max(float(chamber_knots(chamber)[0][-1]), SHORTEST_S)
    times = f", {count} times" if count > 1 else ""
    return Profile(f"from {start:.0f} °C {title}{times}", chamber, duration_s)


def _in_poses(profile: Profile) -> Profile:
    """Return an experiment in which the unit is turned at equal intervals, into six poses."""
    every = profile.duration_s / (len(POSES) + 1)
    turns = tuple(turn.model_copy(update={"at_s": (at + 1) * every}) for at, turn in enumerate(POSES))
    return Profile(f"{profile.title}, in six poses", profile.chamber, profile.duration_s, turns)
