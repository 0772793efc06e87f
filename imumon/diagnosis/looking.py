"""What a person looks at beside the verdict: how the effects rank, and what each run is left with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import RunBlocks
from imumon.diagnosis.channel import Channel
from imumon.diagnosis.fit import Fit, TestScore, fit, score
from imumon.diagnosis.selection import Search

MOST_RANKED = 6


@dataclass(frozen=True, slots=True)
class Ranked:
    """An effect alone beside what was assumed: gain in BIC, and the rms that it leaves of training and of the
    test, by what it predicts of that; NaN without one."""

    name: str
    gain: float
    train_rms: float
    test_rms: float


@dataclass(frozen=True, slots=True)
class RunLeft:
    """What a run is left with before and after: rms, and the mean of what is left after; NaN where nothing
    counts."""

    name: str
    test: bool
    blocks: int
    before: float
    after: float
    mean: float


def ranking(channel: Channel, found: Search) -> list[Ranked]:
    """Return the effects that gain most, by what each does alone, whether or not any is named."""
    leaders = {} if found.first is None else found.first.leaders
    alone = {name: leader.scored for name, leader in leaders.items()}
    ranked = []
    for name in sorted(alone, key=lambda name: -alone[name].gain)[:MOST_RANKED]:
        fitted = fit(channel, [alone[name].candidate])
        left = score(channel, fitted).rms if channel.test else float("nan")
        ranked.append(Ranked(name, alone[name].gain, fitted.train_rms, left))
    return ranked


def runs_left(
    channel: Channel, before: Fit, after: Fit, tests: tuple[TestScore, TestScore] | None
) -> list[RunLeft]:
    """Return what each run of training and test is left with."""
    bounds = np.cumsum([len(run) for run in channel.train])[:-1]
    both = (np.split(one.train, bounds) for one in (before, after))
    rows = [_left(run, False, *left) for run, *left in zip(channel.train, *both, strict=True)]
    if tests is not None:
        counted = tests[1].counted
        rows += [
            _left(run, True, tests[0].residual[at][counted[at]], tests[1].residual[at][counted[at]])
            for at, run in enumerate(channel.test)
        ]
    return rows


def most_different(rows: Sequence[RunLeft]) -> RunLeft | None:
    """Return the run that is left with most, where there are several."""
    known = [row for row in rows if np.isfinite(row.after)]
    return max(known, key=lambda row: row.after) if len(known) > 1 else None


def _left(run: RunBlocks, test: bool, before: FloatArray, after: FloatArray) -> RunLeft:
    if not len(after):
        nothing = float("nan")
        return RunLeft(run.name, test, 0, nothing, nothing, nothing)
    first, last = (float(np.sqrt(np.mean(values**2))) for values in (before, after))
    return RunLeft(run.name, test, len(after), first, last, float(after.mean()))
