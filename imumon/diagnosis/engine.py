"""The whole diagnosis: runs in, verdicts out."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.diagnosis.blocks import (
    LEAST_BLOCKS,
    REST_SHARE,
    RunBlocks,
    common_block_s,
    make_blocks,
    survey,
    white_floor,
)
from imumon.diagnosis.candidates import Pool
from imumon.diagnosis.channel import Channel, Declared, Own
from imumon.diagnosis.device_clock import CLOCK
from imumon.diagnosis.drivers import recorded, shadows, with_drivers
from imumon.diagnosis.earth import EarthRate, earth_rate, turned, without
from imumon.diagnosis.faults import faults, without_standstill
from imumon.diagnosis.gravity import Length, at_poses, length
from imumon.diagnosis.known import (
    drivers_of,
    effects_of,
    modelled,
    order_of,
    temperature_of,
    without_curve,
)
from imumon.diagnosis.recording import (
    CHANNELS,
    SENSORS,
    Run,
    channels_of,
    common_temperature,
    unit_of,
)
from imumon.diagnosis.selection import search
from imumon.diagnosis.train_and_test import STRETCHES, divided, in_order
from imumon.diagnosis.verdict import ChannelVerdict, settle
from imumon.effects.base import LEAST_SPAN_DEGC, Survey
from imumon.effects.library import effects_for
from imumon.errors import ImumonError, Reason
from imumon.geodesy import DEG_PER_H
from imumon.models.curves.polynomial import CUBIC
from imumon.models.model import BiasModel

LEAST_RUN_BLOCKS = 8
LEAST_REST = 0.5
LEAST_THERE = 0.1
"""Share of its time in which a channel that is used has samples."""
MANY_GAPS = 0.2
MOST_SEARCH_BLOCKS = 700
"""Longer runs are searched in longer blocks; they are scored in blocks of 30 s all the same."""
SHORTER, LEAST_SEARCH_BLOCKS = (1, 2, 3), 200
"""Shorter runs in blocks of a half or a third: of few blocks the one with a jump in it decides."""
HIGHEST_DEGREE = 8

Progress = Callable[[str], None]


@dataclass(frozen=True, slots=True)
class Names:
    """Channels, the temperatures that their curves are over, and other drivers."""

    channels: Sequence[str]
    temperatures: Sequence[str]
    drivers: Sequence[str]


@dataclass(slots=True)
class Diagnosis:
    """Verdicts on all channels, and what has to be said of the data.

    `model` is the one that was given to begin with, or None.  `held_out` says that the test is part of the
    one run that there is.  `length` is what follows from |f| = g in several poses.
    """

    declared: str
    block_s: float
    verdicts: list[ChannelVerdict]
    train: Sequence[RunBlocks]
    test: Sequence[RunBlocks]
    survey: Survey
    caveats: list[str] = field(default_factory=list)
    model: BiasModel | None = None
    held_out: bool = False
    length: Length | None = None


def parse_declared(text: str) -> tuple[int, bool]:
    """Return degree and whether each run has an offset of its own, from ``polynomial 3`` or ``polynomial 3
    + offset``.

    Raises BAD_CONFIG for anything else.
    """
    match = re.fullmatch(r"\s*polynomial\s+(\d+)(\s*\+\s*offset)?\s*", text)
    if match is None or int(match[1]) > HIGHEST_DEGREE:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"--declared {text!r} is not understood",
            f"use 'polynomial N', N from 0 to {HIGHEST_DEGREE}; '+ offset' for a constant of each run",
        )
    return int(match[1]), match[2] is not None


def diagnose(
    train: Sequence[Run],
    test: Sequence[Run],
    declared: str = CUBIC,
    progress: Progress | None = None,
    sensors: Sequence[str] = SENSORS,
    model: BiasModel | None = None,
    drivers: Sequence[str] | None = None,
) -> Diagnosis:
    """Find what the declared model leaves over in the training runs, name it, and prove it on the test runs.

    `sensors` are those to be diagnosed: gyro, accel, mag, or any recorded column; what is diagnosed drives
    nothing.  With a `model` that is known, its curve is taken from every run; curve and effects of it are
    fitted anew beside what is found, where the runs show them, and `declared` does not count.
    `drivers` are what may drive an effect beside temperature, time and specific force; None: all that was
    recorded and varies.

    Raises BAD_DATA when the data cannot show anything, saying why; BAD_CONFIG for a wrong declared model.
    """
    degree, offsets = parse_declared(declared)
    caveats = [*dict.fromkeys(text for run in (*train, *test) for text in run.warnings)]
    channels = _channels(train, sensors, caveats)
    if len(channels) > 1 and not all(CLOCK in run.mean for run in (*train, *test)):
        channels = [name for name in channels if name != CLOCK]
    train, test = (_sound(runs, channels, caveats) for runs in (train, test))
    test = in_order(train, test, caveats)
    long = len(train) == 1 and train[0].duration_s >= 2 * LEAST_BLOCKS * common_block_s(train)
    held = long and not test
    if held:
        train, test = ([part] for part in divided(train[0], channels))
        caveats.append(
            f"no test data: every other {train[0].duration_s / STRETCHES / 60:.0f} min of the one run are"
            " held out as a test.  That is weaker than another power-on: what is particular to this run, and"
            " any noise that is slower, is in both"
        )
    if model is not None:
        channels = modelled(channels, model)
        temperatures = {name: temperature_of(name, model, train) for name in channels}
        train, test = ([without_curve(run, model, temperatures) for run in runs] for runs in (train, test))
        degree = max(order_of(model.channels[name]) for name in channels)
        needed = [name for name in drivers_of(model, channels) if name not in temperatures.values()]
        drivers = drivers if drivers is None else list(dict.fromkeys([*drivers, *needed]))
    else:
        temperatures = {name: _temperature_of(name, train) for name in channels}
    used = list(dict.fromkeys(temperatures.values()))
    others = recorded(train, test, [*used, *channels], drivers, caveats)
    block_s = common_block_s([*train, *test])
    names = Names(channels, used, others)
    blocks = _usable(train, names, block_s, caveats, "training")
    tested = _usable(test, names, block_s, caveats, "test") if test else []
    total = sum(map(len, blocks))
    if total < LEAST_BLOCKS:
        raise ImumonError(
            Reason.BAD_DATA,
            f"too short: the training data has {total} means of {block_s:.0f} s at rest;"
            f" {LEAST_BLOCKS} are needed, {LEAST_BLOCKS * block_s / 60:.0f} min",
            "record the unit at rest for an hour or more while its temperature changes;"
            " if it was at rest and is not seen to be, add --at-rest",
        )
    seen = survey(blocks, used[0], degree, block_s)
    if not seen.thermal:
        caveats.append(
            f"the temperature moves by {seen.span_degc:.1f} °C only ({LEAST_SPAN_DEGC:.0f} °C are needed):"
            " no curve over temperature is fitted, and no effect of temperature can be found"
        )
        degree = 0
    _remark(blocks, tested, caveats)
    if others and seen.thermal and (said := shadows(blocks, used[0], seen.scale, degree)):
        caveats.append(
            f"{', '.join(said)} went with temperature or time in training: what depends on one of them looks"
            " as if it depended on the other"
        )
    diagnosis = Diagnosis(declared, block_s, [], blocks, tested, seen, caveats, model, held)
    for sensor in sensors:
        group = channels_of([sensor], channels)
        if group:
            diagnosis.verdicts += _sensor(train, group, temperatures, diagnosis, degree, offsets, progress)
    return diagnosis


def _sensor(
    train: Sequence[Run],
    group: Sequence[str],
    temperatures: dict[str, str],
    diagnosis: Diagnosis,
    degree: int,
    offsets: bool,
    progress: Progress | None,
) -> list[ChannelVerdict]:
    """Return the verdicts on the axes of one sensor."""
    blocks, tested, block_s = diagnosis.train, diagnosis.test, diagnosis.block_s
    own: Own = "run" if offsets else ""
    if not group[0].startswith(("gyro", CLOCK)):
        # In each pose, and each day, another part of gravity, field or weather is seen, which nobody knows.
        own = "pose"
        if group[0].startswith("accel"):
            _add_length(group, temperatures[group[0]], degree, diagnosis)
        blocks, tested = at_poses(blocks), at_poses(tested)
    models = {name: Declared.over(blocks, temperatures[name], degree, own) for name in group}
    earth = None
    if group[0].startswith("gyro") and turned(blocks):
        earth = earth_rate(blocks, group, temperatures, models[group[0]])
        diagnosis.caveats.append(_said_of_earth(earth))
    if earth is not None:
        blocks, tested = without(blocks, group, earth), without(tested, group, earth)
    used = list(dict.fromkeys(temperatures[name] for name in group))
    pools = {temperature: Pool(blocks, temperature) for temperature in used}
    channels = [
        Channel(
            name,
            unit_of(name),
            floor,
            models[name],
            pools[temperatures[name]],
            tested,
            faults(train, name, temperatures[name], floor.sd),
            known=None if diagnosis.model is None else effects_of(diagnosis.model.channels[name]),
        )
        for name in group
        for floor in [white_floor(train, name, block_s).of_blocks(blocks)]
    ]
    searched, search_s = blocks, search_block(blocks)
    if search_s != block_s:
        usable = [run for run in train if run.name in {block.name for block in blocks}]
        every = list(dict.fromkeys(temperatures.values()))
        others = list(blocks[0].drives[used[0]].others)
        searched = [make_blocks(run, list(temperatures), every, others, search_s) for run in usable]
        searched = searched if earth is None else without(searched, group, earth)
        searched = at_poses(searched) if own == "pose" else searched
        pools = {temperature: Pool(searched, temperature) for temperature in used}
    temperature = temperatures[group[0]]
    found = search(
        [channel.in_blocks(pools[channel.temperature], block_s / search_s) for channel in channels],
        with_drivers(survey(searched, temperature, degree, search_s), searched, temperature),
        effects_for(group[0]),
        progress,
    )
    return [settle(channel, one) for channel, one in zip(channels, found, strict=True)]


def _add_length(group: Sequence[str], temperature: str, degree: int, diagnosis: Diagnosis) -> None:
    """Add to a diagnosis what follows from the length of gravity, where there are poses enough."""
    declared = Declared.over(diagnosis.train, temperature, degree, "pose")
    found = length(diagnosis.train, temperature, declared) if len(group) == 3 else None
    if found is not None:
        diagnosis.length = found[1]
        diagnosis.caveats.append(found[1].said(found[0]))


def _said_of_earth(earth: EarthRate | None) -> str:
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


def _sound(runs: Sequence[Run], channels: Sequence[str], caveats: list[str]) -> list[Run]:
    """Return runs without what is a fault of the data, which is named."""
    both = [without_standstill(run, channels) for run in runs]
    caveats += [text for _, said in both for text in said]
    return [run for run, _ in both]


def search_block(blocks: Sequence[RunBlocks]) -> float:
    """Return the length in seconds of the blocks that these, of the usual length, are searched in."""
    longest = max(map(len, blocks))
    shorter = next((part for part in SHORTER if part * longest >= LEAST_SEARCH_BLOCKS), SHORTER[-1])
    return blocks[0].block_s * max(1, -(-longest // MOST_SEARCH_BLOCKS)) / shorter


def _channels(runs: Sequence[Run], sensors: Sequence[str], caveats: list[str]) -> list[str]:
    """Return the channels that every training run has at a tenth of its time or more, and that vary at all.

    Raises BAD_DATA when there is none.
    """
    found = []
    for name in channels_of(sensors, {name for run in runs for name in run.variance}):
        there = [run for run in runs if name in run.mean and np.isfinite(run.mean[name]).mean() > LEAST_THERE]
        if not there:
            continue
        if len(there) < len(runs):
            lacking = ", ".join(run.name for run in runs if run not in there)
            caveats.append(f"{name} is left out: {lacking} hardly has it")
        elif not any(np.nanstd(run.mean[name]) > 0 or np.nanmax(run.variance[name]) > 0 for run in runs):
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


def _temperature_of(channel: str, runs: Sequence[Run]) -> str:
    """Return the temperature that a channel's bias is over: that of its axis where there is one.

    Raises BAD_DATA when there is no temperature.
    """
    lacking = "there is no temperature in the training data, so there is no bias over temperature to diagnose"
    return common_temperature(f"temperature_{channel[-1]}", runs, lacking, but=channel)


def resting(run: Run) -> bool:
    """Tell whether the unit was at rest for most of a run."""
    return any(_rest_share(run, name) >= LEAST_REST for name in CHANNELS if name in run.mean)


def _rest_share(run: Run, channel: str) -> float:
    there = np.isfinite(run.mean[channel])[run.earlier :]
    return float((run.rest[run.earlier :][there] >= REST_SHARE).mean()) if there.any() else 0.0


def _usable(
    runs: Sequence[Run], names: Names, block_s: float, caveats: list[str], what: str
) -> list[RunBlocks]:
    """Return the runs as blocks, without those that cannot be used, which are named.

    Raises BAD_DATA when the unit was hardly at rest.
    """
    found = []
    moving = []
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
    if moving and not found and what == "training":
        raise ImumonError(
            Reason.BAD_DATA,
            "the unit moves: " + "; ".join(moving),
            "what the bias model lacks can be told only of a unit at rest; if it was, add --at-rest",
        )
    caveats += [f"{text}: not used, it moves" for text in moving]
    if what == "test" and not found:
        caveats.append("no run of the test can be used: there is no independent proof")
    return found


def _remark(train: Sequence[RunBlocks], test: Sequence[RunBlocks], caveats: list[str]) -> None:
    """Say what this data cannot show, whatever it is."""
    if not test:
        caveats.append("no test data: nothing proves what is claimed but the data that it was fitted to")
    if len(train) < 2:
        caveats.append(
            "one training run: what depends on time and what depends on temperature may look alike"
        )
