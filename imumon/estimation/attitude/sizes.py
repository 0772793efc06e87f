"""How large errors are that nobody has measured: sizes side by side, each with its probability.

An error that does not change, of unknown standard deviation s, comes to light as the unit moves.  What is off
by then has the variance other + gain s², and says how likely each s is (Bayes).  Where several errors add up,
each has sizes of its own, and all combinations have a probability.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from typing import NamedTuple

import numpy as np

from imumon.blocks import FloatArray

ANOTHER = 0.5
"""Cosine between directions from which a look says something new: 60°."""
LEAST = 1e-12
"""What no such probability is below: of an impossible size the logarithm is none."""
COUNT = 5
"""Sizes that are tried: by a factor of three from a percent to all, so that none is off by more than 1.7."""
ANY_SIZE = 1.0 - 1.0 / COUNT
"""The probability by which each of them is as likely."""


@dataclass(frozen=True, eq=False)
class Sizes:
    """Standard deviations and what speaks for each.

    Parameters
    ----------
    squares : array (errors, k)
        Of the standard deviations of each error, the usual one first.
    evidence : array (k, ...)
        Logarithms of the probabilities, up to a constant, an axis for each error.
    """

    squares: FloatArray
    evidence: FloatArray

    @cached_property
    def probabilities(self) -> FloatArray:
        """Return how likely each combination is, (k, ...)."""
        weight = np.exp(self.evidence - self.evidence.max())
        return np.asarray(weight / weight.sum())

    @cached_property
    def mean_square(self) -> FloatArray:
        """Return the mean of s² for each error, (errors,)."""
        weight = self.probabilities
        errors = range(weight.ndim)
        return np.array([weight.sum(tuple(set(errors) - {j})) @ self.squares[j] for j in errors])

    def weighed(self, likely: FloatArray) -> Sizes:
        """Return the same with the logarithm of how likely each combination makes something, (k, ...)."""
        return Sizes(self.squares, self.evidence + likely)

    @staticmethod
    def sums(added: FloatArray) -> FloatArray:
        """Return what each combination adds to a variance, (k, ...), for what each size adds, (errors, k)."""
        return np.asarray(reduce(np.add.outer, list(added)))

    @property
    def usual(self) -> float:
        """Return how likely it is that all errors are as usual."""
        return float(self.probabilities.flat[0])

    def mixed(self, other: Sizes, share: float) -> Sizes:
        """Return these sizes, or with a probability of `share` those of another."""
        with np.errstate(divide="ignore"):
            own, others = np.log((1.0 - share) * self.probabilities), np.log(share * other.probabilities)
        return Sizes(self.squares, np.logaddexp(own, others))

    def seen(self, off2: float, other2: float, added: FloatArray, components: int) -> Sizes:
        """Return the same after something was off.

        Parameters
        ----------
        off2 : float
            Sum of the squares of so many `components`.
        other2 : float
            Variance of each without these errors.
        added : array (errors, k)
            And what each size adds to that.
        components : int
        """
        variance = other2 + self.sums(added)
        return self.weighed(-0.5 * (components * np.log(variance) + off2 / variance))


@dataclass(slots=True, eq=False)
class Watched:
    """Sizes of errors that are watched: looks at one motion show one draw of them, and count as one together.

    Parameters
    ----------
    before : Sizes
        Without these looks.
    now : Sizes
    told : array (k, ...)
        Sum of the logarithms of how likely each combination makes the looks, by their seconds.
    seconds : float
    """

    before: Sizes
    now: Sizes = field(init=False)
    told: FloatArray = field(init=False)
    seconds: float = 0.0

    def __post_init__(self) -> None:
        """Begin with what was known before."""
        self.now, self.told = self.before, np.zeros_like(self.before.evidence)

    def look(self, likely: FloatArray, seconds: float) -> None:
        """Take the logarithm of how likely each combination makes a look, (k, ...), up to a constant."""
        self.told += seconds * likely
        self.seconds += seconds
        if self.seconds > 0.0:
            self.now = self.before.weighed(self.told / self.seconds)


class Look(NamedTuple):
    """What a component of a vector seems to be, squared, and the variance of that."""

    square: float
    variance: float


NOTHING = Look(0.0, math.inf)


@dataclass(slots=True, eq=False)
class OnBody:
    """Sizes of a vector that is fixed to the body, of which looks show components.

    From about the same direction they show the same ones.  So of these looks, one along the direction and one
    across, only the latest counts along, and across the one that is most surprising.

    Parameters
    ----------
    first : Sizes
        Before any look.
    now : Sizes
        With all looks.
    before : Sizes
        Without those from the present direction.
    across : Look
        The most surprising one from the present direction.
    direction : array (3,)
        From which it was looked at first; 0 before any.
    """

    first: Sizes
    now: Sizes
    before: Sizes
    across: Look = NOTHING
    direction: FloatArray = field(default_factory=lambda: np.zeros(3))

    @classmethod
    def of(cls, sizes: Sizes) -> OnBody:
        """Return what nobody has looked at."""
        return cls(sizes, sizes, sizes)

    @property
    def sd(self) -> float:
        """Return the standard deviation of each component."""
        return math.sqrt(float(self.now.mean_square[0]))

    def look(self, direction: FloatArray, along: Look, across: Look = NOTHING, changed: float = 0.0) -> None:
        """Look from a direction, a unit vector, (3,).

        `changed` is how likely it is that since the last look the vector has become another.
        """
        if float(direction @ self.direction) < ANOTHER:
            self.before, self.direction, self.across = self.now, direction, NOTHING
        if changed:
            self.before = self.before.mixed(self.first, changed)
        if across.square * self.across.variance > self.across.square * across.variance:
            self.across = across
        self.now = self.before
        for look in (along, self.across):
            if math.isfinite(look.variance):
                self.now = self.now.seen(look.square, look.variance, self.now.squares, 1)


def usual(size: float, largest: Sequence[float], probability: float, count: int = COUNT) -> Sizes:
    """Return that errors have a usual size, or with a probability each any up to its largest."""
    most = np.maximum(largest, size)
    squares = np.geomspace(size, most, count, axis=1) ** 2 if size > 0.0 else np.zeros((len(most), count))
    prior = np.log(np.append(1.0 - probability, np.full(count - 1, max(probability, LEAST) / (count - 1))))
    return Sizes(squares, reduce(np.add.outer, [prior] * len(most)))
