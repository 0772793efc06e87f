"""Block means at rest, the white floor below them, and a survey of what the runs can show."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray, SampleBlock
from imumon.clock.channel import CLOCK, block_noise
from imumon.effects.base import Drive, Scale, Survey
from imumon.effects.operators import play
from imumon.recordings.reduced import ACCEL

from .runs import Names, Run, Runs

BLOCK_S = 30.0
LEAST_BLOCKS = 40
"""Of a training: ten for each coefficient of a cubic."""
PARTS = 15
"""Of a block, whose differences show its white noise, where it has so many slots; 29 at most..."""
LEAST_PARTS = 3
"""...and in any case: two of their differences, less their mean, are not zero."""
BESIDE = 4
"""Slots on either side of a turn of the unit that are compared."""


@dataclass(frozen=True, eq=False)
class RunBlocks:
    """One run as means over n blocks at rest, of nominal length `block_s`; `pose` numbers their poses from 0.

    `time_s`, the mean time of the samples since power-on, is (n,), as are `white`, the variance of the white
    noise over that of a full block, each `mean` of a channel, in SI units, and each `temperature`, in °C.
    The `drives` of the effects, for each temperature, have all slots, with gaps bridged, and so has `weight`:
    samples in a slot over those of a whole one.  A block is a gap where these make less than half of it.
    """

    run: Run
    block_s: float
    time_s: FloatArray
    white: FloatArray
    mean: dict[str, FloatArray]
    temperature: dict[str, FloatArray]
    drives: dict[str, Drive]
    weight: FloatArray
    slots_per_block: int
    pose: IntArray

    @property
    def force(self) -> FloatArray | None:
        """Specific force in each block, m/s², (n, 3); None where it is not recorded."""
        accel = next((drive.accel for drive in self.drives.values()), None)
        return None if accel is None else self.average(accel)

    def __len__(self) -> int:
        return len(self.time_s)

    def in_blocks_of(self, block_s: float) -> "RunBlocks":
        """Return the same run in blocks of another length, s."""
        drivers = next(iter(self.drives.values())).others
        return make_blocks(self.run, [*self.mean], [*self.temperature], [*drivers], block_s)

    def average(self, columns: FloatArray) -> FloatArray:
        """Return block means (n, k) of columns (slots, k), or (n,) of values (slots,)."""
        means, share = _block_means(columns.reshape(len(self.weight), -1), self.weight, self.slots_per_block)
        return means[share >= 0.5].reshape(len(self), *columns.shape[1:])


Blocks = Sequence[RunBlocks]


def make_blocks(
    run: Run,
    channels: Names,
    temperatures: Names,
    drivers: Names = (),
    block_s: float = BLOCK_S,
) -> RunBlocks:
    """Return means over the slots at rest with samples of every channel; `drivers` may drive effects, too."""
    valid = run.at_rest & np.isfinite([run.mean[name] for name in channels]).all(axis=0)
    drives = _drives(run, temperatures, drivers)
    accel = next((drive.accel for drive in drives.values()), None)
    slots = max(1, round(block_s / run.slot_s))
    pose, resting = (np.zeros(len(valid), np.int64), valid) if accel is None else poses(accel, valid)
    valid = in_one_pose(resting, pose, slots)
    count = run.count[channels[0]]
    some = count > 0
    whole = some & np.append(some[1:], False) & np.append(False, some[:-1])  # no gap cuts it
    weight = np.zeros(len(valid))
    if valid.any():
        weight[valid] = count[valid] / count[whole if whole.any() else some].mean()
    values = [np.where(valid, run.mean[name], 0.0) for name in channels]
    temperature = [drive.temperature_degc for drive in drives.values()]
    every = np.column_stack([run.time_s, pose, *values, *temperature])
    means, share = _block_means(every, weight, slots)
    keep = share >= 0.5
    time_s, number, *columns = means[keep].T
    return RunBlocks(
        run=run,
        block_s=block_s,
        time_s=time_s,
        white=1.0 / share[keep],
        mean=dict(zip(channels, columns, strict=False)),
        temperature=dict(zip(drives, columns[len(channels) :], strict=True)),
        drives=drives,
        weight=weight,
        slots_per_block=slots,
        pose=np.rint(number).astype(np.int64),
    )


def _drives(run: Run, temperatures: Names, drivers: Names) -> dict[str, Drive]:
    """Return what drives the effects, for each temperature that there is; missing values are interpolated."""
    bridged = {
        name: np.interp(run.time_s, run.time_s[known], run.mean[name][known])
        for name in (*ACCEL, *drivers, *temperatures)
        if name in run.mean and (known := np.isfinite(run.mean[name])).sum() > 1
    }
    accel, others = SampleBlock(bridged).accel, {name: bridged[name] for name in drivers if name in bridged}
    there = [name for name in temperatures if name in bridged]
    return {name: Drive(run.time_s, bridged[name], accel, others) for name in there}


def poses(force: FloatArray, resting: BoolArray) -> tuple[IntArray, BoolArray]:
    """Return the number of the pose in each slot, (n,), one more after each turn of the unit; and the slots
    that are `resting` without those in which it turns all the same, as where rest is declared.

    `force` is the specific force in m/s², (n, 3); slots that are not `resting` have the pose before them.
    """
    at, still = np.flatnonzero(resting), resting.copy()
    turns = np.zeros(len(force), np.int64)
    if len(at) > 2 * BESIDE:
        total = np.cumsum(np.vstack([np.zeros(3), force[at]]), axis=0)
        means = (total[BESIDE:] - total[:-BESIDE]) / BESIDE
        change = np.abs(means[BESIDE:] - means[:-BESIDE]).max(axis=1)
        # 0.1 m/s² is 0.6° of tilt: from power-on to power-on accelerometers repeat better.
        turned = change > max(0.1, 8.0 * np.median(change))
        edges = np.flatnonzero(np.diff(np.concatenate([[False], turned, [False]])))
        for start, stop in edges.reshape(-1, 2).tolist():
            turns[at[start + np.argmax(change[start:stop]) + BESIDE]] = 1
            beside = at[start : stop + 2 * BESIDE - 1]
            still[beside] &= beside[-1] - beside[0] >= len(beside)  # no gap: rest is declared
    return np.cumsum(turns), still


def in_one_pose(valid: BoolArray, pose: IntArray, slots: int) -> BoolArray:
    """Return the valid slots without those of a block that are of another pose than most of it, (n,)."""
    kept = valid.copy()
    for turn in np.flatnonzero(np.diff(pose)) + 1:
        block = slice(turn // slots * slots, (turn // slots + 1) * slots)
        kept[block] &= pose[block] == np.argmax(np.bincount(pose[block][valid[block]], minlength=1))
    return kept


def at_poses(run: RunBlocks) -> RunBlocks:
    """Return a run in which the specific force that drives effects is the mean of its pose: a reading that is
    to be explained must not explain its own noise."""
    force, middle = run.force, 0.5 * (run.time_s[1:] + run.time_s[:-1])
    if force is None:
        return run
    level = np.array([force[run.pose == pose].mean(axis=0) for pose in run.pose])
    accel = level[np.searchsorted(middle, run.run.time_s)]
    return replace(run, drives={name: replace(drive, accel=accel) for name, drive in run.drives.items()})


def common_block_s(runs: Runs) -> float:
    """Return the length of a block: 30 s, or more where a log has few samples in that, or a run is long.

    It has six slots at least, whose differences show the white floor.  A run has at most 1200 blocks, ten
    hours of those of 30 s, so that a search takes no longer.
    """
    shortest_s = 6 * max(run.slot_s for run in runs)
    least_s = max(BLOCK_S, max(run.duration_s for run in runs) / 1200)
    return shortest_s * -(-least_s // shortest_s)


def _block_means(columns: FloatArray, weight: FloatArray, width: int) -> tuple[FloatArray, FloatArray]:
    """Return weighted means over blocks of so many slots, and the sum of weights over that of a full one."""
    starts = np.arange(0, len(weight), width)
    count = np.add.reduceat(weight, starts)
    with np.errstate(invalid="ignore", divide="ignore"):
        means = np.add.reduceat(columns * weight[:, None], starts, axis=0) / count[:, None]
    return means, count / width


class WhiteFloor(NamedTuple):
    """Standard deviation of the white noise of a block, and what it was taken from."""

    sd: float
    source: str


def white_floor(channel: str, blocks: Blocks) -> WhiteFloor:
    """Return the white floor of a channel from the scatter inside blocks, the rms over these blocks.

    It is half the mean square difference of neighbouring parts of a block (an Allan variance), of a fifteenth
    of it or less (2 s of 30 s): an output filter makes shorter ones too small and rounding too large, flicker
    longer ones.  The differences are less the mean of their block, so that no ramp gets in.  Where every
    block lacks readings, its parts have fewer slots; where parts have none, or the same ones, neighbouring
    blocks are compared.  The clock's is that of the delays at both ends of a block.
    """
    if len(widths := {one.slots_per_block for one in blocks}) > 1:  # logs of several rates, each by itself
        alike = [[one for one in blocks if one.slots_per_block == width] for width in sorted(widths)]
        floors = [(white_floor(channel, logs), sum(map(len, logs))) for logs in alike]
        variance = sum(number * one.sd**2 for one, number in floors) / sum(map(len, blocks))
        return WhiteFloor(np.sqrt(variance), floors[0][0].source)
    slots, gaps = blocks[0].slots_per_block, np.concatenate([run.white for run in blocks]).mean()
    every = [np.where(one.weight > 0.0, one.run.mean[channel], np.nan) for one in blocks]
    values = [rows[: len(rows) // slots * slots].reshape(-1, slots) for rows in every]
    step = max(1, slots // PARTS)
    number = slots // step
    parts, count = _means(np.concatenate(values)[:, : number * step].reshape(-1, number, step))
    whole = (count == step).all(axis=1)
    used = whole if whole.any() else (count > 0).all(axis=1)
    differences = np.diff(parts[used], axis=1)
    if channel == CLOCK or not differences.any():  # no step leads from one run to the next
        rates = [part for each in values for part in (_means(each)[0], [np.nan])]
        sd = block_noise(np.concatenate(rates)) * np.sqrt(gaps)
        return WhiteFloor(sd, "delays at the ends of blocks" if channel == CLOCK else "neighbouring blocks")
    spread = differences - differences.mean(axis=1, keepdims=True)
    slots_of_part = step if whole.any() else 1.0 / np.mean(1.0 / count[used])
    # The mean of k differences is (last - first) / k, which holds 2 / k² of the variance.
    of_part = np.mean(spread**2) / (2.0 * (1.0 - 1.0 / (number - 1) ** 2))
    sd = np.sqrt(of_part * slots_of_part / slots * gaps)
    return WhiteFloor(sd, f"means of {step * blocks[0].run.slot_s:.0f} s inside blocks")


def _means(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return means over the last axis of what is not missing, and how many values each has."""
    count = np.isfinite(values).sum(axis=-1)
    return np.where(count > 0, np.nansum(values, axis=-1) / np.maximum(count, 1), np.nan), count


def survey(runs: Blocks, temperatures: Iterable[str], degree: int) -> Survey:
    """Return what the training runs can show, with the drivers that there are beside temperature: that of the
    thermometer that varies most, for one of several may not."""
    of_all = {name: np.concatenate([run.temperature[name] for run in runs]) for name in temperatures}
    temperature = max(of_all, key=lambda name: np.ptp(of_all[name]))
    low, high = float(of_all[temperature].min()), float(of_all[temperature].max())
    backlash = 0.2 * (high - low)
    forces = [force for run in runs if (force := run.force) is not None]
    others = {}
    for name in runs[0].drives[temperature].others:
        values = np.concatenate([run.average(run.drives[temperature].others[name]) for run in runs])
        half_span = 0.5 * float(np.ptp(values)) or 1.0
        others[name] = Scale(0.5 * float(values.min() + values.max()), half_span)
    return Survey(
        durations_s=[float(run.time_s[-1]) + run.block_s / 2 for run in runs],
        span_degc=high - low,
        reversals=sum(_reversals(run.temperature[temperature], backlash) for run in runs),
        accel_range=max((np.ptp(force, axis=0).max() for force in forces), default=0.0),
        block_s=runs[0].block_s,
        degree=degree,
        scale=Scale(0.5 * (low + high), max(0.5 * (high - low), 1e-3)),
        others=others,
    )


def _reversals(temperature: FloatArray, size: float) -> int:
    """Count the reversals by more than `size`, those that a backlash as wide lets through."""
    direction = np.sign(np.diff(play(temperature, 0.5 * size, np.nan)))
    return int(np.count_nonzero(np.diff(direction[direction != 0])))
