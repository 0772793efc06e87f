"""The channels, drivers and runs that a diagnosis can use.

On what is left out each function adds to `remarks`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.clock.channel import CLOCK
from imumon.errors import bad_config, bad_data
from imumon.filters.rounding import mean_error
from imumon.lab.diagnosis.blocks import (
    BLOCK_S,
    LEAST_BLOCKS,
    LEAST_SLOTS,
    RunBlocks,
    common_block_s,
    make_blocks,
)
from imumon.lab.diagnosis.quality import Fault, standing
from imumon.lab.diagnosis.runs import (
    CHANNELS,
    SHORTEST_RUN_S,
    STRETCHES,
    Run,
    channels_of,
    divided,
    in_order,
    unit_of,
)

LEAST_THERE = 0.1
"""Share of its time in which a channel that is used has samples."""
MANY_GAPS = 0.2
"""Share of a run left out that is reported."""
RESOLUTION = 1e-12
"""Share of its value below which the changes of a channel are rounding in the computation of its means."""


def usable_channels(
    train: Sequence[Run], test: Sequence[Run], sensors: Sequence[str], remarks: list[str]
) -> list[str]:
    """Return the channels that vary and that every training run has at a tenth of its time or more.

    The clock of the device beside others only where all runs have it.

    Raises BAD_DATA when there is none.
    """
    found = []
    for name in channels_of(sensors, {name for run in train for name in run.variance}):
        lacking = [run.name for run in train if _share_there(run, name) <= LEAST_THERE]
        if len(lacking) == len(train):
            continue
        if lacking:
            remarks.append(f"{name} is left out: {', '.join(lacking)} hardly has it")
        elif not any(_varies(run.mean[name], run.variance[name]) for run in train):
            value = float(np.nanmean(train[0].mean[name]))
            remarks.append(f"{name} is left out: it has one value throughout, {value:g} {unit_of(name)}")
        else:
            found.append(name)
    if not found:
        raise bad_data(
            f"no channel of {', '.join(sensors)} has data in every training run",
            "give sessions that have them, or a map that says which columns they are",
        )
    if len(found) > 1 and not all(CLOCK in run.mean for run in (*train, *test)):
        found = [name for name in found if name != CLOCK]
    return found


def _share_there(run: Run, name: str) -> float:
    """Return the share of its time in which a run has a column."""
    return float(np.isfinite(run.mean[name]).mean()) if name in run.mean else 0.0


def _varies(mean: FloatArray, variance: FloatArray) -> bool:
    """Return whether a channel changes by more than the rounding of its means, in or between its slots."""
    known, scatter = mean[np.isfinite(mean)], variance[np.isfinite(variance)]
    resolution = RESOLUTION * float(np.abs(known).max())
    return bool(np.ptp(known) > resolution or (scatter > resolution**2).any())


def train_and_test(
    train: Sequence[Run], test: Sequence[Run], channels: Sequence[str], remarks: list[str]
) -> tuple[list[Run], list[Run]]:
    """Return sound runs of training and test; parts of an only run are held out as a test."""
    train, test = ([without_standstill(run, channels, remarks) for run in runs] for runs in (train, test))
    test = in_order(train, test, remarks)
    if test or len(train) > 1 or train[0].duration_s < 2 * LEAST_BLOCKS * common_block_s(train):
        return train, test
    remarks.append(
        f"no test data: every other {train[0].duration_s / STRETCHES / 60:.0f} min of the one run are"
        " held out as a test.  That is weaker than another power-on: what is particular to this run, and"
        " any noise that is slower, is in both"
    )
    first, other = divided(train[0], channels)
    return [first], [other]


def without_standstill(run: Run, channels: Sequence[str], remarks: list[str]) -> Run:
    """Return a run without the slots in which a channel stands still.

    Noise never gives the same value for as long as a block, but a stuck sensor does, one at its limit, and
    one whose digits are coarser than its noise.  The last stays.
    """
    mean, variance = dict(run.mean), dict(run.variance)
    for name in channels:
        if name not in mean:
            continue
        still = standing(mean[name], variance[name], max(LEAST_SLOTS, BLOCK_S / run.slot_s))
        if not still.any():
            continue
        share = float(still.sum() / np.isfinite(mean[name]).sum())
        # What stands still most of the time is not stuck.
        known = run.samples.get(name)
        if share > 0.5 or (known is not None and known.step > known.scatter):
            remarks.append(f"{run.name}: {name} does not change in {share:.0%} of its time: too few digits")
            continue
        still_s = still.sum() * run.slot_s
        remarks.append(f"{run.name}: {name} is stuck or saturated for {still_s:.0f} s; they are left out")
        mean[name], variance[name] = (np.where(still, np.nan, of[name]) for of in (mean, variance))
    return replace(run, mean=mean, variance=variance)


def faults(runs: Sequence[Run], channel: str, floor: float) -> list[Fault]:
    """Return the worst fault of each kind in the samples of a channel: digits too coarse for their noise to
    average what lies between them, and a value that is too frequent.

    `floor` is the white noise of a mean of a block.
    """
    recordings, unit = [run.samples[channel] for run in runs if channel in run.samples], unit_of(channel)
    coarse = [
        Fault(
            f"quantized: steps of {one.step:.3g} {unit}, about {1 / one.ratio:.2g} times the noise",
            mean_error(one.step, one.ratio),
        )
        for one in recordings
        if one.step > 0.0 and not mean_error(one.step, one.ratio) < 0.5 * floor
    ]
    frequent = [
        Fault(
            "frequent value, as of a dead-band, saturation or dropouts:"
            f" {one.atom_share:.1%} of the samples are {one.atom + 0.0:.4g} {unit}",
            np.inf,
        )
        for one in recordings
        if one.atom_share > 0.0
    ]
    return [max(kind, key=lambda fault: fault.blind) for kind in (coarse, frequent) if kind]


def resting(run: Run) -> bool:
    """Return whether the unit was at rest for most of a run."""
    return any(_rest_share(run, name) >= 0.5 for name in CHANNELS if name in run.mean)


def _rest_share(run: Run, channel: str) -> float:
    there = np.isfinite(run.mean[channel])
    return float(run.at_rest[there].mean()) if there.any() else 0.0


def usable_blocks(
    runs: Sequence[Run],
    channels: Sequence[str],
    temperatures: Sequence[str],
    drivers: Sequence[str],
    block_s: float,
    remarks: list[str],
) -> list[RunBlocks]:
    """Return the runs at rest as blocks."""
    found = []
    for run in runs:
        lacking = [name for name in (*channels, *temperatures) if name not in run.mean]
        if lacking:
            remarks.append(f"{run.name}: not used, it lacks {', '.join(lacking)}")
            continue
        at_rest = _rest_share(run, channels[0])
        if at_rest < 0.5:
            of = f"at rest for {at_rest:.0%} of its {run.duration_s / 60:.0f} min"
            remarks.append(f"{run.name}: not used, the unit moves: {of}")
            continue
        blocks = make_blocks(run, channels, temperatures, drivers, block_s)
        if len(blocks) * block_s < SHORTEST_RUN_S:
            few = f"{len(blocks)} blocks of {block_s:.0f} s at rest are too few"
            remarks.append(f"{run.name}: not used, {few}")
            continue
        found.append(blocks)
        known = np.isfinite(run.mean[channels[0]])
        there = float(known[np.argmax(known) :].mean())  # what goes on from another run begins late
        if there < run.share * (1.0 - MANY_GAPS):
            remarks.append(f"{run.name}: samples in {there:.0%} of its time only; gaps are left out")
        if at_rest < 1.0 - MANY_GAPS:
            remarks.append(f"{run.name}: at rest for {at_rest:.0%} of its time; the rest is left out")
    return found


def check_training(blocks: Sequence[RunBlocks], block_s: float, remarks: Sequence[str]) -> None:
    """Raise BAD_DATA when the unit was at rest for too short a time in training, with the remarks on that."""
    total = sum(map(len, blocks))
    if total < LEAST_BLOCKS:
        short = f"too short: the training data has {total} means of {block_s:.0f} s at rest"
        needed = f"{LEAST_BLOCKS} are needed, {LEAST_BLOCKS * block_s / 60:.0f} min"
        raise bad_data(
            "; ".join([short, needed, *remarks]),
            "record the unit at rest for an hour or more while its temperature changes;"
            " if it was at rest and is not detected to be, add --at-rest",
        )


def usable_drivers(
    train: Sequence[Run],
    test: Sequence[Run],
    beside: Sequence[str],
    wanted: Sequence[str] | None,
    remarks: list[str],
) -> list[str]:
    """Return the drivers that vary in training and are in every run, of those wanted (None: of all).

    `beside` are the temperatures that the curves are over.

    Raises BAD_CONFIG when one that is wanted is not there.
    """
    there = dict.fromkeys(name for run in train for name in run.mean)
    possible = [name for name in there if name not in CHANNELS and name not in beside]
    if lacking := [name for name in wanted or () if name not in possible]:
        raise bad_config(
            f"--drivers: {', '.join(lacking)} is not in the training data",
            f"there are {', '.join(possible) or 'none'}; a map names others with other: {{NAME: ...}}",
        )
    found = []
    for name in possible if wanted is None else wanted:
        values = np.concatenate([run.mean[name] for run in train if name in run.mean])
        if not np.nanmax(values) > np.nanmin(values):
            continue
        runs = [run.name for run in (*train, *test) if _share_there(run, name) < 0.5 * run.slot_s / BLOCK_S]
        if runs:
            remarks.append(f"{name} is hardly recorded in {', '.join(runs)}: no effect of it is looked for")
        else:
            found.append(name)
    return found
