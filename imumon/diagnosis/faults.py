"""Faults of the data, found before any physics is asked: what they are, and what they leave to be seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BLOCK_S
from imumon.diagnosis.recording import Run, unit_of
from imumon.diagnosis.values import Look
from imumon.filters.rounding import largest_error, mean_error

ROUNDED = 0.5
"""With more of its time in which nothing changes a channel is not stuck: its digits are too coarse."""
LEAST_STILL = 6
"""Slots of one value, and 30 s, that are a fault."""
LOUDER = 1.3
"""Factor between the noise at the cold and at the warm end that is said."""
LEAST_NOISE = 0.2
"""Of a step: less noise is not told, for hardly any sample leaves its step."""
REPEATED = 0.3
"""Share of samples that equal the one before, of a channel whose digits are fine, that is said."""


@dataclass(frozen=True, slots=True)
class Fault:
    """What is wrong with the data of a channel."""

    text: str
    blind: float = 0.0
    """The most that it alone makes of a smooth bias: a smaller effect cannot be seen.  Infinite where
    nothing that is fitted would be the bias."""


def without_standstill(run: Run, channels: Sequence[str]) -> tuple[Run, list[str]]:
    """Return a run without the slots in which a channel stands still, and what has to be said of them.

    Noise never gives the same value for as long as a block (30 s), but a stuck sensor does, one at its limit,
    and one whose digits are coarser than its noise.  The last is said and kept.
    """
    mean, variance, looks, said = dict(run.mean), dict(run.variance), dict(run.looks), []
    for name in channels:
        if name not in mean:
            continue
        still = _standing(mean[name], run.variance[name], max(LEAST_STILL, BLOCK_S / run.slot_s))
        known = np.isfinite(mean[name])
        if not still.any():
            continue
        seconds, share = still.sum() * run.slot_s, still.sum() / known.sum()
        look = run.looks.get(name)
        if share > ROUNDED or (look is not None and look.step > look.noise * np.sqrt(1.0 - look.repeated)):
            said.append(f"{run.name}: {name} does not change in {share:.0%} of its time: too few digits")
            continue
        values = mean[name][still]
        if look is not None and np.isclose(values, look.atom, rtol=1e-9, atol=0.0).any():
            what = "stuck" if look.place == "inside" else "saturated"
            looks[name] = look.without(float(share))
        else:
            limits = np.nanmin(mean[name]), np.nanmax(mean[name])
            what = "saturated" if np.isin(values, limits).all() else "stuck"
        said.append(f"{run.name}: {name} is {what} for {seconds:.0f} s; they are left out")
        mean[name] = np.where(still, np.nan, mean[name])
        variance[name] = np.where(still, np.nan, variance[name])
    return replace(run, mean=mean, variance=variance, looks=looks), said


def _standing(
    mean: FloatArray, variance: FloatArray, least: float
) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Tell in which slots a channel has one value for as many of them or more, (n,)."""
    same = (np.diff(mean, prepend=np.nan) == 0.0) & ~(variance > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]])))
    still = np.zeros(len(mean), np.bool_)
    for start, stop in edges.reshape(-1, 2).tolist():
        # The slot before the first that repeats has the value as well.
        still[start - 1 : stop] = stop - start + 1 >= least
    return still


def faults(runs: Sequence[Run], channel: str, temperature: str, floor: float) -> list[Fault]:
    """Return what is wrong with the values of a channel; `floor` is the white noise of a block."""
    found = []
    looks = [run.looks[channel] for run in runs if channel in run.looks]
    for make in (_of_digits, _of_atoms, _of_repeats):
        each = [fault for look in looks if (fault := make(look, channel, floor)) is not None]
        if each:
            found.append(max(each, key=lambda fault: fault.blind))
    louder = _of_noise(runs, channel, temperature) if not found else None
    return [*found, *([louder] if louder is not None else [])]


def _of_digits(look: Look, channel: str, floor: float) -> Fault | None:
    """Tell digits that are too coarse for their noise to carry what lies between them."""
    if not look.step > 0.0:
        return None
    if mean_error(look.step, look.ratio) < 0.5 * floor:
        return None
    times = f"{1 / look.ratio:.1f}" if look.ratio > LEAST_NOISE else f"more than {1 / LEAST_NOISE:.0f}"
    text = f"quantized: steps of {look.step:.3g} {unit_of(channel)}, {times} times the noise"
    return Fault(text, largest_error(look.step, look.ratio))


def _of_atoms(look: Look, channel: str, _: float) -> Fault | None:
    """Tell a value that comes too often: at the end of the others, away from them, or amid them."""
    if not look.atom_share > 0.0:
        return None
    value = f"{look.atom_share:.1%} of the samples are {look.atom + 0.0:.4g} {unit_of(channel)}"
    kind = {"end": "saturated", "apart": "dropouts", "inside": "dead-band"}[look.place]
    return Fault(f"{kind}: {value}", np.inf)


def _of_repeats(look: Look, _: str, __: float) -> Fault | None:
    """Tell a channel that has a new value less often than there are samples."""
    fine = not look.step > 0.0 or look.step < 0.5 * look.noise
    # What never has a new value has no rate.
    if not fine or not REPEATED <= look.repeated < 1.0 or look.atom_share > 0.0:
        return None
    return Fault(f"another rate: a new value with every {1.0 / (1.0 - look.repeated):.1f}th sample only")


def _of_noise(runs: Sequence[Run], channel: str, temperature: str) -> Fault | None:
    """Tell white noise that depends on the temperature."""
    values, warmth = (
        np.concatenate(parts)
        for parts in zip(
            *((run.variance[channel], run.mean[temperature]) for run in runs if temperature in run.mean),
            strict=True,
        )
    )
    known = np.isfinite(values) & np.isfinite(warmth) & (values > 0.0)
    if known.sum() < 100:
        return None
    values, warmth = values[known], warmth[known]
    low, high = np.quantile(warmth, (0.2, 0.8))
    cold, warm = (float(np.sqrt(np.median(values[part]))) for part in (warmth <= low, warmth >= high))
    if not high > low or max(cold, warm) < LOUDER * min(cold, warm):
        return None
    return Fault(
        f"noise that depends on temperature: {warm / cold:.2f} times as large above {high:.0f} °C as below"
        f" {low:.0f} °C"
    )
