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
from imumon.lab.diagnosis.axes import likeliest, scored_channels, search_block_s, search_sensor
from imumon.lab.diagnosis.blocks import LEAST_BLOCKS, RunBlocks, common_block_s, specific_force, survey
from imumon.lab.diagnosis.channel import (
    Declared,
    Own,
    Recorded,
    check_range,
    curves_of,
    order_of,
    temperature_of,
    without_model,
)
from imumon.lab.diagnosis.runs import (
    SENSORS,
    STRETCHES,
    Run,
    channels_of,
    common_temperature,
    divided,
    in_order,
)
from imumon.lab.diagnosis.search import Progress, Search
from imumon.lab.diagnosis.usable import (
    check_training,
    usable_blocks,
    usable_channels,
    usable_drivers,
    without_standstill,
)
from imumon.lab.diagnosis.verdict import ChannelVerdict, decide
from imumon.models.curves.polynomial import CUBIC
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

HIGHEST_DEGREE = 8


@dataclass(slots=True)
class Diagnosis:
    """Verdicts on all channels, and caveats of the data.

    `model` is the present one, or None.  `held_out`: whether the test is part of the one run that there is.
    `length` is what follows from |f| = g in several poses.
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
    nothing.  With a `model` that is known, the search begins with that, as it is and fitted anew, and
    `declared` does not count.  `drivers` are what may drive an effect beside temperature, time and specific
    force; None: all that was recorded and varies.

    Raises BAD_DATA when the data cannot show anything, saying why; BAD_CONFIG for a wrong declared model,
    or a known one that holds at no temperature of the training.
    """
    remarks = [*dict.fromkeys(text for run in (*train, *test) for text in run.warnings)]
    data = _prepared(train, test, parse_declared(declared), sensors, model, drivers, remarks)
    verdicts: list[ChannelVerdict] = []
    for sensor in sensors:
        group = channels_of([sensor], data.temperatures)
        if group:
            found = likeliest(search_sensor(data, group, effects_for(group[0]), progress=progress))
            verdicts += map(decide, found, scored_channels(data, found))
            remarks += _on_poses(data, found)
    length = _length(data, remarks)
    return Diagnosis(
        declared=declared,
        block_s=data.blocks[0].block_s,
        verdicts=verdicts,
        train=data.blocks,
        test=data.test,
        survey=survey(data.blocks, verdicts[0].channel.temperature, data.degree),
        caveats=remarks,
        model=model,
        held_out=any(run.share < 1.0 for run in data.runs),
        length=length,
    )


def _length(data: Recorded, remarks: list[str]) -> Length | None:
    """Return what |f| = g determines of the accelerometers in several poses, and add that in words."""
    forces = [force for run in data.blocks if (force := specific_force(run)) is not None]
    if len(channels_of(["accel"], data.temperatures)) < 3 or len(forces) < len(data.blocks):
        return None
    temperature = data.temperatures["accel_x"]
    declared = Declared.over(data.blocks, temperature, data.degree, "pose")
    powers = [declared.columns(run.temperature[temperature])[:, 1:] for run in data.blocks]
    found = Length.from_poses(np.concatenate(forces), np.concatenate(powers))
    if found is None:
        return None
    poses, length = found
    remarks.append(length.described(poses))
    return length


def _prepared(
    train: Sequence[Run],
    test: Sequence[Run],
    declared: tuple[int, bool],
    sensors: Sequence[str],
    model: BiasModel | None,
    drivers: Sequence[str] | None,
    remarks: list[str],
) -> Recorded:
    """Return what is searched; on what is not, and on limits, it adds to the remarks."""
    degree, offsets = declared
    channels = usable_channels(train, test, sensors, remarks)
    train, test = _divided(train, test, channels, remarks)
    if model is None:
        # That of its axis, where there is one.
        lacking = "there is no temperature in the training data, so there is no bias over it to diagnose"
        temperatures = {
            name: common_temperature(f"temperature_{name[-1]}", train, lacking, but=name) for name in channels
        }
    else:
        temperatures = _temperatures_of(model, channels, train)
        curves, channels = curves_of(model), list(temperatures)
        train, test = ([without_model(run, curves, channels) for run in runs] for runs in (train, test))
        degree = max(order_of(model.channels[name]) for name in channels)
        if drivers is not None:
            there = (*drivers, *temperatures.values())
            needed = BiasPredictor(model, channels).drivers
            drivers = [*drivers, *(name for name in needed if name not in there)]
    used = list(dict.fromkeys(temperatures.values()))
    others = usable_drivers(train, test, [*used, *channels], drivers, remarks)
    block_s = common_block_s([*train, *test])

    def in_blocks(runs: Sequence[Run], length_s: float, remarks: list[str]) -> list[RunBlocks]:
        return usable_blocks(runs, channels, used, others, length_s, remarks)

    unused: list[str] = []
    blocks = in_blocks(train, block_s, unused)
    check_training(blocks, unused, block_s)
    remarks += unused
    tested, shown = in_blocks(test, block_s, remarks), survey(blocks, used[0], degree)
    if not shown.thermal:
        degree = 0
        remarks.append(
            f"the temperature moves by {shown.span_degc:.1f} °C only ({LEAST_SPAN_DEGC:.0f} °C are needed):"
            " no curve over temperature is fitted, and no effect of temperature can be found"
        )
    elif model is not None:  # else no curve is fitted, and that of the model stays as it is
        check_range(model, temperatures, blocks)
    if not tested:
        remarks.append("no run can be used as a test: there is no independent proof")
    if len(blocks) < 2:
        remarks.append(
            "one training run: what depends on time and what depends on temperature may look alike"
        )
    shorter = in_blocks(train, search_block_s(blocks), [])
    own: Own = "run" if offsets else ""
    return Recorded(train, blocks, temperatures, degree, tested, shorter, own, model)


def _temperatures_of(model: BiasModel, channels: Sequence[str], runs: Sequence[Run]) -> dict[str, str]:
    """Return the temperature of each channel that the model has; raises BAD_CONFIG when it has none."""
    found = {name: temperature_of(name, model, runs) for name in channels if name in model.channels}
    if not found:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"the model has {', '.join(model.channels)}; the data has {', '.join(channels)}",
            "give the model of this unit, or --declared",
        )
    return found


def _divided(
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


def _on_poses(data: Recorded, found: Sequence[Search]) -> list[str]:
    """Return what several poses hide of gyros."""
    channel = found[0].channel
    if not channel.name.startswith("gyro") or not any(run.pose.any() for run in data.blocks):
        return []
    what = "what is named g_sensitivity holds the vertical earth rate as well, up to 15.04 °/h per g"
    if channel.declared.own == "pose":
        what = "a sensitivity of the gyros to g cannot be distinguished from the earth rate"
    return [f"several poses: {what}"]
