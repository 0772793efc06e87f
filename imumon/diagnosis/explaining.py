"""Whether a model explains what is there, and what a test says for it: one rule for training and test."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from imumon.diagnosis.channel import Channel
from imumon.diagnosis.fitting import LEAST_TEST_BLOCKS, Fit, TestScore, score
from imumon.diagnosis.likelihood import Likelihood

CLEAN = 1.8
"""Residual in white floors below which nothing is missing; slow noise of the same size as the white is
allowed."""
MATERIAL = 1.3
"""Of a model that leaves less than so many floors, what is missing is too small to matter."""
EXPLAINED = 0.6
"""Share of the excess over the white floor that has to be explained before anything is named, in training
and in the test.  Of wanders, walks, telegraph noise, bursts and a hidden supply, 384 channels, no effect
predicted more than 0.54 of the test, with one run to train on, or than 0.35, with two."""


def explained_share(before: float, after: float, floor: float) -> float:
    """Return which share of the excess of the mean square over the white floor is explained; 0 where there
    is none, or nothing is known."""
    excess = before**2 - floor**2
    return 1.0 - (after**2 - floor**2) / excess if excess > 0 and np.isfinite(after) else 0.0


def explains(before: float, after: float, floor: float) -> bool:
    """Tell whether a model that leaves `after` explains enough of what another left to be named."""
    return after < CLEAN * floor or explained_share(before, after, floor) >= EXPLAINED


def left_in_test(test: TestScore) -> float:
    """Return what is left of a test: predicted, or followed where something does not carry over."""
    return float(np.fmin(test.rms, test.tracked_rms))


def shown(before: TestScore, after: TestScore, floor: float) -> bool:
    """Tell whether a test, too, shows what training does; one that cannot be scored does not.

    What is followed from the test's own past counts only where nothing is left: whatever is slow can be
    followed, under any name.
    """
    if not np.isfinite(after.rms):
        return False
    return left_in_test(after) < CLEAN * floor or explains(before.rms, after.rms, floor)


def evidence_of_test(channel: Channel, model: Fit, without: Fit) -> float:
    """Return the evidence of a test for a model against a lesser one: twice the log-likelihood ratio.

    Both predict from training alone and pay for no parameter; each has the slow noise and the constant that
    suit it best, so that a course that noise would take as well is no evidence.  NaN where too little counts.
    """
    both = score(channel, model), score(channel, without, like=model)
    counted = [a & b for a, b in zip(both[0].counted, both[1].counted, strict=True)]
    if sum(int(use.sum()) for use in counted) < LEAST_TEST_BLOCKS:
        return float("nan")
    runs = [
        replace(run, time_s=run.time_s[use], white=run.white[use])
        for run, use in zip(channel.test, counted, strict=True)
        if use.any()
    ]
    likelihood, found = Likelihood(runs), []
    for one in both:
        left = np.concatenate([part[use] for part, use in zip(one.residual, counted, strict=True)])
        found.append(likelihood.best(left, np.ones((len(left), 1)))[0])
    return 2.0 * (found[0] - found[1])
