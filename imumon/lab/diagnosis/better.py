"""Better models of the session that is running: found by the search, proven on what came later.

Both models predict each block mean from those before it, with the noise that each had when the better one
was found.  The ratio of the two likelihoods of what comes later is a test martingale: were the present model
right, it would exceed A with a probability of 1 / A at most, however often it is tested (Ville 1939; Shafer
et al. 2011, doi:10.1214/10-STS347).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from imumon.effects.library import EFFECTS
from imumon.lab.diagnosis import known
from imumon.lab.diagnosis.blocks import LEAST_BLOCKS, common_block_s, make_blocks, survey
from imumon.lab.diagnosis.choice import least_gain
from imumon.lab.diagnosis.diagnose import Recorded, likeliest, search_sensor
from imumon.lab.diagnosis.extended import refitted
from imumon.lab.diagnosis.fit import LEAST_TEST_BLOCKS, MATERIAL, fit
from imumon.lab.diagnosis.likelihood import Likelihood
from imumon.lab.diagnosis.runs import Run
from imumon.lab.diagnosis.search import Search
from imumon.lab.diagnosis.usable import usable_drivers
from imumon.models.model import BiasModel, ChannelModel

LASTING = [name for name, kind in EFFECTS.items() if kind.scope not in ("run", "event")]
"""Effects that a model file can have."""


class Better(NamedTuple):
    """A better model of a channel.

    `names` are the effects of which the present model lacks one, the best first; these data do not separate
    them.  `gain` is in BIC over the present model, of all channels that lack an effect.  `before` and
    `after` are the rms of the block means with the present model and a constant, and with the better model.
    """

    channel: str
    names: list[str]
    gain: float
    before: float
    after: float
    model: ChannelModel


def better_models(run: Run, model: BiasModel, channels: Sequence[str]) -> list[Better]:
    """Return a better model of each channel that lacks an effect.

    The search of the diagnosis, which begins with the present model, as it is and fitted anew.  One effect is
    named at a time, where the gain over the present model, of all channels that lack it, pays for the choice
    of effect, channels and curve (extended BIC).
    """
    temperatures = {name: known.temperature_of(name, model, [run]) for name in channels}
    used = list(dict.fromkeys(temperatures.values()))
    left = known.without_model(run, known.curves_of(model), channels)
    drivers = usable_drivers([run], [], used, None, [])
    blocks = make_blocks(left, channels, used, drivers, common_block_s([run]))
    if len(blocks) < LEAST_BLOCKS:
        return []
    degree = known.CUBIC_DEGREE if survey([blocks], used[0], 0).thermal else 0
    data = Recorded([blocks], temperatures, degree, model=model)
    searched = search_sensor(data, channels, LASTING, stages=1)
    found = likeliest(searched, live=True)
    of_poses = [one[0].channel.own == "pose" for one in searched]
    if found[0].channel.own == "pose" and not all(of_poses):
        return []  # it may be the earth rate: `imumon diagnose` has more sessions to decide
    lacking = [one for one in found if any(not finding.known for finding in one.findings)]
    gain = sum(map(_gain_over_given, lacking))
    if not gain > least_gain(len(LASTING) * (2 if degree else 1), len(channels)):
        return []
    every = [_better(one, gain, model) for one in lacking]
    # What a model leaves hardly above the white noise is too small to matter.
    return [
        better
        for better, one in zip(every, lacking, strict=True)
        if better.before >= MATERIAL * one.channel.floor.sd
    ]


def _gain_over_given(found: Search) -> float:
    """Return what a model gains over the present one as it is."""
    given = found.channel.as_given()
    price = given.base.shape[1] * found.likelihood.price
    return found.criterion() - float(2.0 * found.likelihood.best(given.values, given.base)[0] - price)


def _better(found: Search, gain: float, model: BiasModel) -> Better:
    """Return the present model of a channel with what it lacks, fitted."""
    channel, lacking = found.channel, next(one for one in found.findings if not one.known)
    present, given = model.channels[channel.name], fit(channel.as_given(), [])
    fitted = fit(channel, found.model)
    # What is left holds the white noise of the means as well: the model's own error is no larger.
    better = refitted(present, channel, fitted, min(present.residual_sd, fitted.train_rms))
    names = lacking.alike or [lacking.name]
    return Better(channel.name, names, gain, given.train_rms, fitted.train_rms, better)


class Comparison(NamedTuple):
    """Two models on what came later.

    `ratio` is the logarithm of the likelihood ratio, the better model's over the present one's: above PROVEN
    the better one has won, 1 in 3000 by chance, and below -PROVEN it has lost.  `before` and `after` are the
    rms that the present and the better model leave, over the channels that differ.
    """

    ratio: float
    before: float
    after: float


class Challenger:
    """A better model of some channels that runs beside the present one since it was found."""

    def __init__(self, present: BiasModel, found: Sequence[Better], since_s: float) -> None:
        channels = {**present.channels, **{one.channel: one.model for one in found}}
        self.model = present.model_copy(update={"channels": channels})
        self.since_s = since_s
        self._present, self._names = present, [one.channel for one in found]

    def compare(self, run: Run) -> Comparison | None:
        """Return how both models do on the part of a run that came later; None while that is too short.

        Temperatures outside those of the earlier part, from which the better model is, do not count.
        """
        run = known.within_range(self.model, run, self._names, self.since_s)
        ratio, squares = 0.0, []
        for model, sign in ((self._present, -1.0), (self.model, 1.0)):
            blocks = known.residual(run, model, self._names)
            early = blocks.time_s < self.since_s
            if min(early.sum(), (~early).sum()) < LEAST_TEST_BLOCKS:
                return None
            left = [blocks.mean[name] - blocks.mean[name][early].mean() for name in self._names]
            likelihood = Likelihood([blocks])
            ratio += sign * sum(likelihood.predictive(one, early) for one in left)
            squares.append(np.mean([one[~early] ** 2 for one in left]))
        before, after = np.sqrt(squares).tolist()
        return Comparison(ratio, before, after)
