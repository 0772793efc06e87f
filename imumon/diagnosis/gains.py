"""Gains of candidates for one channel: the best of each family, alone, in pairs, and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from imumon.diagnosis.candidates import Candidate, Part
from imumon.diagnosis.likelihood import Noise

PROVEN = 8.0
"""Gain, a difference of BIC, above which an effect is proven."""
CLOSE = 10.0
"""Families whose gains differ by less are not told apart."""
CLOSE_SHARE = 0.15
"""Nor those that differ by less than this share of the best gain: no regressor has exactly the shape of the
physics, and with a large effect the shape decides."""
SHORT_LIST = 6
"""Best candidates of each family, by the coarse grid of noise, that are looked at closely."""
PAIR_LIST = 4
"""Best candidates of each family that are tried in pairs."""
OF_OTHERS = 4
"""Families of other drivers than temperature and time of which pairs are tried: the best of the best."""
TIE = 1e-3
"""Gain that decides between the members of a pair, which have that of the pair."""


@dataclass(frozen=True, slots=True)
class Scored:
    """A candidate with its gain over the model so far, in BIC.

    `fit` is twice the log-likelihood ratio less the price of the linear parameters alone.
    """

    candidate: Candidate
    gain: float
    fit: float
    noise: Noise

    @property
    def family(self) -> str:
        """Name of its effect."""
        return self.candidate.family


@dataclass(frozen=True, slots=True)
class Leader:
    """The best of a family; `gain` is that of the pair where it is needed beside a `partner` family."""

    scored: Scored
    gain: float
    partner: str = ""


@dataclass(frozen=True, slots=True)
class Table:
    """All candidates for one channel, the first `common` of which are the same for all, and the leaders."""

    scored: list[Scored]
    common: int
    leaders: dict[str, Leader]

    @property
    def best(self) -> float:
        """The largest gain, alone or in a pair."""
        return max((leader.gain for leader in self.leaders.values()), default=0.0)


def families(scored: Sequence[Scored], count: int) -> dict[str, list[Scored]]:
    """Return the best few candidates of each family, best first."""
    found: dict[str, list[Scored]] = {}
    for one in scored:
        found.setdefault(one.family, []).append(one)
    return {name: sorted(group, key=_worst_first)[:count] for name, group in found.items()}


def _worst_first(one: Scored) -> float:
    return -one.gain


def pooled_gains(tables: Sequence[Table], logarithm: float) -> dict[str, float]:
    """Return the gain of each family over the channels that show something, nonlinear parameters shared.

    `logarithm` is the price of a parameter.
    """
    shown = [table for table in tables if max((one.gain for one in table.scored), default=0.0) > PROVEN]
    if len(shown) < 2:
        return {}
    pooled: dict[str, float] = {}
    for same in zip(*(table.scored[: table.common] for table in shown), strict=True):
        candidate = same[0].candidate
        gain = sum(one.fit for one in same) - candidate.nonlinear * logarithm - candidate.choice
        pooled[same[0].family] = max(pooled.get(same[0].family, -np.inf), gain)
    # Jumps come at times of their own, and loops of several widths differ: there each channel's best counts.
    return {
        name: max(gain, sum(table.leaders[name].gain for table in shown if name in table.leaders))
        for name, gain in pooled.items()
    }


def joined_events(scored: Sequence[Scored]) -> list[Candidate]:
    """Return events in several runs at once, made of the best of each run."""
    best: dict[str, dict[int, Scored]] = {}
    for one in scored:
        if one.candidate.scope == "event":
            runs, run = best.setdefault(one.family, {}), one.candidate.parts[0].runs[0]
            if run not in runs or one.gain > runs[run].gain:
                runs[run] = one
    found = []
    for name, runs in best.items():
        parts: list[Part] = [one.candidate.parts[0] for one in sorted(runs.values(), key=_worst_first)]
        found += [Candidate(name, tuple(parts[:count])) for count in range(2, len(parts) + 1)]
    return found


def pairs_of(scored: Sequence[Scored]) -> list[tuple[Scored, Scored]]:
    """Return the pairs worth trying: the best few of different families.

    Free starts are left out: with one, a lag can do as a warm-up.
    """
    lists = families([one for one in scored if not one.candidate.free_start], PAIR_LIST)
    others = sorted((group[0] for group in lists.values() if group[0].candidate.choice), key=_worst_first)
    members = [one for group in lists.values() for one in group if not one.candidate.choice]
    members += others[:OF_OTHERS]
    return [(one, other) for one, other in combinations(members, 2) if one.family != other.family]


def needed_in_pairs(
    pairs: Sequence[tuple[Scored, Scored]], gains: Sequence[float], alone: float
) -> dict[str, Leader]:
    """Return the leaders of families that are needed in pairs, by the gains of the pairs and the best alone.

    Two effects at once hide one another: the one that replaces both best may be neither.  So a pair
    counts that does better than any single candidate and needs both its members, by more than the shape of
    a single effect may be off: what fits beside the largest is found beside it later.  Of these, what carries
    over to another run goes first, then what says more alone.
    """
    least = max(PROVEN, CLOSE_SHARE * alone)
    if max(gains, default=0.0) <= max(alone, PROVEN) + least:
        return {}
    found: dict[str, tuple[float, Leader]] = {}
    for (one, other), gain in zip(pairs, gains, strict=True):
        if gain - max(one.gain, other.gain, 0.0) <= least:
            continue
        for this, beside in ((one, other), (other, one)):
            if gain > (found[this.family][0] if this.family in found else alone):
                own, others = (part.candidate.scope in ("run", "event") for part in (this, beside))
                behind = 2 * (own and not others) + (this.gain < beside.gain)
                found[this.family] = gain, Leader(this, gain - TIE * behind, beside.family)
    return {name: leader for name, (_, leader) in found.items()}
