"""Runs that continue another one, so that effects with memory continue from its end."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.recording import CHANNELS, SECOND_NS, Run

LONGEST_PAUSE_S = 60.0
"""A recording that begins later than this after another, by the device's clock, is one from power-on."""


def predecessor(run: Run, others: Sequence[Run]) -> Run | None:
    """Return the run that this one goes on from, by the device's clock; None when it is from power-on."""
    for other in others:
        pause = _pause_s(other, run)
        if pause is not None and -1.0 <= pause <= LONGEST_PAUSE_S:
            return other
    return None


def _pause_s(before: Run, after: Run) -> float | None:
    if before.start_ns is None or after.start_ns is None:
        return None
    if before.slot_s != after.slot_s:
        return None
    return (after.start_ns - before.start_ns) / SECOND_NS - before.duration_s


def continued(before: Run, after: Run) -> Run:
    """Return a run with the time and the drivers of the one that it goes on from; its samples alone
    count."""
    assert before.start_ns is not None
    assert after.start_ns is not None
    slot_s = after.slot_s
    first = max(round((after.start_ns - before.start_ns) / SECOND_NS / slot_s), len(before.time_s))
    n = first + len(after.time_s)

    def joined(parts: dict[str, FloatArray], earlier: dict[str, FloatArray]) -> dict[str, FloatArray]:
        found = {}
        for name, values in parts.items():
            whole = np.full(n, np.nan)
            whole[first:] = values
            if name not in CHANNELS and name in earlier:
                whole[: len(before.time_s)] = earlier[name]
            found[name] = whole
        return found

    count = {name: np.concatenate([np.zeros(first), values]) for name, values in after.count.items()}
    return replace(
        after,
        time_s=(np.arange(n, dtype=np.float64) + 0.5) * slot_s,
        count=count,
        mean=joined(after.mean, before.mean),
        variance=joined(after.variance, {}),
        rest=np.concatenate([np.zeros(first), after.rest]),
        start_ns=before.start_ns,
        earlier=before.earlier + first,
        begun_in=before.begun_in or before.name,
    )
