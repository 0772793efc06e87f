"""A better model beside the present one, on data that came after it was found.

Both predict each mean of 30 s from those before it, with the noise that each had when the better one was
found.  The ratio of the two likelihoods of what comes later is a test martingale: had the present model been
right, it would exceed A with a probability of 1 / A at most, however often one looks (Ville 1939; Shafer et
al. 2011, doi:10.1214/10-STS347).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import BoolArray, FloatArray
from imumon.diagnosis.blocks import RunBlocks, common_block_s
from imumon.diagnosis.gains import PROVEN
from imumon.diagnosis.glance import Better, residual
from imumon.diagnosis.known import temperature_of
from imumon.diagnosis.likelihood import Likelihood
from imumon.diagnosis.runs import Run
from imumon.models.model import BiasModel

MARGIN = PROVEN
"""Logarithm of the likelihood ratio that wins or loses: 1 in 3000 by chance."""
LEAST_LATER = 10
"""Means of 30 s that have to come later, at least: as many as a test needs to be scored."""


@dataclass(frozen=True, slots=True, eq=False)
class Score:
    """How two models do on what came later."""

    ratio: float
    """Logarithm of the ratio of the likelihoods, the better model's over the present one's."""
    time_s: FloatArray
    present: FloatArray
    shadow: FloatArray
    """Of each mean, and what the models leave of it, (n,): rms over the channels that differ."""
    later: int
    """How many of them came later."""
    block_s: float
    """Of what length the means are."""

    @property
    def won(self) -> bool:
        """Whether the better model has proven itself."""
        return self.later >= LEAST_LATER and self.ratio > MARGIN

    @property
    def lost(self) -> bool:
        """Whether it has done worse by as much."""
        return self.ratio < -MARGIN

    @property
    def rms(self) -> tuple[float, float]:
        """That of the present and of the better model, over what came later."""
        last = slice(len(self.time_s) - self.later, None)
        before, after = (float(np.sqrt(np.mean(part[last] ** 2))) for part in (self.present, self.shadow))
        return before, after


class Shadow:
    """A better model of some channels, and when it was found."""

    def __init__(self, present: BiasModel, found: Sequence[Better], since_s: float) -> None:
        channels = {**present.channels, **{one.channel: one.model for one in found}}
        self.model = present.model_copy(update={"channels": channels})
        self.found = list(found)
        self._present, self.since_s = present, since_s
        self.score: Score | None = None

    def judge(self, run: Run) -> Score | None:
        """Return how both do on a run, the later part of which is new; None before there is any.

        What is outside the temperatures of the earlier part, where the better one is from, does not count.
        """
        names = [one.channel for one in self.found]
        run = self._within(run, names)
        block_s = common_block_s([run])
        present, shadow = (
            residual(run, model, names, block_s=block_s) for model in (self._present, self.model)
        )
        early = present.time_s < self.since_s
        if early.all() or early.sum() < LEAST_LATER:
            return self.score
        both = [_Predicted.of(blocks, names, early) for blocks in (present, shadow)]
        self.score = Score(
            both[1].log_likelihood - both[0].log_likelihood,
            present.time_s,
            both[0].left,
            both[1].left,
            int((~early).sum()),
            block_s,
        )
        return self.score

    def _within(self, run: Run, names: Sequence[str]) -> Run:
        """Return a run at rest only where its temperatures are among those of the earlier part."""
        inside = np.ones(len(run.time_s), bool)
        for name in names:
            t = run.mean[temperature_of(name, self.model, [run])]
            known = t[(run.time_s < self.since_s) & np.isfinite(t)]
            inside &= (t >= known.min()) & (t <= known.max())
        return replace(run, rest=np.where(inside, run.rest, 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class _Predicted:
    """The log-likelihood of the later means given those before, and what is left of all."""

    log_likelihood: float
    left: FloatArray

    @classmethod
    def of(cls, blocks: RunBlocks, names: Sequence[str], early: BoolArray) -> _Predicted:
        total, squares = 0.0, np.zeros(len(blocks))
        likelihood = Likelihood([blocks])
        for name in names:
            left = blocks.mean[name] - blocks.mean[name][early].mean()
            total += likelihood.of_later(left, early)
            squares += left**2
        return cls(total, np.sqrt(squares / len(names)))
