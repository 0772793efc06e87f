"""Which runs are trained on and which are the test, and which go on where another one ended.

An effect with memory goes on with its run, from the end of the one before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.recording import CHANNELS, SECOND_NS, Run

STRETCHES = 12
"""Contiguous and alternating: of single blocks flicker would be in both, and a half may lack an end of the
range."""
LONGEST_PAUSE_S = 60.0
"""A recording that begins later than this after another, by the device's clock, is one from power-on."""


def latest(recordings: Sequence[Sequence[Run]]) -> tuple[list[Run], list[Run]]:
    """Return the runs of all recordings but the last, and those of the last: the test, unless it is the only
    one."""
    *earlier, last = recordings
    return [run for runs in earlier or [last] for run in runs], list(last) if earlier else []


def divided(run: Run, channels: Sequence[str]) -> tuple[Run, Run]:
    """Return the run with every other stretch of the channels, and with the others: the test.

    Both have the whole course of everything else, and of time.
    """
    n = len(run.time_s)
    tested = (np.arange(n) * STRETCHES // n) % 2 == 1
    first, second = (_only(run, channels, kept) for kept in (~tested, tested))
    return first, replace(second, name=f"{run.name}, held out", begun_in=run.name)


def _only(run: Run, channels: Sequence[str], kept: np.ndarray[tuple[int], np.dtype[np.bool_]]) -> Run:
    mean = {
        name: np.where(kept, values, np.nan) if name in channels else values
        for name, values in run.mean.items()
    }
    return replace(run, mean=mean, share=0.5)


def _unseen(train: Sequence[Run], test: Sequence[Run], caveats: list[str]) -> list[Run]:
    """Return the test runs without those that the training has: by their bytes, whatever their names."""
    known = {(run.origin.sha256, run.origin.index, run.start_ns) for run in train if run.origin is not None}
    found = []
    for run in test:
        if run.origin is not None and (run.origin.sha256, run.origin.index, run.start_ns) in known:
            caveats.append(f"{run.name}: not used as a test, the training has the same recording")
        else:
            found.append(run)
    return found


def in_order(train: Sequence[Run], test: Sequence[Run], caveats: list[str]) -> list[Run]:
    """Return the test runs that the training does not have.

    Those that go on where another run ended have its time and temperatures.
    """
    found: list[Run] = []
    for run in _unseen(train, test, caveats):
        before = _predecessor(run, [*found, *train])
        if before is None:
            found.append(run)
            continue
        caveats.append(
            f"{run.name} goes on where {before.name} ended, by the device's clock: time since power-on, lag"
            " and loop go on as well"
        )
        found.append(_continued(before, run))
    return found


def _predecessor(run: Run, others: Sequence[Run]) -> Run | None:
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


def _continued(before: Run, after: Run) -> Run:
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
