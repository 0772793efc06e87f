"""What of the data a diagnosis can use: the channels, the runs, and their blocks; the rest is named."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imumon.blocks import FloatArray
from imumon.clock.channel import CLOCK
from imumon.diagnosis.blocks import LEAST_BLOCKS, REST_SHARE, RunBlocks, make_blocks
from imumon.diagnosis.faults import without_standstill
from imumon.diagnosis.recording import CHANNELS, Run, channels_of, common_temperature, unit_of
from imumon.errors import ImumonError, Reason

LEAST_RUN_BLOCKS = 8
LEAST_REST = 0.5
LEAST_THERE = 0.1
"""Share of its time in which a channel that is used has samples."""
MANY_GAPS = 0.2
RESOLUTION = 1e-12
"""Share of its value below which the changes of a channel are rounding in the computation of its means."""


@dataclass(frozen=True, slots=True)
class Names:
    """Channels, the temperatures that their curves are over, and other drivers."""

    channels: Sequence[str]
    temperatures: Sequence[str]
    drivers: Sequence[str]


def usable_channels(
    train: Sequence[Run], test: Sequence[Run], sensors: Sequence[str], caveats: list[str]
) -> list[str]:
    """Return the channels that every training run has at a tenth of its time or more, and that vary at all.

    The clock of the device beside others only where all runs have it.

    Raises BAD_DATA when there is none.
    """
    found = _channels(train, sensors, caveats)
    if len(found) > 1 and not all(CLOCK in run.mean for run in (*train, *test)):
        return [name for name in found if name != CLOCK]
    return found


def _channels(runs: Sequence[Run], sensors: Sequence[str], caveats: list[str]) -> list[str]:
    found = []
    for name in channels_of(sensors, {name for run in runs for name in run.variance}):
        there = [run for run in runs if name in run.mean and np.isfinite(run.mean[name]).mean() > LEAST_THERE]
        if not there:
            continue
        if len(there) < len(runs):
            lacking = ", ".join(run.name for run in runs if run not in there)
            caveats.append(f"{name} is left out: {lacking} hardly has it")
        elif not any(_varies(run.mean[name], run.variance[name]) for run in runs):
            value = float(np.nanmean(runs[0].mean[name]))
            caveats.append(f"{name} is left out: it has one value throughout, {value:g} {unit_of(name)}")
        else:
            found.append(name)
    if not found:
        raise ImumonError(
            Reason.BAD_DATA,
            f"no channel of {', '.join(sensors)} has data in every training run",
            "give sessions that have them, or a map that says which columns they are",
        )
    return found


def _varies(mean: FloatArray, variance: FloatArray) -> bool:
    """Tell whether a channel changes by more than the rounding of its means, in or between its slots."""
    known, scatter = mean[np.isfinite(mean)], variance[np.isfinite(variance)]
    resolution = RESOLUTION * float(np.abs(known).max())
    return bool(np.ptp(known) > resolution or (scatter > resolution**2).any())


def temperature_of_axis(channel: str, runs: Sequence[Run]) -> str:
    """Return the temperature that a channel's bias is over: that of its axis where there is one.

    Raises BAD_DATA when there is no temperature.
    """
    lacking = "there is no temperature in the training data, so there is no bias over temperature to diagnose"
    return common_temperature(f"temperature_{channel[-1]}", runs, lacking, but=channel)


def sound(runs: Sequence[Run], channels: Sequence[str], caveats: list[str]) -> list[Run]:
    """Return runs without what is a fault of the data, which is named."""
    both = [without_standstill(run, channels) for run in runs]
    caveats += [text for _, said in both for text in said]
    return [run for run, _ in both]


def resting(run: Run) -> bool:
    """Tell whether the unit was at rest for most of a run."""
    return any(_rest_share(run, name) >= LEAST_REST for name in CHANNELS if name in run.mean)


def _rest_share(run: Run, channel: str) -> float:
    there = np.isfinite(run.mean[channel])[run.earlier :]
    return float((run.rest[run.earlier :][there] >= REST_SHARE).mean()) if there.any() else 0.0


def blocks_of_training(
    runs: Sequence[Run], names: Names, block_s: float, caveats: list[str]
) -> list[RunBlocks]:
    """Return the training as blocks, without runs that cannot be used, which are named.

    Raises BAD_DATA when the unit was hardly at rest, or the runs are too short.
    """
    found, moving = _in_blocks(runs, names, block_s, caveats)
    if moving and not found:
        raise ImumonError(
            Reason.BAD_DATA,
            "the unit moves: " + "; ".join(moving),
            "what the bias model lacks can be told only of a unit at rest; if it was, add --at-rest",
        )
    caveats += [f"{text}: not used, it moves" for text in moving]
    total = sum(map(len, found))
    if total < LEAST_BLOCKS:
        raise ImumonError(
            Reason.BAD_DATA,
            f"too short: the training data has {total} means of {block_s:.0f} s at rest;"
            f" {LEAST_BLOCKS} are needed, {LEAST_BLOCKS * block_s / 60:.0f} min",
            "record the unit at rest for an hour or more while its temperature changes;"
            " if it was at rest and is not seen to be, add --at-rest",
        )
    return found


def blocks_of_test(runs: Sequence[Run], names: Names, block_s: float, caveats: list[str]) -> list[RunBlocks]:
    """Return the test as blocks, without runs that cannot be used, which are named."""
    found, moving = _in_blocks(runs, names, block_s, caveats)
    caveats += [f"{text}: not used, it moves" for text in moving]
    if runs and not found:
        caveats.append("no run of the test can be used: there is no independent proof")
    return found


def _in_blocks(
    runs: Sequence[Run], names: Names, block_s: float, caveats: list[str]
) -> tuple[list[RunBlocks], list[str]]:
    """Return the runs at rest as blocks, and what moves."""
    found, moving = [], []
    for run in runs:
        lacking = [name for name in (*names.channels, *names.temperatures) if name not in run.mean]
        if lacking:
            caveats.append(f"{run.name}: not used, it lacks {', '.join(lacking)}")
            continue
        there = np.isfinite(run.mean[names.channels[0]])[run.earlier :]
        rest_share = _rest_share(run, names.channels[0])
        if rest_share < LEAST_REST:
            moving.append(f"{run.name}: at rest for {rest_share:.0%} of its {run.duration_s / 60:.0f} min")
            continue
        if there.mean() < run.share * (1.0 - MANY_GAPS):
            caveats.append(f"{run.name}: samples in {there.mean():.0%} of its time only; gaps are left out")
        if rest_share < 1.0 - MANY_GAPS:
            caveats.append(f"{run.name}: at rest for {rest_share:.0%} of its time; the rest is left out")
        blocks = make_blocks(run, names.channels, names.temperatures, names.drivers, block_s)
        if len(blocks) < LEAST_RUN_BLOCKS:
            caveats.append(
                f"{run.name}: not used, {len(blocks)} blocks of {block_s:.0f} s at rest are too few"
            )
            continue
        found.append(blocks)
    return found, moving
