"""A better model beside the present one, on data that came after it was found.

Both predict each block mean from those before it, with the noise that each had when the better one was
found.  The ratio of the two likelihoods of what comes later is a test martingale: were the present model
right, it would exceed A with a probability of 1 / A at most, however often it is tested (Ville 1939; Shafer
et al. 2011, doi:10.1214/10-STS347).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.lab.diagnosis.blocks import common_block_s
from imumon.lab.diagnosis.choice import PROVEN
from imumon.lab.diagnosis.known import temperature_of
from imumon.lab.diagnosis.likelihood import Likelihood
from imumon.lab.diagnosis.residual import Better, residual
from imumon.lab.diagnosis.runs import Run
from imumon.models.model import BiasModel

LEAST_BLOCKS = 10
"""Means that have to be there before and after the better model was found."""


@dataclass(frozen=True, slots=True)
class Score:
    """Two models on what came later.

    `ratio` is the logarithm of the likelihood ratio, the better model's over the present one's; `before` and
    `after` are the rms that the present and the better model leave, over the channels that differ.
    """

    ratio: float
    before: float
    after: float

    @property
    def won(self) -> bool:
        """Whether the better model has proven itself: 1 in 3000 by chance."""
        return self.ratio > PROVEN

    @property
    def lost(self) -> bool:
        """Whether it has done worse by as much."""
        return self.ratio < -PROVEN


class Shadow:
    """A better model of some channels, and when it was found."""

    def __init__(self, present: BiasModel, found: Sequence[Better], since_s: float) -> None:
        channels = {**present.channels, **{one.channel: one.model for one in found}}
        self.model = present.model_copy(update={"channels": channels})
        self.since_s = since_s
        self._present, self._names = present, [one.channel for one in found]

    def score(self, run: Run) -> Score | None:
        """Return how both models do on the part of a run that came later; None while that is too short.

        Temperatures outside those of the earlier part, from which the better model is, do not count.
        """
        run = self._within(run)
        block_s = common_block_s([run])
        ratio, squares = 0.0, []
        for model, sign in ((self._present, -1.0), (self.model, 1.0)):
            blocks = residual(run, model, self._names, block_s=block_s)
            early = blocks.time_s < self.since_s
            if min(early.sum(), (~early).sum()) < LEAST_BLOCKS:
                return None
            left = [blocks.mean[name] - blocks.mean[name][early].mean() for name in self._names]
            likelihood = Likelihood([blocks])
            ratio += sign * sum(likelihood.of_later(one, early) for one in left)
            squares.append(np.mean([one[~early] ** 2 for one in left]))
        before, after = np.sqrt(squares).tolist()
        return Score(ratio, before, after)

    def _within(self, run: Run) -> Run:
        """Return a run at rest only where its temperatures are among those of the earlier part."""
        inside = np.ones(len(run.time_s), bool)
        for name in self._names:
            t = run.mean[temperature_of(name, self.model, [run])]
            known = t[(run.time_s < self.since_s) & np.isfinite(t)]
            inside &= (t >= known.min()) & (t <= known.max())
        return replace(run, rest=np.where(inside, run.rest, 0.0))
