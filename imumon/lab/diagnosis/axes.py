"""The axes of one sensor as the search takes them: their blocks, white floors and declared models."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.clock.channel import CLOCK
from imumon.effects.base import Survey
from imumon.geodesy import EARTH_RATE
from imumon.lab.diagnosis.blocks import RunBlocks, at_poses, make_blocks, survey, white_floor
from imumon.lab.diagnosis.candidates import Pool
from imumon.lab.diagnosis.channel import Channel, Declared, Own, least_squares
from imumon.lab.diagnosis.choice import PROVEN
from imumon.lab.diagnosis.known import effects_of
from imumon.lab.diagnosis.runs import Run, unit_of
from imumon.lab.diagnosis.search import Search
from imumon.lab.diagnosis.usable import faults, with_drivers
from imumon.models.model import BiasModel

MOST_SEARCH_BLOCKS = 1200
"""Longer runs are searched in longer blocks; they are scored in blocks of 30 s all the same."""
SHORTER, LEAST_SEARCH_BLOCKS = (1, 2, 3), 200
"""Shorter runs in blocks of a half or a third: of few blocks the one with a jump in it decides."""
EARTH_SPREAD = 2.1 * EARTH_RATE
"""rad/s: most that the constants of a gyro in two poses differ by the earth rate, and by 5 % of its scale."""


@dataclass(frozen=True, slots=True)
class Base:
    """The declared model: the temperature of each channel, the degree, and what has an offset of its own.

    `search_s` is the length of the blocks that are searched.
    """

    temperatures: dict[str, str]
    degree: int
    own: Own
    search_s: float


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of one sensor: `channels` in blocks of the usual length, which are scored, `searched` in those
    that are searched.

    `survey` is what the training can show; `base` is the base that the effects are searched beside.
    """

    channels: list[Channel]
    searched: list[Channel]
    survey: Survey
    base: Base


Searched = tuple[Axes, list[Search]]
"""Axes over one base, and what the search found in each beside it."""


def axes_over_bases(
    train: Sequence[Run],
    blocks: Sequence[RunBlocks],
    tested: Sequence[RunBlocks],
    group: Sequence[str],
    base: Base,
    model: BiasModel | None = None,
) -> list[Axes]:
    """Return the axes of a sensor over each base that is possible.

    In each pose, and each day, other sensors than gyros have another part of gravity, field or weather, which
    is not known: they have a constant in each.  So may gyros have, by the earth rate.
    """
    bases = [base] if group[0].startswith(("gyro", CLOCK)) else []
    turned = any(run.pose.max() > run.pose.min() for run in blocks)
    if not bases or (group[0].startswith("gyro") and turned):
        bases.append(replace(base, own="pose"))
    return [_axes(train, blocks, tested, group, base, model) for base in bases]


def likeliest(searched: Sequence[Searched], *, pays_for_poses: bool = True) -> Searched:
    """Return the axes over the base that is likeliest with what was found beside it.

    What constants in each pose explain as well may be the earth rate.  Larger ones are not its.  Where they
    are not paid for, effects have to be likelier than any earth rate.
    """

    def order(one: Searched) -> float:
        criterion = sum(found.criterion() for found in one[1])
        if one[0].base.own != "pose" or len(searched) == 1:
            return criterion
        constants = [_constants_of_poses(found) for found in one[1]]
        if max(np.ptp(np.append(values, 0.0)) for values in constants) > EARTH_SPREAD:
            return -np.inf
        price = math.log(len(one[1][0].channel.values)) * sum(map(len, constants))
        return criterion + PROVEN + (0.0 if pays_for_poses else price)

    return max(searched, key=order)


def _constants_of_poses(found: Search) -> FloatArray:
    """Return the constants of a channel in further poses than the first, beside what was found."""
    channel = found.channel
    coefficients = least_squares(channel.design(found.model), channel.values)
    return coefficients[channel.declared.degree + 1 : channel.base.shape[1]]


def _axes(
    train: Sequence[Run],
    blocks: Sequence[RunBlocks],
    tested: Sequence[RunBlocks],
    group: Sequence[str],
    base: Base,
    model: BiasModel | None,
) -> Axes:
    """Return the axes of a sensor over one base; `blocks` are those of `train`."""
    temperatures, block_s, own = base.temperatures, blocks[0].block_s, base.own
    if own == "pose":
        blocks, tested = at_poses(blocks), at_poses(tested)
    pools = _pools(blocks, group, temperatures)
    channels = [
        Channel(
            name,
            unit_of(name),
            floor,
            Declared.over(blocks, temperatures[name], base.degree, own),
            pools[temperatures[name]],
            tested,
            faults(train, name, temperatures[name], floor.sd),
            known=None if model is None else effects_of(model.channels[name]),
        )
        for name in group
        for floor in [white_floor(train, name, block_s).of_blocks(blocks)]
    ]
    search_s = base.search_s
    if search_s != block_s:
        blocks = _blocks_again(train, blocks, base, search_s)
        blocks = at_poses(blocks) if own == "pose" else blocks
        pools = _pools(blocks, group, temperatures)
    searched = [channel.in_blocks(pools[channel.temperature], block_s / search_s) for channel in channels]
    temperature = temperatures[group[0]]
    shown = with_drivers(survey(blocks, temperature, base.degree, search_s), blocks, temperature)
    return Axes(channels, searched, shown, base)


def _pools(
    blocks: Sequence[RunBlocks], group: Sequence[str], temperatures: Mapping[str, str]
) -> dict[str, Pool]:
    """Return the pool of each temperature that a channel of the group is over."""
    return {name: Pool(blocks, name) for name in dict.fromkeys(temperatures[channel] for channel in group)}


def _blocks_again(
    train: Sequence[Run], blocks: Sequence[RunBlocks], base: Base, block_s: float
) -> list[RunBlocks]:
    """Return the runs that were used, of all channels, in blocks of another length."""
    used = {run.name for run in blocks}
    every = list(dict.fromkeys(base.temperatures.values()))
    others = list(blocks[0].drives[every[0]].others)
    return [
        make_blocks(run, list(base.temperatures), every, others, block_s) for run in train if run.name in used
    ]


def search_block(blocks: Sequence[RunBlocks]) -> float:
    """Return the length in seconds of the blocks that these, of the usual length, are searched in."""
    longest = max(map(len, blocks))
    shorter = next((part for part in SHORTER if part * longest >= LEAST_SEARCH_BLOCKS), SHORTER[-1])
    return blocks[0].block_s * max(1, -(-longest // MOST_SEARCH_BLOCKS)) / shorter
