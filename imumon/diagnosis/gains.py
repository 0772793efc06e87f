"""Gains of candidates as a table for each channel: the best of each family, alone, in pairs, and pooled."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np

from imumon.blocks import FloatArray, IntArray
from imumon.diagnosis.candidates import Candidate, Part, Pool
from imumon.diagnosis.search import Likelihood, Noise, Target, parameters
from imumon.effects.library import EFFECTS

PROVEN = 8.0
"""Gain, a difference of BIC, above which an effect is proven."""
SHORT_LIST = 6
"""Best candidates of each family, by the coarse grid of noise, that are looked at closely."""
PAIR_LIST = 4
"""Best candidates of each family that are tried in pairs."""

TIE = 1e-3
"""Gain that decides between the members of a pair, which have that of the pair."""


@dataclass(slots=True)
class Table:
    """Gains of all candidates for one channel.

    `fit` is twice the log-likelihood ratio less the price of the linear parameters, `penalty` the price of
    the others; the first `common` candidates are the same for all channels.  `together` holds the families
    that are needed in pairs, where a pair does better than any single candidate (see `paired`).
    """

    candidates: list[Candidate]
    gain: FloatArray
    fit: FloatArray
    noise: dict[int, Noise]
    common: int
    penalty: FloatArray
    together: dict[str, tuple[float, int]] = field(default_factory=dict)
    partner: dict[str, str] = field(default_factory=dict)

    def families(self) -> list[IntArray]:
        """Return the best few candidates of each family."""
        names = np.array([candidate.family for candidate in self.candidates])
        found = []
        for name in dict.fromkeys(names.tolist()):
            which = np.flatnonzero(names == name)
            found.append(which[np.argsort(-self.gain[which])[:SHORT_LIST]])
        return found

    def best(self) -> dict[str, tuple[float, int]]:
        """Return the best gain of each family, alone or in a pair that needs it, and which candidate has
        it."""
        alone = {
            self.candidates[int(which[0])].family: (float(self.gain[which[0]]), int(which[0]))
            for which in self.families()
        }
        return {**alone, **self.together}


def pooled_gains(tables: Sequence[Table]) -> dict[str, float]:
    """Return the gain of each family over the channels that show something, nonlinear parameters shared."""
    shown = [table for table in tables if table.gain.max() > PROVEN]
    if len(shown) < 2:
        return {}
    common = shown[0].common
    total = sum(table.fit[:common] for table in shown) - shown[0].penalty[:common]
    pooled: dict[str, float] = {}
    for at in range(common):
        name = shown[0].candidates[at].family
        pooled[name] = max(pooled.get(name, -np.inf), float(total[at]))
    # Jumps come at times of their own, and loops of several widths differ: there each channel's best counts.
    apart: dict[str, float] = {}
    for table in shown:
        for name, (gain, _) in table.best().items():
            apart[name] = apart.get(name, 0.0) + gain
    return {name: max(gain, apart[name]) for name, gain in pooled.items()}


def joined_events(table: Table) -> list[Candidate]:
    """Return events in several runs at once, made of the best of each run."""
    found: list[Candidate] = []
    for name in dict.fromkeys(one.family for one in table.candidates if EFFECTS[one.family].scope == "event"):
        best: dict[int, tuple[float, Part]] = {}
        for gain, candidate in zip(table.gain.tolist(), table.candidates, strict=True):
            if candidate.family == name:
                part = candidate.parts[0]
                best[part.runs[0]] = max(best.get(part.runs[0], (-np.inf, part)), (gain, part), key=_first)
        order = [part for _, part in sorted(best.values(), key=_first, reverse=True)]
        found += [Candidate(name, tuple(order[:count])) for count in range(2, len(order) + 1)]
    return found


def _first(item: tuple[float, Part]) -> float:
    return item[0]


def paired(
    likelihood: Likelihood, pool: Pool, target: Target, null: float, table: Table, grid: Sequence[Noise]
) -> tuple[dict[str, tuple[float, int]], dict[str, str]]:
    """Return the families that are needed in pairs, with the gain of their best pair; none where one is
    enough.

    Two effects at once hide one another: the one that stands in best for both may be neither.  A pair
    counts when it does better than every single candidate and needs both its members.  Free starts are left
    out: with one, a lag can do as a warm-up.
    """
    members = [at for which in _without_start(table) for at in which]
    pairs = [
        (one, other)
        for one, other in combinations(members, 2)
        if table.candidates[one].family != table.candidates[other].family
    ]
    if not pairs:
        return {}, {}
    both = [[term for at in pair for term in pool.terms(table.candidates[at])[0]] for pair in pairs]
    fit = likelihood.scan([target], pool, both, grid).likelihood[0]
    logarithm = np.log(likelihood.n)
    price = np.array([sum(_price(table, pool, at) for at in pair) for pair in pairs]) * logarithm
    gain = 2 * (fit - null) - price
    if gain.max() <= table.gain.max() + PROVEN:
        return {}, {}
    found: dict[str, tuple[float, int]] = {}
    partner: dict[str, str] = {}
    highest: dict[str, float] = {}
    for (one, other), value in zip(pairs, gain.tolist(), strict=True):
        if value - max(table.gain[one], 0.0) <= PROVEN or value - max(table.gain[other], 0.0) <= PROVEN:
            continue
        for at, beside in ((one, other), (other, one)):
            name = table.candidates[at].family
            if value > highest.get(name, table.gain.max()):
                highest[name] = value
                found[name] = value - TIE * _second(table, at, beside), at
                partner[name] = table.candidates[beside].family
    return found, partner


def _second(table: Table, at: int, beside: int) -> int:
    """Return how much a member of a pair is behind the other: what carries over to another run goes first,
    then what says more alone."""
    own = [EFFECTS[table.candidates[one].family].scope in ("run", "event") for one in (at, beside)]
    return 2 * (own[0] and not own[1]) + bool(table.gain[at] < table.gain[beside])


def _without_start(table: Table) -> list[IntArray]:
    names = np.array([candidate.family for candidate in table.candidates])
    allowed = np.array([not candidate.free_start for candidate in table.candidates])
    found = []
    for name in dict.fromkeys(names.tolist()):
        which = np.flatnonzero((names == name) & allowed)
        found.append(which[np.argsort(-table.gain[which])[:PAIR_LIST]])
    return found


def _price(table: Table, pool: Pool, at: int) -> int:
    candidate = table.candidates[at]
    return parameters(candidate, pool.terms(candidate)[0])
