"""An effect that training alone cannot prove, and the test does: what it predicts comes true.

Noise that wanders as fast as it does within minutes may go anywhere within the hour, so that no likelihood
tells a loop that was gone through once from a wander.  But a wander does not go the same way again.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.channel import Channel
from imumon.diagnosis.fit import EXPLAINED, Fit, begun, explained_share, fit, score
from imumon.diagnosis.selection import ALIKE, MOST_NAMES, Finding, Search


def proven_by_test(channel: Channel, found: Search, before: Fit, beside: Sequence[Finding]) -> Finding | None:
    """Return the effect that predicts the test best, if it does so well, where nothing was proven.

    `beside` is what is fitted anew of a model that was given.  Only effects count that make the training
    likelier, by more than their coefficients cost, and only a test that is not woven into the training.
    """
    if found.last is None or not channel.test or any(woven(channel, run) for run in channel.test):
        return None
    also = [finding.candidate for finding in beside]
    tried: list[tuple[float, Finding]] = []
    for name, leader in found.last.leaders.items():
        if leader.scored.fit <= 0.0 or leader.scored.candidate.scope in ("run", "event"):
            continue
        # The likelihood looks at what is fast; of a slow course least squares see more.
        fits = [(one, fit(channel, [*also, one])) for one in found.of_family(name)]
        slow = min(fits, key=lambda one: one[1].train_rms, default=None)
        both = [leader.scored.candidate, *([slow[0]] if slow is not None else [])]
        for candidate in both:
            after = fit(channel, [*also, candidate])
            scores = score(channel, before, like=after), score(channel, after)
            share = explained_share(scores[0].rms, scores[1].rms, channel.floor.sd)
            if share >= EXPLAINED and all(part.carries for part in after.parts):
                size = float(np.sqrt(max(before.train_rms**2 - after.train_rms**2, 0.0)))
                gain = leader.scored.gain
                finding = Finding(candidate, gain, gain, {name: gain}, [], size, by_test=True)
                tried.append((scores[1].rms, finding))
    if not tried:
        return None
    tried.sort(key=lambda one: one[0])
    least, best = tried[0]
    near = (finding.name for rms, finding in tried if rms < ALIKE * least)
    alike = list(dict.fromkeys(near))[:MOST_NAMES]
    best.rivals = {finding.name: finding.gain for _, finding in tried}
    best.alike = alike if len(alike) > 1 else []
    best.others = {finding.name: finding.candidate for _, finding in tried if finding.name in alike[1:]}
    return best


def woven(channel: Channel, run: RunBlocks) -> bool:
    """Tell whether a test lies between parts of the training: any smooth course joins their ends."""
    at = begun(channel, run)
    return at is not None and bool(run.time_s[0] < channel.train[at].time_s[-1])
