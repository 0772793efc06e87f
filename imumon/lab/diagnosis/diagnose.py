"""The whole diagnosis, runs in and verdicts out; and the engine that live search and plans use as well.

The engine searches the axes of a sensor over each base X that is possible, and takes the likeliest: the
declared curve, or the present model as it is or fitted anew, with or without a constant in each pose.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from imumon.clock.channel import CLOCK
from imumon.effects.base import LEAST_SPAN_DEGC
from imumon.effects.library import effects_for
from imumon.errors import bad_config
from imumon.geodesy import EARTH_RATE
from imumon.models.curves.polynomial import CUBIC
from imumon.models.model import BiasModel

from ..calibration.cells import ONE_WAY, one_way
from ..calibration.gravity import TriadErrors
from . import prepare
from .blocks import LEAST_PIECES, RunsInBlocks, at_poses, common_block_s, survey, white_floor
from .candidates import Channel, OffsetPer, Training, least_squares
from .runs import SENSORS, Names, Runs, channels_of
from .search import PROVEN_GAIN, STAGES, AxisSearch, Progress, search
from .verdict import ChannelVerdict, decide

HIGHEST_DEGREE = 8  # assumed
# The search divides blocks by the first of these that gives the longest run so many blocks (both assumed):
# among few blocks the one with a jump in it decides.
BLOCK_DIVISORS = (1, 2, 3)
LEAST_SEARCH_BLOCKS = 200


class Prepared(NamedTuple):
    """What is diagnosed: training and test in blocks, and what is declared of them."""

    train: RunsInBlocks
    temperature_names: Mapping[str, str]  # the temperature of each channel
    degree: int  # of the declared polynomial
    test: RunsInBlocks = ()
    search_train: RunsInBlocks = ()  # in the shorter blocks of the search; empty: in those of `train`
    offset_per: OffsetPer = "all"
    model: BiasModel | None = None  # the present model, whose curve is off the blocks already


@dataclass
class Diagnosis:
    """Verdicts on all channels, and caveats of the data."""

    declared: str
    verdicts: list[ChannelVerdict]
    train: RunsInBlocks
    test: RunsInBlocks
    caveats: list[str] = field(default_factory=list)
    model: BiasModel | None = None  # the present one
    length: TriadErrors | None = None  # what follows from |f| = g in several poses
    options: str = "--train SESSION"  # those of the command that made it, but for the test and the folder

    @property
    def held_out(self) -> bool:
        """Whether the test is part of the one run that there is."""
        return any(run.in_slots.woven for run in self.test)


def parse_declared(text: str) -> tuple[int, OffsetPer]:
    """Return the degree, and what has a constant, of ``polynomial 3`` or ``polynomial 3 + offset``.

    Raises BAD_CONFIG for anything else.
    """
    match = re.fullmatch(r"\s*polynomial\s+(\d+)(\s*\+\s*offset)?\s*", text)
    if not match or int(match[1]) > HIGHEST_DEGREE:
        raise bad_config(
            f"--declared {text!r} is not understood",
            f"use 'polynomial N', N from 0 to {HIGHEST_DEGREE}; '+ offset' for a constant of each run",
        )
    return int(match[1]), "run" if match[2] else "all"


def diagnose(
    train: Runs,
    test: Runs,
    declared: str = CUBIC,
    progress: Progress = lambda _: None,
    sensors: Names = SENSORS,
    model: BiasModel | None = None,
    drivers: Names | None = None,
) -> Diagnosis:
    """Find what the declared model leaves over in the training runs, name it, and prove it on the test runs.

    `sensors` are those to be diagnosed: gyro, accel, mag, or any recorded column; what is diagnosed drives
    nothing.  With a present `model`, the search begins with that, as it is and fitted anew; of `declared`
    only `+ offset` counts.  `drivers` are what may drive an effect beside temperature, time and specific
    force; None: all that was recorded and varies.

    Raises BAD_DATA when the data cannot show anything, and why; BAD_CONFIG for a wrong declared model,
    or a present one that holds at no temperature of the training.
    """
    remarks = [*dict.fromkeys(text for run in (*train, *test) for text in run.warnings)]
    data = _prepared(train, test, declared, sensors, model, drivers, remarks)
    verdicts: list[ChannelVerdict] = []
    for sensor in sensors:
        if names := channels_of([sensor], data.temperature_names):
            axes = likeliest(search_sensor(data, names, effects_for(names[0]), progress=progress))
            # The search may have been in shorter blocks than those that are scored; the base is the same.
            per = axes[0].channel.offset_per
            for axis, channel in zip(axes, _channels(data, names, per, data.train), strict=True):
                base = axis.channel
                scored = replace(channel, degree=base.degree, fixed_effects=base.fixed_effects)
                verdicts.append(decide(axis, scored))
            if names[0].startswith("gyro") and any(run.pose.any() for run in data.train):
                remarks.append(
                    "several poses: a sensitivity of the gyros to g cannot be distinguished from the"
                    " earth rate"
                    if per == "pose"
                    else "several poses: what is named g_sensitivity holds the vertical earth rate as well,"
                    " up to 15.04 °/h per g"
                )
    return Diagnosis(declared, verdicts, data.train, data.test, remarks, model, _length(data, remarks))


def _prepared(
    train: Runs,
    test: Runs,
    declared: str,
    sensors: Names,
    model: BiasModel | None,
    drivers: Names | None,
    remarks: prepare.Remarks,
) -> Prepared:
    """Return what is searched; on what is not, and on limits, it adds to the remarks."""
    degree, offset_per = parse_declared(declared)
    names = prepare.usable_channels(train, test, sensors, remarks)
    train, test = prepare.train_and_test(train, test, names, remarks)
    if model:
        differences = [model.of_another(run.origin.serial) for run in (*train, *test) if run.origin]
        remarks += filter(None, dict.fromkeys(differences))
        names = prepare.channels_with_model(names, model, remarks)
        degree = prepare.degree_of(model, names)
    temperature_names = {name: prepare.temperature_of(name, model, train) for name in names}
    temperatures = [*dict.fromkeys(temperature_names.values())]
    effects = [effect for name in names for effect in model.channels[name].effects] if model else []
    others = prepare.usable_drivers(train, test, [*temperatures, *names], drivers, effects, remarks)
    columns = names, temperatures, others
    block_s = common_block_s([*train, *test])
    training = prepare.usable_blocks(train, *columns, block_s, remarks, model, training=True)
    tested = prepare.usable_blocks(test, *columns, block_s, remarks, model)
    span = survey(training, temperatures, degree)
    if not span.thermal:
        remarks.append(
            f"the temperature moves by {span.span_degc:.1f} °C only ({LEAST_SPAN_DEGC:.0f} °C are needed):"
            " no curve over temperature is fitted, and no effect of temperature can be found"
        )
    elif model:  # else no curve is fitted, and that of the model stays as it is
        prepare.check_range(model, temperature_names, training)
    elif all(one_way([run.temperature[name] for run in training]) for name in temperatures):
        remarks.append(ONE_WAY)
    if not tested:
        remarks.append("no run can be used as a test: there is no independent proof")
    if len(training) < 2:
        remarks += ["one training run: what depends on time and what depends on temperature may look alike"]
    # The same runs and no others: separate coefficients have the number of their run.
    search_train = [run.in_blocks_of(search_block_s(training)) for run in training]
    curve_degree = degree if span.thermal else 0
    return Prepared(training, temperature_names, curve_degree, tested, search_train, offset_per, model)


def _length(data: Prepared, remarks: prepare.Remarks) -> TriadErrors | None:
    """Return what |f| = g determines of the accelerometers in several poses, and add that in words."""
    forces = [force for run in data.train if (force := run.force) is not None]
    if len(channels_of(["accel"], data.temperature_names)) < 3 or len(forces) < len(data.train):
        return None
    warmth = _channels(data, ["accel_x"], "pose", data.train)[0].base[:, 1 : data.degree + 1]
    poses, length = TriadErrors.from_poses(np.concatenate(forces), warmth) or (0, None)
    if length:
        remarks.append(length.described(poses))
    return length


def search_sensor(
    data: Prepared, axes: Names, kinds: Names, stages: int = STAGES, progress: Progress = lambda _: None
) -> list[list[AxisSearch]]:
    """Return the search in the axes of a sensor over each base that is possible, a list of its axes each."""
    # In each pose, and each day, other sensors than gyros have another part of gravity, field or weather,
    # which is not known: they have a constant in each.  So may gyros have, by the earth rate.
    runs = data.search_train or data.train
    possible: list[OffsetPer] = ["pose"]
    if axes[0].startswith(CLOCK):
        possible = [data.offset_per]
    elif axes[0].startswith("gyro"):
        turned = any(run.pose.max() > run.pose.min() for run in runs)
        possible = [data.offset_per, *possible] if turned else [data.offset_per]
    searched = []
    for offset_per in possible:
        channels = _channels(data, axes, offset_per, runs)
        span = survey(channels[0].training.runs, [data.temperature_names[n] for n in axes], data.degree)
        searched.append(search(channels, span, kinds, stages, progress))
        if any(channel.refits_model for channel in channels):
            fixed = [channel.with_model_fixed() for channel in channels]
            searched.append(search(fixed, span, kinds, stages, progress))
    return searched


def search_block_s(runs: RunsInBlocks) -> float:
    """Return the length of the blocks to search in, s: three slots or more, which show the white floor."""
    longest = max(map(len, runs))
    slots = min(run.slots_per_block for run in runs)
    possible = [divisor for divisor in BLOCK_DIVISORS if slots >= LEAST_PIECES * divisor]
    enough = (divisor for divisor in possible if divisor * longest >= LEAST_SEARCH_BLOCKS)
    return runs[0].block_s / next(enough, possible[-1])  # the shortest where none is enough


def _channels(data: Prepared, names: Names, offset_per: OffsetPer, runs: RunsInBlocks) -> list[Channel]:
    """Return these channels over one base, trained on these runs."""
    test = data.test
    if offset_per == "pose":
        runs, test = ([at_poses(run) for run in each] for each in (runs, test))
    temperatures = {data.temperature_names[name] for name in names}
    trainings = {temperature: Training(runs, temperature) for temperature in temperatures}
    channels = []
    for name in names:
        training = trainings[data.temperature_names[name]]
        floor = white_floor(name, runs)
        faults = prepare.faults([run.in_slots for run in runs], name, floor.sd)
        # What is a polynomial is part of the curve.
        effects = (
            tuple(effect for effect in data.model.channels[name].effects if effect.polynomial() is None)
            if data.model
            else None
        )
        channels.append(Channel(name, floor, data.degree, offset_per, training, test, faults, effects))
    return channels


def likeliest(searched: Sequence[list[AxisSearch]], *, live: bool = False) -> list[AxisSearch]:
    """Return the search over the base that is likeliest with what was found beside it: S summed over axes."""
    # A present model is fitted anew only where that is proven; live, where it is likelier: what is kept has
    # to win on later data first.  Constants in each pose are for the earth rate, and are preferred by
    # `PROVEN_GAIN`: what they explain as well is no effect.  Larger ones are refused.  Live their number has
    # no price: one session has hardly more poses than a sensitivity to g has coefficients.
    # Where poses are the only base, as of all sensors but gyros, there is nothing to prefer them to.
    several = len({axes[0].channel.offset_per for axes in searched}) > 1

    def preference(every: list[AxisSearch]) -> float:
        axes = [axis for axis in every if not axis.channel.faulty] or every
        s = sum(axis.criterion(axis.model) for axis in axes)
        if not live and any(axis.channel.refits_model for axis in axes):
            s -= PROVEN_GAIN
        if not several or axes[0].channel.offset_per != "pose":
            return s
        if any(map(_exceeds_earth_rate, axes)):
            return -np.inf
        # S has the price of these constants, which is given back live.
        free = sum(len(axis.channel.offsets[0]) - 1 for axis in axes) if live else 0
        return s + (PROVEN_GAIN + axes[0].likelihood.price * free)

    return max(searched, key=preference)


def _exceeds_earth_rate(axis: AxisSearch) -> bool:
    """Return whether the constants of a gyro in two poses of a run differ by more than the earth rate."""
    channel = axis.channel
    coefficients = least_squares(channel.design(axis.model), channel.y)
    constants = np.append(0.0, coefficients[channel.offset_columns])  # less the first of all
    runs = channel.offsets[0][:, 0]  # of each constant: another run has another turn-on bias, too
    # From along an axis to against it, and 5 % for the scale of the gyro (assumed).
    return any(np.ptp(constants[runs == run]) > 2.1 * EARTH_RATE for run in np.unique(runs))
