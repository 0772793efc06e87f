"""The whole diagnosis: runs in, verdicts out."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.effects.base import LEAST_SPAN_DEGC, Survey
from imumon.effects.library import effects_for
from imumon.errors import ImumonError, Reason
from imumon.lab.calibration.gravity import Length
from imumon.lab.diagnosis.axes import Base, axes_over_bases, likeliest, search_block
from imumon.lab.diagnosis.blocks import (
    LEAST_BLOCKS,
    RunBlocks,
    common_block_s,
    specific_force,
    survey,
)
from imumon.lab.diagnosis.channel import Declared
from imumon.lab.diagnosis.claims import decide
from imumon.lab.diagnosis.known import (
    check_range,
    modelled,
    order_of,
    temperature_of,
    with_needed,
    without_curve,
)
from imumon.lab.diagnosis.runs import SENSORS, STRETCHES, Run, channels_of, divided, in_order
from imumon.lab.diagnosis.search import Progress, search
from imumon.lab.diagnosis.usable import (
    check_training,
    confounded,
    sound,
    temperature_of_axis,
    usable_blocks,
    usable_channels,
    usable_drivers,
)
from imumon.lab.diagnosis.verdict import ChannelVerdict
from imumon.models.curves.polynomial import CUBIC
from imumon.models.model import BiasModel

HIGHEST_DEGREE = 8


@dataclass(slots=True)
class Diagnosis:
    """Verdicts on all channels, and caveats of the data.

    `model` is the present one, or None.  `held_out`: whether the test is part of the
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

    Raises BAD_DATA when the data cannot show anything, saying why; BAD_CONFIG for a wrong declared model,
    or a known one that holds at no temperature of the training.
    """
    degree, offsets = parse_declared(declared)
    caveats = [*dict.fromkeys(text for run in (*train, *test) for text in run.warnings)]
    channels = usable_channels(train, test, sensors, caveats)
    train, test, held = _divided(train, test, channels, caveats)
    if model is None:
        temperatures = {name: temperature_of_axis(name, train) for name in channels}
    else:
        channels = modelled(channels, model)
        temperatures = {name: temperature_of(name, model, train) for name in channels}
        train, test = ([without_curve(run, model, temperatures) for run in runs] for runs in (train, test))
        degree = max(order_of(model.channels[name]) for name in channels)
        drivers = with_needed(drivers, model, temperatures)
    used = list(dict.fromkeys(temperatures.values()))
    others = usable_drivers(train, test, [*used, *channels], drivers, caveats)
    block_s = common_block_s([*train, *test])
    (blocks, moving), (tested, _) = (
        usable_blocks(runs, channels, used, others, block_s, caveats) for runs in (train, test)
    )
    check_training(blocks, moving, block_s)
    shown = survey(blocks, used[0], degree, block_s)
    if shown.thermal and model is not None:  # else no curve is fitted, and that of the model stays as it is
        check_range(model, temperatures, blocks)
    if test and not tested:
        caveats.append("no run of the test can be used: there is no independent proof")
    degree = degree if shown.thermal else 0
    caveats += _limits(blocks, tested, shown, confounded(blocks, used[0], shown.scale, degree))
    base = Base(temperatures, degree, "run" if offsets else "", search_block(blocks))
    diagnosis = Diagnosis(declared, block_s, [], blocks, tested, shown, caveats, model, held)
    for sensor in sensors:
        if group := channels_of([sensor], channels):
            diagnosis.verdicts += _sensor(train, group, base, diagnosis, progress)
    return diagnosis


def _divided(
    train: Sequence[Run], test: Sequence[Run], channels: Sequence[str], caveats: list[str]
) -> tuple[list[Run], list[Run], bool]:
    """Return sound runs of training and test, and whether parts of the only one are held out as a test."""
    train, test = (sound(runs, channels, caveats) for runs in (train, test))
    test = in_order(train, test, caveats)
    long = len(train) == 1 and train[0].duration_s >= 2 * LEAST_BLOCKS * common_block_s(train)
    if test or not long:
        return train, test, False
    caveats.append(
        f"no test data: every other {train[0].duration_s / STRETCHES / 60:.0f} min of the one run are"
        " held out as a test.  That is weaker than another power-on: what is particular to this run, and"
        " any noise that is slower, is in both"
    )
    first, other = divided(train[0], channels)
    return [first], [other], True


def _limits(
    train: Sequence[RunBlocks], test: Sequence[RunBlocks], shown: Survey, alike: Sequence[str]
) -> list[str]:
    """Return what this data cannot show; `alike` are drivers that went with temperature or time."""
    limits = []
    if not shown.thermal:
        limits.append(
            f"the temperature moves by {shown.span_degc:.1f} °C only ({LEAST_SPAN_DEGC:.0f} °C are needed):"
            " no curve over temperature is fitted, and no effect of temperature can be found"
        )
    if not test:
        limits.append("no test data: nothing proves what is claimed but the data that it was fitted to")
    if len(train) < 2:
        limits.append("one training run: what depends on time and what depends on temperature may look alike")
    if alike and shown.thermal:
        limits.append(
            f"{', '.join(alike)} went with temperature or time in training: what depends on one of them looks"
            " as if it depended on the other"
        )
    return limits


def _sensor(
    train: Sequence[Run],
    group: Sequence[str],
    base: Base,
    diagnosis: Diagnosis,
    progress: Progress | None,
) -> list[ChannelVerdict]:
    """Return the verdicts on the axes of one sensor."""
    if group[0].startswith("accel") and len(group) == 3:
        gravity = _length(diagnosis.train, base.temperatures[group[0]], base.degree)
        if gravity is not None:
            poses, diagnosis.length = gravity
            diagnosis.caveats.append(diagnosis.length.described(poses))
    every = axes_over_bases(train, diagnosis.train, diagnosis.test, group, base, diagnosis.model)
    names = effects_for(group[0])
    axes, found = likeliest(
        [(axes, search(axes.searched, axes.survey, names, progress=progress)) for axes in every]
    )
    if group[0].startswith("gyro") and any(run.pose.any() for run in diagnosis.train):
        diagnosis.caveats.append(
            "several poses: the gyros have another constant in each, as the earth rate makes it; a"
            " sensitivity to g cannot be distinguished from that"
            if axes.base.own == "pose"
            else "several poses: what is named g_sensitivity holds the vertical earth rate as well, up to"
            " 15.04 °/h per g on the diagonal"
        )
    return [decide(channel, one) for channel, one in zip(axes.channels, found, strict=True)]


def _length(runs: Sequence[RunBlocks], temperature: str, degree: int) -> tuple[int, Length] | None:
    """Return the number of poses and what |f| = g in them determines; None where they are too few."""
    forces = [force for run in runs if (force := specific_force(run)) is not None]
    if len(forces) < len(runs):
        return None
    declared = Declared.over(runs, temperature, degree, "pose")
    powers = np.concatenate([declared.columns(run.temperature[temperature])[:, 1:] for run in runs])
    return Length.from_poses(np.concatenate(forces), powers)
