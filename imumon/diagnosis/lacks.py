"""What the axes of a sensor lack, by what each effect gains on each of them.

One package has one physics, so an effect may be missing on any of the axes, and what it gains on these adds
up.  A gain in BIC is twice the logarithm of a Bayes factor, which is a martingale while nothing is missing:
it ever exceeds g with a probability of exp(-g / 2) at most, however often one looks (Ville 1939; Shafer et
al. 2011, doi:10.1214/10-STS347).  What one chooses among has to be paid for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imumon.diagnosis.gains import CLOSE, CLOSE_SHARE, PROVEN

Gains = Mapping[str, float]
"""Gain in BIC on one axis, or cost, of each way in which an effect may be there."""


@dataclass(frozen=True, slots=True)
class Ways:
    """The ways in which effects may be missing: with parameters of each channel, or the same for all."""

    effect: dict[str, str]
    """Name of the effect of each way; it is that of the way with parameters of each channel's own."""
    cost: dict[str, float]
    """In BIC, once for all channels: of shared parameters, and of the choice among other drivers."""
    usual: int
    """How many effects of temperature, time or specific force there are."""

    def price(self, channels: int) -> float:
        """Return what it costs to look for any effect on any set of channels (extended BIC: Chen & Chen
        2008)."""
        return 2.0 * float(np.log(max(1, self.usual) * (2**channels - 1)))

    def near(self, total: Gains) -> list[str]:
        """Return the effects that are not told from the best by what their ways gain, the best first."""
        best: dict[str, float] = {}
        for way, gain in total.items():
            best[self.effect[way]] = max(gain, best.get(self.effect[way], -np.inf))
        first = max(best.values())
        least = first - max(CLOSE, CLOSE_SHARE * first)
        return sorted((name for name in best if best[name] > least), key=lambda name: -best[name])


@dataclass(frozen=True, slots=True)
class Lack:
    """A way in which an effect is missing of channels, the effects that are not told from it, it first, and
    the gain of that over all of these channels, less what the choice costs."""

    way: str
    names: list[str]
    channels: list[str]
    gain: float


def lacks(gains: Mapping[str, Gains], ways: Ways) -> list[Lack]:
    """Return what channels lack that is proven, by what each way gains on each of them."""
    price = ways.price(len(gains))
    found, left = list[Lack](), dict(gains)
    while left:
        alone = {
            name: max(gain - ways.cost[way] for way, gain in own.items() if way in ways.cost)
            for name, own in left.items()
        }
        showing = {way: _showing(way, left, alone, price + PROVEN) for way in ways.cost}
        total = {
            way: sum(left[name][way] for name in on) - ways.cost[way] for way, on in showing.items() if on
        }
        first = max(total, key=total.__getitem__, default="")
        if not first or total[first] - price <= PROVEN:
            break
        on = showing[first]
        there = {
            way: sum(left[name][way] for name in on) - cost
            for way, cost in ways.cost.items()
            if all(way in left[name] for name in on)
        }
        found.append(Lack(first, ways.near(there), on, total[first] - price))
        left = {name: own for name, own in left.items() if name not in on}
    return found


def _showing(way: str, gains: Mapping[str, Gains], alone: Gains, proof: float) -> list[str]:
    """Return the channels that show an effect, and do not prove another by what they show by themselves."""
    return [
        name
        for name, own in gains.items()
        if own.get(way, -np.inf) > max(0.0, alone[name] - max(proof, CLOSE_SHARE * alone[name]))
    ]
