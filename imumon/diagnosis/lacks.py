"""Which effect the axes of a sensor lack, by what each effect gains on each of them.

One package has one physics, so an effect may be missing on any of the axes, and what it gains on these adds
up.  A gain in BIC is twice the logarithm of a Bayes factor, which is a martingale while nothing is missing:
it ever exceeds g with a probability of exp(-g / 2) at most, however often one looks (Ville 1939; Shafer et
al. 2011, doi:10.1214/10-STS347).  The choice is paid for (extended BIC: Chen & Chen 2008).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from imumon.diagnosis.search import CLOSE, CLOSE_SHARE, PROVEN

Gains = Mapping[str, float]
"""Gain in BIC of each effect on one axis."""


@dataclass(frozen=True, slots=True)
class Lack:
    """Effects of which channels lack one, the likeliest first; these data do not tell them apart."""

    names: list[str]
    channels: list[str]


def proof(effects: int, channels: int) -> float:
    """Return the gain that proves one of so many effects on any set of channels."""
    return PROVEN + 2.0 * math.log(max(1, effects) * (2**channels - 1))


def lacks(gains: Mapping[str, Gains], least: float) -> list[Lack]:
    """Return what channels lack whose gains add up to more than `least`; each lacks one effect."""
    found, left = list[Lack](), dict(gains)
    while left:
        names = dict.fromkeys(name for own in left.values() for name in own)
        on = {name: [channel for channel, own in left.items() if _shows(own, name, least)] for name in names}
        total = {name: sum(left[channel][name] for channel in those) for name, those in on.items()}
        first = max(total, key=total.__getitem__, default="")
        if total.get(first, 0.0) <= least:
            break
        together = {name: sum(left[channel].get(name, -math.inf) for channel in on[first]) for name in names}
        near = [name for name in names if name != first and _near(together[name], total[first])]
        found.append(Lack([first, *sorted(near, key=lambda name: -together[name])], on[first]))
        left = {channel: own for channel, own in left.items() if channel not in on[first]}
    return found


def _shows(own: Gains, name: str, least: float) -> bool:
    """Tell whether a channel shows an effect, and does not prove another in its place."""
    best = max(own.values())
    return own.get(name, -math.inf) > max(0.0, best - max(least, CLOSE_SHARE * best))


def _near(gain: float, best: float) -> bool:
    return best - gain < max(CLOSE, CLOSE_SHARE * best)
