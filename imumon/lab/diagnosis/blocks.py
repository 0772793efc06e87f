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

from .runs import Columns, Names, Run, Runs

BLOCK_S = 30.0  # assumed; rounded up to a multiple of six slots, so 36 s where these have 2 s
LEAST_BLOCKS = 40  # of a training: ten for each coefficient of a cubic
# Pieces of a block whose differences show its white noise: 15 or more (assumed), where it has so many slots.
# In three there are two differences, of which something is left less their mean.
PIECES, LEAST_PIECES = 15, 3
LEAST_SLOTS = 6  # of a block: three pieces of two slots
MOST_BLOCKS = 1200  # of a run, ten hours of those of 30 s, so that a search takes no longer (assumed)
BESIDE = 4  # slots on either side of a turn of the unit that are compared (assumed)


@dataclass(frozen=True, eq=False)
class RunInBlocks:
    """One run as means over n blocks at rest; a block with less than half of its samples is left out."""

    in_slots: Run
    block_s: float  # nominal length
    time_s: FloatArray  # mean time of its samples since power-on, (n,)
    white: FloatArray  # variance of the white noise over that of a full block, (n,)
    mean: Columns  # of each channel, SI units, (n,)
    temperature: Columns  # °C, (n,)
    drives: dict[str, Drive]  # what drives effects, for each temperature, of all slots, with gaps bridged
    weight: FloatArray  # samples in a slot at rest over those of a whole one, (slots,)
    slots_per_block: int
    pose: IntArray  # number of its pose, from 0, (n,)

    @property
    def force(self) -> FloatArray | None:
        """Specific force in each block, m/s², (n, 3); None where it is not recorded."""
        accel = next((drive.accel for drive in self.drives.values()), None)
        return None if accel is None else self.average(accel)

    def __len__(self) -> int:
        return len(self.time_s)

    def in_blocks_of(self, block_s: float) -> "RunInBlocks":
        """Return the same run in blocks of another length, s."""
        drivers = next(iter(self.drives.values())).others
        return make_blocks(self.in_slots, [*self.mean], [*self.temperature], [*drivers], block_s)

    def average(self, columns: FloatArray) -> FloatArray:
        """Return block means (n, k) of columns (slots, k), or (n,) of values (slots,)."""
        return _averaged(columns, self.weight, self.slots_per_block)[0]


RunsInBlocks = Sequence[RunInBlocks]


def make_blocks(
    run: Run, channels: Names, temperatures: Names, drivers: Names = (), block_s: float = BLOCK_S
) -> RunInBlocks:
    """Return means over the slots at rest with samples of every channel; `drivers` may drive effects, too."""
    valid = run.at_rest & np.isfinite([run.mean[name] for name in channels]).all(axis=0)
    drives = _drives(run, temperatures, drivers)
    accel = next((drive.accel for drive in drives.values()), None)
    slots = max(1, round(block_s / run.slot_s))
    pose = np.zeros(len(valid), np.int64)
    if accel is not None:
        pose, valid = poses(accel, valid)
    valid = in_one_pose(valid, pose, slots)
    count = run.count[channels[0]]
    sampled = count > 0
    whole = sampled & np.append(sampled[1:], False) & np.append(False, sampled[:-1])  # no gap cuts it
    weight = np.zeros(len(valid))
    if valid.any():
        weight[valid] = count[valid] / count[whole if whole.any() else sampled].mean()
    time_s, share = _averaged(run.time_s, weight, slots)
    return RunInBlocks(
        in_slots=run,
        block_s=block_s,
        time_s=time_s,
        white=1.0 / share,
        # A slot without weight must not be NaN, as 0 NaN would be NaN.
        mean={name: _averaged(np.where(valid, run.mean[name], 0.0), weight, slots)[0] for name in channels},
        temperature={n: _averaged(drive.temperature_degc, weight, slots)[0] for n, drive in drives.items()},
        drives=drives,
        weight=weight,
        slots_per_block=slots,
        pose=np.rint(_averaged(pose, weight, slots)[0]).astype(np.int64),
    )


def _averaged(values: FloatArray | IntArray, weight: FloatArray, width: int) -> tuple[FloatArray, FloatArray]:
    """Return weighted means over blocks of so many slots, (n, ...) of (slots, ...), and the share of a full
    one's weight that each has, (n,).  Those with less than half of it are left out."""
    starts = np.arange(0, len(weight), width)
    total = np.add.reduceat(weight, starts)
    keep = total / width >= 0.5
    sums = np.add.reduceat(values.reshape(len(weight), -1) * weight[:, None], starts, axis=0)
    means = sums[keep] / total[keep, None]
    return means.reshape(len(means), *values.shape[1:]), total[keep] / width


def _drives(run: Run, temperatures: Names, drivers: Names) -> dict[str, Drive]:
    """Return what drives the effects, for each temperature that there is; missing values are interpolated."""
    bridged = {
        name: np.interp(run.time_s, run.time_s[known], run.mean[name][known])
        for name in (*ACCEL, *drivers, *temperatures)
        if name in run.mean and (known := np.isfinite(run.mean[name])).sum() > 1
    }
    accel = SampleBlock(bridged).accel
    others = {name: bridged[name] for name in drivers if name in bridged}
    return {n: Drive(run.time_s, bridged[n], accel, others) for n in temperatures if n in bridged}


def poses(force: FloatArray, resting: BoolArray) -> tuple[IntArray, BoolArray]:
    """Return the number of the pose in each slot, (n,), one more after each turn of the unit; and the slots
    that are `resting` without those in which it turns all the same, as where rest is declared.  `force`: the
    specific force in m/s², (n, 3); slots that are not `resting` have the pose before them."""
    turns, still = np.zeros(len(force), np.int64), resting.copy()
    slots = np.flatnonzero(resting)
    if len(slots) > 2 * BESIDE:
        total = np.cumsum(np.vstack([np.zeros(3), force[slots]]), axis=0)
        means = (total[BESIDE:] - total[:-BESIDE]) / BESIDE
        # change[i] leads from the mean of the resting slots i to i + 3 to that of i + 4 to i + 7.
        change = np.abs(means[BESIDE:] - means[:-BESIDE]).max(axis=1)
        # 0.1 m/s² is 0.6° of tilt: accelerometers repeat better from power-on to power-on.  Eight: assumed.
        turned = change > max(0.1, 8.0 * np.median(change))
        edges = np.flatnonzero(np.diff(np.concatenate([[False], turned, [False]])))
        for start, stop in edges.reshape(-1, 2).tolist():
            # The next pose begins with the slot behind the largest change.
            turns[slots[start + np.argmax(change[start:stop]) + BESIDE]] = 1
            # A turn that was detected is a gap; without one it is in slots that are declared at rest.
            compared = slots[start : stop + 2 * BESIDE - 1]
            is_gap = compared[-1] - compared[0] >= len(compared)
            still[compared] &= is_gap
    return np.cumsum(turns), still


def in_one_pose(valid: BoolArray, pose: IntArray, slots: int) -> BoolArray:
    """Return the valid slots without those of a block that are of another pose than most of it, (n,)."""
    kept = valid.copy()
    for turn in np.flatnonzero(np.diff(pose)) + 1:
        block = slice(turn // slots * slots, (turn // slots + 1) * slots)
        usual = np.argmax(np.bincount(pose[block][valid[block]], minlength=1))
        kept[block] &= pose[block] == usual
    return kept


def at_poses(run: RunInBlocks) -> RunInBlocks:
    """Return a run in which the specific force that drives effects is the mean of its pose: a reading that is
    to be explained must not explain its own noise."""
    if (force := run.force) is None:
        return run
    of_pose = np.array([force[run.pose == pose].mean(axis=0) for pose in run.pose])
    between_blocks_s = 0.5 * (run.time_s[1:] + run.time_s[:-1])
    accel = of_pose[np.searchsorted(between_blocks_s, run.in_slots.time_s)]
    return replace(run, drives={name: replace(drive, accel=accel) for name, drive in run.drives.items()})


def common_block_s(runs: Runs) -> float:
    """Return the length of a block: 30 s, or more where a log has few samples in that, or a run is long."""
    unit_s = LEAST_SLOTS * max(run.slot_s for run in runs)  # of which it is a multiple
    least_s = max(BLOCK_S, max(run.duration_s for run in runs) / MOST_BLOCKS)
    return unit_s * float(np.ceil(least_s / unit_s))


class WhiteFloor(NamedTuple):
    """Standard deviation of the white noise of a block, and what it was taken from."""

    sd: float
    source: str


def white_floor(channel: str, runs: RunsInBlocks) -> WhiteFloor:
    """Return the white floor of a channel: rms over the blocks, logs of several rates each by itself."""
    widths = sorted({run.slots_per_block for run in runs})
    if len(widths) == 1:
        return _floor_of_one_rate(channel, runs)
    of_rates = [[run for run in runs if run.slots_per_block == width] for width in widths]
    floors = [(_floor_of_one_rate(channel, some), sum(map(len, some))) for some in of_rates]
    variance = sum(number * floor.sd**2 for floor, number in floors) / sum(map(len, runs))
    return WhiteFloor(np.sqrt(variance), floors[0][0].source)


def _floor_of_one_rate(channel: str, runs: RunsInBlocks) -> WhiteFloor:
    """Return the white floor from the scatter inside blocks.

    It is half the mean square difference of neighbouring pieces of a block (an Allan variance), less the
    mean difference of the block: no ramp gets in.  A piece is a fifteenth of a block or less (2 s of 30 s):
    shorter ones would be too small by an output filter or too large by rounding, longer ones by flicker.
    Where every block lacks readings, its pieces have fewer slots; where pieces have none, or the same ones,
    neighbouring blocks are compared.  The clock's is that of the delays at both ends of a block.
    """
    slots = runs[0].slots_per_block
    of_runs = [np.where(run.weight > 0.0, run.in_slots.mean[channel], np.nan) for run in runs]
    in_blocks = [values[: len(values) // slots * slots].reshape(-1, slots) for values in of_runs]
    # What gaps add to the variance of a full block, on the average.
    gap_factor = np.concatenate([run.white for run in runs]).mean()
    width = max(1, slots // PIECES)  # slots of a piece
    number = slots // width
    pieces, count = _means(np.concatenate(in_blocks)[:, : number * width].reshape(-1, number, width))
    whole = (count == width).all(axis=1)
    used = whole if whole.any() else (count > 0).all(axis=1)
    differences = np.diff(pieces[used], axis=1)
    if channel == CLOCK or not differences.any():
        # NaN between runs: no step leads from one to the next.
        means = [values for blocks_of_run in in_blocks for values in (_means(blocks_of_run)[0], [np.nan])]
        sd = block_noise(np.concatenate(means)) * np.sqrt(gap_factor)
        return WhiteFloor(sd, "delays at the ends of blocks" if channel == CLOCK else "neighbouring blocks")
    spread = differences - differences.mean(axis=1, keepdims=True)
    # The mean of k differences is (last - first) / k, and takes 2 / k² of the variance away; `LEAST_PIECES`
    # and `LEAST_SLOTS` see to it that k is 2 or more.
    k = number - 1
    variance_of_piece = np.mean(spread**2) / (2.0 * (1.0 - 1.0 / k**2))
    slots_of_piece = width if whole.any() else 1.0 / np.mean(1.0 / count[used])
    sd = np.sqrt(variance_of_piece * slots_of_piece / slots * gap_factor)
    return WhiteFloor(sd, f"means of {width * runs[0].in_slots.slot_s:.0f} s inside blocks")


def _means(values: FloatArray) -> tuple[FloatArray, IntArray]:
    """Return means over the last axis of what is not missing, and how many values each has."""
    count = np.isfinite(values).sum(axis=-1)
    return np.where(count > 0, np.nansum(values, axis=-1) / np.maximum(count, 1), np.nan), count


def survey(runs: RunsInBlocks, temperatures: Iterable[str], degree: int) -> Survey:
    """Return what the training runs can show, with the drivers that there are beside temperature: that of the
    thermometer that varies most, for one of several may not."""
    of_all = {name: np.concatenate([run.temperature[name] for run in runs]) for name in temperatures}
    temperature = max(of_all, key=lambda name: np.ptp(of_all[name]))
    low, high = float(of_all[temperature].min()), float(of_all[temperature].max())
    forces = [force for run in runs if (force := run.force) is not None]
    others = {}
    for name in runs[0].drives[temperature].others:
        values = np.concatenate([run.average(run.drives[temperature].others[name]) for run in runs])
        others[name] = Scale(0.5 * float(values.min() + values.max()), 0.5 * float(np.ptp(values)) or 1.0)
    return Survey(
        durations_s=[float(run.time_s[-1]) + run.block_s / 2 for run in runs],
        span_degc=high - low,
        reversals=sum(_reversals(run.temperature[temperature], 0.2 * (high - low)) for run in runs),
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
