"""What a person looks at beside the verdict: how the effects rank, and what each run is left with."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.channel import Channel
from imumon.lab.diagnosis.fit import Fit, TestScore, fit, score
from imumon.lab.diagnosis.search import Search

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
    before: float = float("nan")
    after: float = float("nan")
    mean: float = float("nan")

    @classmethod
    def of(cls, name: str, test: bool, before: FloatArray, after: FloatArray) -> Self:
        """Return that of a run with these residuals."""
        if not len(after):
            return cls(name, test, 0)
        first, last = (float(np.sqrt(np.mean(values**2))) for values in (before, after))
        return cls(name, test, len(after), first, last, float(after.mean()))


def ranking(channel: Channel, found: Search) -> list[Ranked]:
    """Return the effects that gain most, by what each does alone, whether or not any is named."""
    leaders = list(found.tables[0].values()) if found.tables else []
    ranked = []
    for one in sorted(leaders, key=lambda one: -one.gain)[:MOST_RANKED]:
        fitted = fit(channel, [one.candidate])
        left = score(channel, fitted).rms if channel.test else float("nan")
        ranked.append(Ranked(one.family, one.gain, fitted.train_rms, left))
    return ranked


def runs_left(
    channel: Channel, before: Fit, after: Fit, tests: tuple[TestScore, TestScore] | None
) -> list[RunLeft]:
    """Return what each run of training and test is left with."""
    bounds = np.cumsum([len(run) for run in channel.train])[:-1]
    both = (np.split(one.train, bounds) for one in (before, after))
    rows = [RunLeft.of(run.name, False, *left) for run, *left in zip(channel.train, *both, strict=True)]
    if tests is not None:
        for run, use, *left in zip(
            channel.test, tests[1].counted, *(one.residual for one in tests), strict=True
        ):
            rows.append(RunLeft.of(run.name, True, *(values[use] for values in left)))
    return rows


def most_different(rows: Sequence[RunLeft]) -> RunLeft | None:
    """Return the run that is left with most, where there are several."""
    known = [row for row in rows if np.isfinite(row.after)]
    return max(known, key=lambda row: row.after) if len(known) > 1 else None
