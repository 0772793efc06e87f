"""One step of the forward selection: which effect, on which axes, by what candidates gain on each of them.

One package has one physics, so what an effect gains on several axes adds up; the choice of one of e effects
on any of the sets of m axes costs 2 ln(e (2^m - 1)) (extended BIC: Chen & Chen 2008,
doi:10.1093/biomet/asn034).  Gains see `imumon.lab.diagnosis.search`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from imumon.lab.diagnosis.candidates import Candidate

PROVEN = 8.0
"""Gain above which an effect is proven: e^-4 by chance."""
CLOSE = 10.0
"""Families whose gains differ by less are not told apart."""
CLOSE_SHARE = 0.15
"""Nor those that differ by less than this share of the best gain: no regressor has exactly the shape of the
physics, and with a large effect the shape decides."""


class Scored(NamedTuple):
    """A candidate with its gain over the model so far.

    `fit` is the gain without the price of the nonlinear parameters and of the choice.  `partner` names the
    effect beside which it gains so much, where neither gains it alone.
    """

    candidate: Candidate
    gain: float
    fit: float
    partner: str = ""

    @property
    def family(self) -> str:
        """Name of its effect."""
        return self.candidate.family


Table = Mapping[str, Scored]
"""The best candidate of each family."""


class Selection(NamedTuple):
    """Effects of which channels lack one, the one that is chosen first; these data do not tell them apart.
    `gain` is what it gains on all of these channels."""

    names: list[str]
    channels: list[str]
    gain: float


@dataclass(slots=True, eq=False)
class Finding:
    """An effect that was chosen for a channel, or that the present model has.

    `gain` is that over the model before it, `pooled_gain` the same summed over the channels that show it, and
    `rivals` has the gain of every family at that stage.
    """

    candidate: Candidate
    """With refined parameters; coefficients come with the fit."""
    gain: float = 0.0
    pooled_gain: float = 0.0
    rivals: dict[str, float] = field(default_factory=dict)
    others: dict[str, Candidate] = field(default_factory=dict)
    """The best of each other family that cannot be told apart from it."""
    size: float = 0.0
    """rms of what it took away from training when it was found."""
    by_test: bool = False
    """Whether the test alone proves it."""
    known: bool = False
    """Whether it is of the present model, and fitted anew."""

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.candidate.family

    @property
    def alike(self) -> list[str]:
        """It and the families that cannot be told apart from it; empty when there is no other."""
        return [self.name, *self.others] if self.others else []

    def becomes(self, candidate: Candidate) -> None:
        """Take another candidate, of its family or of one that is not told apart from it."""
        if candidate.family != self.name:
            del self.others[candidate.family]
            self.others = {self.name: self.candidate, **self.others}
        self.candidate = candidate


def least_gain(effects: int, channels: int) -> float:
    """Return the gain that proves one of so many effects on any set of so many channels."""
    return PROVEN + 2.0 * float(np.log(max(1, effects) * (2**channels - 1)))


def select(tables: Mapping[str, Table], least: float, there: Mapping[str, Sequence[str]]) -> Selection | None:
    """Return the effect that gains most on all the channels that show it, if that is more than `least`.

    Of effects that gain alike, what carries over goes before an event, and what is `there` already before
    what is new.
    """
    names = dict.fromkeys(name for table in tables.values() for name in table)
    on = {name: [channel for channel in tables if _shows(tables[channel], name, least)] for name in names}
    total = {name: sum(tables[channel][name].gain for channel in on[name]) for name in names}
    proven = [name for name in names if total[name] > least]
    if not proven:
        return None
    close = [name for name in proven if _near(total[name], max(total.values()))]

    def order(name: str) -> tuple[bool, bool, float]:
        carries = tables[on[name][0]][name].candidate.scope != "event"
        return carries, any(name in there.get(channel, ()) for channel in on[name]), total[name]

    chosen = max(close, key=order)
    channels = on[chosen]
    together = {
        name: sum(tables[channel][name].gain if name in tables[channel] else -np.inf for channel in channels)
        for name in names
    }
    apart = {chosen, *(tables[channel][chosen].partner for channel in channels)}
    alike = [name for name in names if together[name] > least and _near(together[name], total[chosen])]
    others = sorted((name for name in alike if name not in apart), key=lambda name: -together[name])
    return Selection([chosen, *others], channels, total[chosen])


def _shows(table: Table, name: str, least: float) -> bool:
    """Return whether a channel shows an effect, and does not prove another in its place.

    An event has a time of its own in each channel, so that each has to prove its own.
    """
    if name not in table:
        return False
    best = max(one.gain for one in table.values())
    own = PROVEN if table[name].candidate.scope == "event" else 0.0
    return table[name].gain > max(own, best - max(least, CLOSE_SHARE * best))


def _near(gain: float, best: float) -> bool:
    """Return whether a gain is too near to the best for a proof."""
    return best - gain < max(CLOSE, CLOSE_SHARE * best)
