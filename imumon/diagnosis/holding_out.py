"""Runs divided into what is trained on and what is held out for a test."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.diagnosis.recording import CHANNELS, Run

STRETCHES = 12
"""Contiguous and alternating: of single blocks flicker would be in both, and a half may lack an end of the
range."""


def divided(run: Run) -> tuple[Run, Run]:
    """Return the run with every other stretch of its channels, and with the others: the test.

    Both have the whole course of everything else, and of time.
    """
    n = len(run.time_s)
    tested = (np.arange(n) * STRETCHES // n) % 2 == 1
    first, second = (_only(run, kept) for kept in (~tested, tested))
    return first, replace(second, name=f"{run.name}, held out", begun_in=run.name)


def _only(run: Run, kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Run:
    mean = {
        name: np.where(kept, values, np.nan) if name in CHANNELS else values
        for name, values in run.mean.items()
    }
    return replace(run, mean=mean, share=0.5)


def latest(recordings: Sequence[Sequence[Run]]) -> tuple[list[Run], list[Run]]:
    """Return the runs of all recordings but the last, and those of the last: the test, unless it is the only
    one."""
    *earlier, last = recordings
    return [run for runs in earlier or [last] for run in runs], list(last) if earlier else []
