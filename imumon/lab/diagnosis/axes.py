"""The axes of one sensor as the search takes them: their blocks, white floors and declared models."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from imumon.clock.channel import CLOCK
from imumon.effects.base import Survey
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.blocks import RunBlocks, at_poses, make_blocks, survey, white_floor
from imumon.lab.diagnosis.candidates import Pool
from imumon.lab.diagnosis.channel import Channel, Declared, Own
from imumon.lab.diagnosis.earth import EarthRate, earth_rate, turned, without
from imumon.lab.diagnosis.known import effects_of
from imumon.lab.diagnosis.runs import Run, unit_of
from imumon.lab.diagnosis.usable import faults
from imumon.models.model import BiasModel

MOST_SEARCH_BLOCKS = 700
"""Longer runs are searched in longer blocks; they are scored in blocks of 30 s all the same."""
SHORTER, LEAST_SEARCH_BLOCKS = (1, 2, 3), 200
"""Shorter runs in blocks of a half or a third: of few blocks the one with a jump in it decides."""


@dataclass(frozen=True, slots=True)
class Assumed:
    """The declared model: the temperature of each channel, the degree, and what has an offset of its own."""

    temperatures: dict[str, str]
    degree: int
    own: Own


@dataclass(frozen=True, slots=True)
class Axes:
    """The axes of one sensor: `channels` in blocks of the usual length, which are scored, `searched` in those
    that are searched.

    `blocks` are the training of the latter, `survey` is what they can show; `caveats` say what was taken off.
    """

    channels: list[Channel]
    searched: list[Channel]
    blocks: list[RunBlocks]
    survey: Survey
    caveats: list[str]


def make_axes(
    train: Sequence[Run],
    blocks: Sequence[RunBlocks],
    tested: Sequence[RunBlocks],
    group: Sequence[str],
    assumed: Assumed,
    model: BiasModel | None = None,
) -> Axes:
    """Return the axes of a sensor; `blocks` are those of `train`, the earth rate is taken from the gyros.

    In each pose, and each day, other sensors have another part of gravity, field or weather, which nobody
    knows: they have an offset in each.
    """
    temperatures, block_s, caveats = assumed.temperatures, blocks[0].block_s, list[str]()
    own, earth = assumed.own, None
    if not group[0].startswith(("gyro", CLOCK)):
        own, blocks, tested = "pose", at_poses(blocks), at_poses(tested)
    models = {name: Declared.over(blocks, temperatures[name], assumed.degree, own) for name in group}
    if group[0].startswith("gyro") and turned(blocks):
        earth = earth_rate(blocks, group, temperatures, models[group[0]])
        caveats.append(_earth_caveat(earth))
    if earth is not None:
        blocks, tested = without(blocks, group, earth), without(tested, group, earth)
    pools = _pools(blocks, group, temperatures)
    channels = [
        Channel(
            name,
            unit_of(name),
            floor,
            models[name],
            pools[temperatures[name]],
            tested,
            faults(train, name, temperatures[name], floor.sd),
            known=None if model is None else effects_of(model.channels[name]),
        )
        for name in group
        for floor in [white_floor(train, name, block_s).of_blocks(blocks)]
    ]
    search_s = _search_block(blocks)
    if search_s != block_s:
        blocks = _blocks_again(train, blocks, assumed, search_s)
        blocks = blocks if earth is None else without(blocks, group, earth)
        blocks = at_poses(blocks) if own == "pose" else blocks
        pools = _pools(blocks, group, temperatures)
    searched = [channel.in_blocks(pools[channel.temperature], block_s / search_s) for channel in channels]
    shown = survey(blocks, temperatures[group[0]], assumed.degree, search_s)
    return Axes(channels, searched, list(blocks), shown, caveats)


def _pools(
    blocks: Sequence[RunBlocks], group: Sequence[str], temperatures: Mapping[str, str]
) -> dict[str, Pool]:
    """Return the pool of each temperature that a channel of the group is over."""
    return {
        temperature: Pool(blocks, temperature) for temperature in {temperatures[name]: 0 for name in group}
    }


def _blocks_again(
    train: Sequence[Run], blocks: Sequence[RunBlocks], assumed: Assumed, block_s: float
) -> list[RunBlocks]:
    """Return the runs that were used, of all channels, in blocks of another length."""
    used = {run.name for run in blocks}
    every = list(dict.fromkeys(assumed.temperatures.values()))
    others = list(blocks[0].drives[every[0]].others)
    return [
        make_blocks(run, list(assumed.temperatures), every, others, block_s)
        for run in train
        if run.name in used
    ]


def _earth_caveat(earth: EarthRate | None) -> str:
    if earth is None:
        return (
            "several poses: what is named g_sensitivity holds the vertical earth rate as well, up to"
            " 15.04 °/h per g on the diagonal; the horizontal earth rate of each pose is not told from"
            " an offset"
        )
    parts = [f"{earth.up / DEG_PER_H:+.2f} °/h up"] if earth.upright else []
    parts += [f"{earth.across / DEG_PER_H:.2f} °/h level"] if earth.level else []
    rest = (
        ""
        if earth.level
        else "; its horizontal part is another offset in each pose, which a magnetometer would tell"
    )
    return (
        f"several poses: the gyros have {' and '.join(parts)} in common; it is taken for the earth rate"
        f" (latitude {earth.latitude_deg:+.0f}°) and subtracted{rest}"
    )


def _search_block(blocks: Sequence[RunBlocks]) -> float:
    """Return the length in seconds of the blocks that these, of the usual length, are searched in."""
    longest = max(map(len, blocks))
    shorter = next((part for part in SHORTER if part * longest >= LEAST_SEARCH_BLOCKS), SHORTER[-1])
    return blocks[0].block_s * max(1, -(-longest // MOST_SEARCH_BLOCKS)) / shorter
