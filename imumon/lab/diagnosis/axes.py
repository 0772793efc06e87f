"""The engine of diagnosis, live search and plans: the axes of a sensor over each base, searched.

A base is what effects are searched beside: the declared curve or the present model, as it is or fitted anew,
with or without a constant in each pose.  The base counts that is likeliest with what was found beside it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.clock.channel import CLOCK
from imumon.geodesy import EARTH_RATE
from imumon.lab.diagnosis.blocks import RunBlocks, at_poses, survey, white_floor
from imumon.lab.diagnosis.candidates import Pool
from imumon.lab.diagnosis.channel import Channel, Declared, Own, Recorded, effects_of, least_squares
from imumon.lab.diagnosis.choice import PROVEN
from imumon.lab.diagnosis.runs import unit_of
from imumon.lab.diagnosis.search import STAGES, Progress, Search, search
from imumon.lab.diagnosis.usable import faults

SHORTER, LEAST_SEARCH_BLOCKS = (1, 2, 3), 200
"""Runs of fewer blocks are searched in halves or thirds of them."""
EARTH_SPREAD = 2.1 * EARTH_RATE
"""rad/s: most that the constants of a gyro in two poses differ by the earth rate, and by 5 % of its scale."""


def search_sensor(
    data: Recorded,
    group: Sequence[str],
    effects: Sequence[str],
    stages: int = STAGES,
    progress: Progress | None = None,
) -> list[list[Search]]:
    """Return the search in the axes of a sensor beside each base that is possible.

    In each pose, and each day, other sensors than gyros have another part of gravity, field or weather, which
    is not known: they have a constant in each.  So may gyros have, by the earth rate.
    """
    owns: list[Own] = [data.own] if group[0].startswith(("gyro", CLOCK)) else []
    blocks = data.shorter or data.blocks
    turned = any(run.pose.max() > run.pose.min() for run in blocks)
    if not owns or (group[0].startswith("gyro") and turned):
        owns.append("pose")
    found = []
    for own in owns:
        channels = _channels(data, group, own, blocks)
        shown = survey(channels[0].pool.runs, channels[0].temperature, data.degree)
        found.append(search(channels, shown, effects, stages, progress))
        if any(channel.refitted for channel in channels):
            given = [channel.as_given() for channel in channels]
            found.append(search(given, shown, effects, stages, progress))
    return found


def scored_channels(data: Recorded, found: Sequence[Search]) -> list[Channel]:
    """Return the axes that were searched, over the base of the search, in the blocks that are scored."""
    searched = [one.channel for one in found]
    group, own = [channel.name for channel in searched], searched[0].declared.own
    return [
        replace(channel, declared=replace(channel.declared, degree=like.declared.degree), kept=like.kept)
        for channel, like in zip(_channels(data, group, own, data.blocks), searched, strict=True)
    ]


def search_block_s(blocks: Sequence[RunBlocks]) -> float:
    """Return the length of the blocks to search in."""
    longest = max(map(len, blocks))
    part = next((part for part in SHORTER if part * longest >= LEAST_SEARCH_BLOCKS), SHORTER[-1])
    return blocks[0].block_s / part


def _channels(data: Recorded, group: Sequence[str], own: Own, blocks: Sequence[RunBlocks]) -> list[Channel]:
    """Return the axes of a sensor over one base, in these blocks."""
    tested = data.test
    if own == "pose":
        blocks, tested = at_poses(blocks), at_poses(tested)
    pools = {name: Pool(blocks, name) for name in dict.fromkeys(data.temperatures[axis] for axis in group)}
    found = []
    for name in group:
        temperature, floor = data.temperatures[name], white_floor(data.runs, name, blocks)
        found.append(
            Channel(
                name,
                unit_of(name),
                floor,
                Declared.over(blocks, temperature, data.degree, own),
                pools[temperature],
                tested,
                faults(data.runs, name, floor.sd),
                known=None if data.model is None else effects_of(data.model.channels[name]),
            )
        )
    return found


def likeliest(searched: Sequence[list[Search]], *, live: bool = False) -> list[Search]:
    """Return the search over the base that is likeliest with what was found beside it.

    A present model is fitted anew only where that is proven; live, where it is likelier, for nothing is
    written.  What constants in each pose explain as well may be the earth rate.  Larger ones are not its.
    Live they are not paid for, as one session has hardly more poses than a sensitivity to g has coefficients:
    effects have to be likelier than any earth rate.
    """
    several = len({found[0].channel.declared.own for found in searched}) > 1

    def order(axes: list[Search]) -> float:
        criterion = sum(found.criterion() for found in axes)
        if axes[0].channel.refitted and not live:
            criterion -= PROVEN
        if axes[0].channel.declared.own != "pose" or not several:
            return criterion
        constants = [_constants_of_poses(found) for found in axes]
        if max(np.ptp(np.append(values, 0.0)) for values in constants) > EARTH_SPREAD:
            return -np.inf
        price = math.log(len(axes[0].channel.values)) * sum(map(len, constants))
        return criterion + PROVEN + (price if live else 0.0)

    return max(searched, key=order)


def _constants_of_poses(found: Search) -> FloatArray:
    """Return the constants of a channel in further poses than the first, beside what was found."""
    channel = found.channel
    coefficients = least_squares(channel.design(found.model), channel.values)
    return coefficients[channel.declared.degree + 1 : channel.base.shape[1]]
