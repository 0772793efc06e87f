"""The whole diagnosis: runs in, verdicts out; and the engine that live search and plans use as well.

That searches the axes of a sensor over each base: what effects are searched beside, the declared curve or the
present model, as it is or fitted anew, with or without a constant in each pose.  The base counts that is
likeliest with what was found beside it.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from imumon.clock.channel import CLOCK
from imumon.effects.base import LEAST_SPAN_DEGC
from imumon.effects.library import effects_for
from imumon.errors import bad_config
from imumon.geodesy import EARTH_RATE
from imumon.lab.calibration.gravity import Length
from imumon.lab.diagnosis import prepare
from imumon.lab.diagnosis.blocks import LEAST_PARTS, RunBlocks, at_poses, common_block_s, survey, white_floor
from imumon.lab.diagnosis.candidates import Channel, Own, Pool, least_squares
from imumon.lab.diagnosis.runs import SENSORS, Run, channels_of
from imumon.lab.diagnosis.search import PROVEN, STAGES, Progress, Search, search
from imumon.lab.diagnosis.verdict import ChannelVerdict, decide
from imumon.models.curves.polynomial import CUBIC
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

HIGHEST_DEGREE = 8
SHORTER, LEAST_SEARCH_BLOCKS = (1, 2, 3), 200
"""Runs of fewer blocks are searched in halves or thirds of them: of few the one with a jump in it decides."""
ON_POSES = (
    "several poses: what is named g_sensitivity holds the vertical earth rate as well, up to 15.04 °/h per g",
    "several poses: a sensitivity of the gyros to g cannot be distinguished from the earth rate",
)
EARTH_SPREAD = 2.1 * EARTH_RATE
"""rad/s: most that the constants of a gyro in two poses differ by the earth rate, and by 5 % of its scale."""


@dataclass(frozen=True, slots=True, eq=False)
class Recorded:
    """What is diagnosed: blocks of training and test, and what is declared of them.

    `temperatures` has that of each channel, `degree` is that of the declared polynomial, and `own` is
    whether each run, or each pose of each run, has a constant of its own.  With a `model` that is known, its
    curve is off the runs already.  The search is in `shorter` blocks where there are some.
    """

    blocks: Sequence[RunBlocks]
    temperatures: Mapping[str, str]
    degree: int
    test: Sequence[RunBlocks] = ()
    shorter: Sequence[RunBlocks] = ()
    own: Own = ""
    model: BiasModel | None = None


@dataclass(slots=True)
class Diagnosis:
    """Verdicts on all channels, and caveats of the data.

    `model` is the present one, or None.  `held_out`: whether the test is part of the one run that there is.
    `length` is what follows from |f| = g in several poses, `given` the options of the command that made it,
    all but the test and the folder.
    """

    declared: str
    block_s: float
    verdicts: list[ChannelVerdict]
    train: Sequence[RunBlocks]
    test: Sequence[RunBlocks]
    caveats: list[str] = field(default_factory=list)
    model: BiasModel | None = None
    held_out: bool = False
    length: Length | None = None
    given: str = "--train SESSION"


def parse_declared(text: str) -> tuple[int, Own]:
    """Return degree and whose the constants are, from ``polynomial 3`` or ``polynomial 3 + offset``.

    Raises BAD_CONFIG for anything else.
    """
    match = re.fullmatch(r"\s*polynomial\s+(\d+)(\s*\+\s*offset)?\s*", text)
    if match is None or int(match[1]) > HIGHEST_DEGREE:
        raise bad_config(
            f"--declared {text!r} is not understood",
            f"use 'polynomial N', N from 0 to {HIGHEST_DEGREE}; '+ offset' for a constant of each run",
        )
    return int(match[1]), "run" if match[2] else ""


def diagnose(
    train: Sequence[Run],
    test: Sequence[Run],
    declared: str = CUBIC,
    progress: Progress = None,
    sensors: Sequence[str] = SENSORS,
    model: BiasModel | None = None,
    drivers: Sequence[str] | None = None,
) -> Diagnosis:
    """Find what the declared model leaves over in the training runs, name it, and prove it on the test runs.

    `sensors` are those to be diagnosed: gyro, accel, mag, or any recorded column; what is diagnosed drives
    nothing.  With a `model` that is known, the search begins with that, as it is and fitted anew, and
    `declared` does not count.  `drivers` are what may drive an effect beside temperature, time and specific
    force; None: all that was recorded and varies.

    Raises BAD_DATA when the data cannot show anything, and why; BAD_CONFIG for a wrong declared model,
    or a known one that holds at no temperature of the training.
    """
    remarks = [*dict.fromkeys(text for run in (*train, *test) for text in run.warnings)]
    data = _prepared(train, test, declared, sensors, model, drivers, remarks)
    verdicts: list[ChannelVerdict] = []
    for sensor in sensors:
        if group := channels_of([sensor], data.temperatures):
            found = likeliest(search_sensor(data, group, effects_for(group[0]), progress=progress))
            verdicts += map(decide, found, scored_channels(data, found))
            if group[0].startswith("gyro") and any(run.pose.any() for run in data.blocks):
                remarks.append(ON_POSES[found[0].channel.own == "pose"])
    length = _length(data, remarks)
    return Diagnosis(
        declared=declared,
        block_s=data.blocks[0].block_s,
        verdicts=verdicts,
        train=data.blocks,
        test=data.test,
        caveats=remarks,
        model=model,
        held_out=any(one.run.woven for one in data.test),
        length=length,
    )


def _prepared(
    train: Sequence[Run],
    test: Sequence[Run],
    declared: str,
    sensors: Sequence[str],
    model: BiasModel | None,
    drivers: Sequence[str] | None,
    remarks: list[str],
) -> Recorded:
    """Return what is searched; on what is not, and on limits, it adds to the remarks."""
    degree, own = parse_declared(declared)
    names = prepare.usable_channels(train, test, sensors, remarks)
    train, test = prepare.train_and_test(train, test, names, remarks)
    if model is not None:
        names = prepare.channels_with_model(names, model)
    temperatures = {name: prepare.temperature_of(name, model, train) for name in names}
    used = [*dict.fromkeys(temperatures.values())]
    if model is not None:
        train, test = ([prepare.without_curves(one, model, names) for one in runs] for runs in (train, test))
        degree = max(prepare.order_of(model.channels[name]) for name in names)
        if drivers is not None:
            needed = dict.fromkeys([*drivers, *BiasPredictor(model, names).drivers])
            drivers = [name for name in needed if name in drivers or name not in used]
    others = prepare.usable_drivers(train, test, [*used, *names], drivers, remarks)
    made = partial(prepare.usable_blocks, channels=names, temperatures=used, drivers=others)
    block_s = common_block_s([*train, *test])
    blocks = made(train, block_s=block_s, remarks=remarks, training=True)
    tested = made(test, block_s=block_s, remarks=remarks)
    shown = survey(blocks, used[0], degree)
    if not shown.thermal:
        degree = 0
        remarks.append(
            f"the temperature moves by {shown.span_degc:.1f} °C only ({LEAST_SPAN_DEGC:.0f} °C are needed):"
            " no curve over temperature is fitted, and no effect of temperature can be found"
        )
    elif model is not None:  # else no curve is fitted, and that of the model stays as it is
        prepare.check_range(model, temperatures, blocks)
    if not tested:
        remarks.append("no run can be used as a test: there is no independent proof")
    if len(blocks) < 2:
        remarks += ["one training run: what depends on time and what depends on temperature may look alike"]
    shorter = made(train, block_s=search_block_s(blocks), remarks=[])
    return Recorded(blocks, temperatures, degree, tested, shorter, own, model)


def _length(data: Recorded, remarks: list[str]) -> Length | None:
    """Return what |f| = g determines of the accelerometers in several poses, and add that in words."""
    forces = [force for run in data.blocks if (force := run.force) is not None]
    if len(channels_of(["accel"], data.temperatures)) < 3 or len(forces) < len(data.blocks):
        return None
    channel = _channels(data, ["accel_x"], "pose", data.blocks)[0]
    found = Length.from_poses(np.concatenate(forces), channel.base[:, 1 : data.degree + 1])
    if found is None:
        return None
    poses, length = found
    remarks.append(length.described(poses))
    return length


# The engine


def search_sensor(
    data: Recorded,
    axes: Sequence[str],
    names: Sequence[str],
    stages: int = STAGES,
    progress: Progress = None,
) -> list[list[Search]]:
    """Return the search in the axes of a sensor beside each base that is possible.

    In each pose, and each day, other sensors than gyros have another part of gravity, field or weather, which
    is not known: they have a constant in each.  So may gyros have, by the earth rate.
    """
    owns: list[Own] = [data.own] if axes[0].startswith(("gyro", CLOCK)) else []
    blocks = data.shorter or data.blocks
    turned = any(run.pose.max() > run.pose.min() for run in blocks)
    if not owns or (axes[0].startswith("gyro") and turned):
        owns.append("pose")
    found = []
    for own in owns:
        channels = _channels(data, axes, own, blocks)
        shown = survey(channels[0].pool.runs, channels[0].pool.temperature, data.degree)
        found.append(search(channels, shown, names, stages, progress))
        if any(channel.refitted for channel in channels):
            given = [channel.as_given() for channel in channels]
            found.append(search(given, shown, names, stages, progress))
    return found


def scored_channels(data: Recorded, found: Sequence[Search]) -> list[Channel]:
    """Return the axes that were searched, over the base of the search, in the blocks that are scored."""
    searched = [one.channel for one in found]
    scored = _channels(data, [channel.name for channel in searched], searched[0].own, data.blocks)
    both = zip(scored, searched, strict=True)
    return [replace(channel, degree=like.degree, kept=like.kept) for channel, like in both]


def search_block_s(blocks: Sequence[RunBlocks]) -> float:
    """Return the length of the blocks to search in: of three slots and more, which show the white floor."""
    longest = max(map(len, blocks))
    shorter = [part for part in SHORTER if blocks[0].slots >= LEAST_PARTS * part]
    part = next((part for part in shorter if part * longest >= LEAST_SEARCH_BLOCKS), shorter[-1])
    return blocks[0].block_s / part


def _channels(data: Recorded, group: Sequence[str], own: Own, blocks: Sequence[RunBlocks]) -> list[Channel]:
    """Return the axes of a sensor over one base, in these blocks."""
    test = data.test
    if own == "pose":
        blocks, test = ([at_poses(run) for run in runs] for runs in (blocks, test))
    pools = {name: Pool(blocks, name) for name in dict.fromkeys(data.temperatures[axis] for axis in group)}
    found = []
    for name in group:
        pool, floor = pools[data.temperatures[name]], white_floor(name, blocks)
        effects = None
        if data.model is not None:  # what is a polynomial is part of the curve
            every = data.model.channels[name].effects
            effects = tuple(effect for effect in every if effect.polynomial() is None)
        wrong = prepare.faults([one.run for one in blocks], name, floor.sd)
        found.append(Channel(name, floor, data.degree, own, pool, test, wrong, effects))
    return found


def likeliest(searched: Sequence[list[Search]], *, live: bool = False) -> list[Search]:
    """Return the search over the base that is likeliest with what was found beside it.

    A present model is fitted anew only where that is proven; live, where it is likelier, for nothing is
    written.  Constants in each pose are for the earth rate, and are preferred by `PROVEN`: what they explain
    as well is no effect.  Larger ones are refused.  Live their number has no price: one session has hardly
    more poses than a sensitivity to g has coefficients.
    """
    several = len({found[0].channel.own for found in searched}) > 1

    def order(axes: list[Search]) -> float:
        criterion = sum(found.criterion() for found in axes)
        if axes[0].channel.refitted and not live:
            criterion -= PROVEN
        if axes[0].channel.own != "pose" or not several:
            return criterion
        constants = []
        for channel, model in ((found.channel, found.model) for found in axes):
            coefficients = least_squares(channel.design(model), channel.values)
            constants.append(coefficients[channel.degree + 1 : channel.base.shape[1]])
        if max(np.ptp(np.append(values, 0.0)) for values in constants) > EARTH_SPREAD:
            return -np.inf
        price = math.log(len(axes[0].channel.values)) * sum(map(len, constants))
        return criterion + PROVEN + (price if live else 0.0)

    return max(searched, key=order)
