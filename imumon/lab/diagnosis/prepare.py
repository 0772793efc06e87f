"""What of the recordings is searched: channels, drivers, runs of training and test, blocks without faults;
and these less what a present model expects of them.  On what is left out functions add to `remarks`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.ndimage import binary_opening

from imumon.blocks import BoolArray, FloatArray, SampleBlock
from imumon.clock.channel import CLOCK
from imumon.columns import TEMPERATURES
from imumon.effects.base import ACCEL as ACCEL_DRIVER
from imumon.effects.base import TEMPERATURE, Effect
from imumon.effects.vibration import SECOND_NS
from imumon.errors import bad_config, bad_data
from imumon.filters.rounding import mean_error
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

from .blocks import LEAST_BLOCKS, RunInBlocks, RunsInBlocks, common_block_s, make_blocks
from .runs import CHANNELS, MOSTLY, SENSORS, SHORTEST_RUN_S, Columns, Names, Run, Runs, channels_of, unit_of

Remarks = list[str]  # what is left out and why, and what limits the result: functions add to it
# Alternating stretches of a single run for training and test (assumed); of two halves one may lack an end of
# the temperatures, of single blocks both have the same flicker.
STRETCHES = 12
CUBIC_DEGREE = 3  # as what is assumed without a model: other curves keep their shape, and have a cubic added


def usable_channels(train: Runs, test: Runs, sensors: Names, remarks: Remarks) -> list[str]:
    """Return the channels that vary and that every training run has in 60 % of its slots (assumed).

    Blocks are of slots with all of them.  The clock of the device beside others only where all runs have it.

    Raises BAD_CONFIG for a sensor that is not known and no column, BAD_DATA when there is no channel.
    """
    usable = []
    columns = dict.fromkeys(name for run in train for name in run.variance)
    if unknown := [name for name in sensors if name not in SENSORS and not channels_of([name], columns)]:
        raise bad_config(
            f"--channels: {', '.join(map(repr, unknown))} is not in the training data",
            f"there are {', '.join(columns)}",
        )
    for name in channels_of(sensors, columns):
        if without := [run.name for run in train if _share_with(run, name) <= 0.6]:
            remarks.append(f"{name} is left out: {', '.join(without)} hardly has it")
            continue
        ends = [(np.nanmin(run.mean[name]), np.nanmax(run.mean[name])) for run in train]
        # A change by less is rounding in the computation of its means.
        if all(high - low <= 1e-12 * max(abs(low), abs(high)) for low, high in ends):
            remarks.append(
                f"{name} is left out: it has one value throughout,"
                f" {np.nanmean(train[0].mean[name]):g} {unit_of(name)}"
            )
        elif name != CLOCK or len(sensors) == 1 or all(CLOCK in run.mean for run in test):
            usable.append(name)
    if not usable:
        raise bad_data(
            f"no channel of {', '.join(sensors)} has data in every training run",
            "give sessions that have them, or a map that names their columns",
        )
    return usable


def _share_with(run: Run, name: str) -> float:
    """Return the share of its slots with samples in which a run has a column."""
    return float(np.isfinite(run.mean[name][run.there]).mean()) if name in run.mean else 0.0


def _has(run: Run, name: str) -> bool:
    """Return whether a run has more than one value of a column: of fewer there is no course."""
    return bool(np.isfinite(run.mean.get(name, np.nan)).sum() > 1)


def usable_drivers(
    train: Runs,
    test: Runs,
    beside: Names,
    wanted: Names | None,
    present: Sequence[Effect],
    remarks: Remarks,
) -> list[str]:
    """Return the drivers that vary in training and are in every run, of those wanted (None: of all but
    those in `beside`), and those of effects of the present model, which may be constant.

    Raises BAD_CONFIG when one that is wanted is not there, BAD_DATA when a run hardly has one of the model.
    """
    columns = dict.fromkeys(name for run in train for name in run.mean)
    possible = [name for name in columns if name not in (*CHANNELS, *beside, TEMPERATURE)]
    if wanted is None and TEMPERATURE in columns and TEMPERATURE not in beside:
        remarks.append(
            f"no effect of the column {TEMPERATURE} is looked for: in a model that name means each channel's"
            " own thermometer; a map may give another"
        )
    if unknown := [name for name in wanted or () if name not in possible]:
        raise bad_config(
            f"--drivers: {', '.join(unknown)} is not in the training data, or drives nothing",
            f"there are {', '.join(possible) or 'none'}; a map names others with other: {{NAME: ...}}",
        )
    needed = [name for effect in present for name in effect.inputs if name != ACCEL_DRIVER]
    usable, every = [], [*train, *test]
    block_s = common_block_s(every)
    for name in dict.fromkeys([*(possible if wanted is None else wanted), *needed]):
        # A driver may be slow: a value in every other block is enough.
        runs = [run.name for run in every if _share_with(run, name) < 0.5 * run.slot_s / block_s]
        hardly = f"{name} is hardly recorded in {', '.join(runs)}"
        if runs and name in needed:
            raise bad_data(f"{hardly}, and the model has an effect of it", "give no model, but --declared")
        values = np.concatenate([run.mean[name] for run in train if name in run.mean])
        if name not in needed and not np.nanmax(values) > np.nanmin(values):
            continue
        if runs:
            remarks.append(f"{hardly}: no effect of it is looked for")
        else:
            usable.append(name)
    return usable


def train_and_test(train: Runs, test: Runs, channels: Names, remarks: Remarks) -> tuple[list[Run], list[Run]]:
    """Return the runs of training and test without what stands still.

    A test that the training has, by its bytes, is left out.  One that continues another run, by the device's
    clock, has its time and temperatures; each run of the training is taken as from power-on.  Of an only run
    every other stretch is held out as a test, where enough blocks are left.
    """
    train, test = ([without_standstill(run, channels, remarks) for run in runs] for runs in (train, test))
    tests = list[Run]()
    for run in test:
        if run.origin and any((run.origin, run.start_ns) == (same.origin, same.start_ns) for same in train):
            remarks.append(f"{run.name}: not used as a test, the training has the same recording")
            continue
        # The last slot of a run may end a second late; what begins over a minute after has its own power-on.
        earlier = (other for other in (*tests, *train) if -1.0 <= _pause_s(other, run) <= 60.0)
        if before := next(earlier, None):
            remarks.append(
                f"{run.name} goes on where {before.name} ended, by the device's clock: time since power-on,"
                " lag and loop go on as well"
            )
        tests.append(_continued(before, run) if before else run)
    if tests or len(train) > 1:
        return train, tests
    half, held_out = _divided(train[0], channels)
    if len(make_blocks(half, channels, TEMPERATURES, block_s=common_block_s(train))) < LEAST_BLOCKS:
        return train, tests
    remarks.append(
        f"no test data: every other {train[0].duration_s / STRETCHES / 60:.0f} min of the one run are held"
        " out as a test, which is weaker than another power-on: slower noise is in both"
    )
    return [half], [held_out]


def _divided(run: Run, channels: Names) -> tuple[Run, Run]:
    """Return a run with every other stretch of the channels, and one with the others, the test; both have the
    whole course of everything else, and of time."""
    n = len(run.time_s)
    tested = (np.arange(n) * STRETCHES // n) % 2 == 1

    def only(kept: BoolArray) -> Columns:
        return run.mean | {name: np.where(kept, run.mean[name], np.nan) for name in channels}

    other = replace(run, mean=only(tested), name=f"{run.name}, held out", begun_in=run.name, woven=True)
    return replace(run, mean=only(~tested)), other


def _pause_s(before: Run, after: Run) -> float:
    """Return the time between two runs by the device's clock, s; infinite where it is not known."""
    if before.start_ns is None or after.start_ns is None or before.slot_s != after.slot_s:
        return np.inf
    return (after.start_ns - before.start_ns) / SECOND_NS - before.duration_s


def _continued(before: Run, after: Run) -> Run:
    """Return a run with the time and the drivers of the one that it continues; only its own samples count."""
    first = len(before.time_s) + max(0, round(_pause_s(before, after) / after.slot_s))

    def behind(columns: Mapping[str, FloatArray], missing: float = np.nan) -> Columns:
        return {name: np.append(np.full(first, missing), values) for name, values in columns.items()}

    mean = behind(after.mean)
    for name in mean.keys() & (before.mean.keys() - {*CHANNELS}):
        mean[name][: len(before.time_s)] = before.mean[name]
    return replace(
        after,
        time_s=(np.arange(first + len(after.time_s), dtype=np.float64) + 0.5) * after.slot_s,
        count=behind(after.count, 0.0),
        mean=mean,
        variance=behind(after.variance),
        rest=np.append(np.zeros(first), after.rest),
        start_ns=before.start_ns,
        begun_in=before.begun_in or before.name,
    )


def without_standstill(run: Run, channels: Names, remarks: Remarks) -> Run:
    """Return a run without the slots in which a channel has one value for as long as a block."""
    # Noise never does that, but a stuck sensor, and one at its limit.  One whose digits are coarser than its
    # noise does so most of the time, and keeps its values.
    mean = dict(run.mean)
    for name in (name for name in channels if name in mean):
        same = (np.diff(mean[name], prepend=np.nan) == 0.0) & ~(run.variance[name] > 0.0)
        # Of the slots that repeat the one before, the stretches as long as a block.
        still = binary_opening(same, np.ones(round(common_block_s([run]) / run.slot_s)))
        if not still.any():
            continue
        still |= np.append(still[1:], False)  # the slot before the first that repeats has the value as well
        share = still.sum() / np.isfinite(mean[name]).sum()
        samples = run.samples.get(name)
        # Where the digits are not known, a sensor is hardly stuck for most of the time.
        coarse = samples.step > samples.scatter if samples else share > 0.5
        if coarse:
            remarks.append(f"{run.name}: {name} does not change in {share:.0%} of its time: too few digits")
            continue
        still_s = still.sum() * run.slot_s
        remarks.append(f"{run.name}: {name} is stuck or saturated for {still_s:.0f} s; they are left out")
        mean[name] = np.where(still, np.nan, mean[name])
    return replace(run, mean=mean)


def faults(runs: Runs, channel: str, floor: float) -> dict[str, float]:
    """Return the worst fault of each kind in the samples of a channel, and the rms that it makes of a smooth
    bias: digits too coarse for their noise (`floor`, that of a mean of a block) to average what lies between
    them; and a value that is too frequent, which makes inf, as no fit would be the bias."""
    quantized, frequent = dict[str, float](), dict[str, float]()
    for samples in (run.samples[channel] for run in runs if channel in run.samples):
        error = mean_error(samples.step, samples.ratio) if samples.step > 0.0 else 0.0
        if not error < 0.5 * floor:  # true of NaN, too
            step = f"{samples.step:.3g} {unit_of(channel)}, about {1 / samples.ratio:.2g} times the noise"
            quantized[f"quantized: steps of {step}"] = error
        if samples.atom_share > 0.0:
            # + 0.0: of a zero without a minus.
            share = f"{samples.atom_share:.1%} of the samples are {samples.atom + 0.0:.4g} {unit_of(channel)}"
            frequent[f"frequent value, as of a dead-band, saturation or dropouts: {share}"] = np.inf
    return dict(max(kind.items(), key=lambda item: item[1]) for kind in (quantized, frequent) if kind)


def usable_blocks(
    runs: Runs,
    channels: Names,
    temperatures: Names,
    drivers: Names,
    block_s: float,
    remarks: Remarks,
    model: BiasModel | None = None,
    training: bool = False,
) -> list[RunInBlocks]:
    """Return the runs at rest as blocks, less the curves of a model.

    Raises BAD_DATA, and why, where they are too few for training.
    """
    usable = list[RunInBlocks]()
    earlier = len(remarks)
    for run in runs:
        if missing := [name for name in (*channels, *temperatures) if not _has(run, name)]:
            why = f"it lacks {', '.join(missing)}"
        elif run.rest_share < MOSTLY:
            why = f"the unit moves: at rest for {run.rest_share:.0%} of its {run.duration_s / 60:.0f} min"
        else:
            left = without_curves(run, model, channels) if model else run
            in_blocks = make_blocks(left, channels, temperatures, drivers, block_s)
            too_few = len(in_blocks) * block_s < SHORTEST_RUN_S
            why = f"too few means of {block_s:.0f} s at rest: {len(in_blocks)}" if too_few else ""
        if why:
            remarks.append(f"{run.name}: not used, {why}")
            continue
        usable.append(in_blocks)
        recorded = run.count[channels[0]] > 0
        begun = np.argmax(recorded)  # what goes on from another run begins late
        share = (recorded & run.at_rest)[begun:].mean()
        if share < 0.8:
            remarks.append(f"{run.name}: used in {share:.0%} of its time; gaps and motion are left out")
    total = sum(map(len, usable))
    if training and total < LEAST_BLOCKS:
        short = (
            f"too short: the training data has {total} means of {block_s:.0f} s at rest; {LEAST_BLOCKS} are"
            f" needed, {LEAST_BLOCKS * block_s / 60:.0f} min"
        )
        raise bad_data(
            "; ".join([short, *remarks[earlier:]]),
            "record the unit at rest for an hour or more while its temperature changes;"
            " if it was at rest and is not detected to be, add --at-rest",
        )
    return usable


def channels_with_model(channels: Names, model: BiasModel, remarks: Remarks) -> list[str]:
    """Return the channels that a model has; raises BAD_CONFIG where it has none of them."""
    if found := [name for name in channels if name in model.channels]:
        if others := [name for name in channels if name not in found]:
            remarks.append(f"left out, as the model does not have them: {', '.join(others)}")
        return found
    raise bad_config(
        f"the model has {', '.join(model.channels)}; the data has {', '.join(channels)}",
        "give the model of this unit, or --declared",
    )


def temperature_of(channel: str, model: BiasModel | None, runs: Runs) -> str:
    """Return the temperature that a channel's curve is over: the model's, its axis', or one of every run.

    Raises BAD_DATA without any.
    """
    # The estimate of a temperature is of the same thermometer; a channel without an axis has none of its own.
    wanted = (
        model.channels[channel].temperature_column.replace("_estimate", "")
        if model
        else f"temperature_{channel[-1]}"
    )
    for name in (wanted, *TEMPERATURES):
        if name != channel and all(_has(run, name) for run in runs):
            return name
    each = [f"{run.name} has {', '.join(t for t in TEMPERATURES if t in run.mean) or 'none'}" for run in runs]
    raise bad_data(
        f"there is no temperature that every run has, and a bias model is over one: {'; '.join(each)}",
        "record with the temperature switched on, or name its column in the map",
    )


def check_range(model: BiasModel, temperatures: Mapping[str, str], runs: RunsInBlocks) -> None:
    """Raise BAD_CONFIG for a model whose curves hold at no temperature of the runs, naming both ranges."""
    for name, temperature in temperatures.items():
        values = np.concatenate([run.temperature[temperature] for run in runs])
        low, high = model.channels[name].temperature_range_degc
        if max(low, values.min()) >= min(high, values.max()):
            raise bad_config(
                f"the bias model of {name} holds from {low:.2f} to {high:.2f} °C, the training data has"
                f" {values.min():.2f} to {values.max():.2f} °C: they do not overlap",
                "give a model that was calibrated at these temperatures, or none: leave --model out",
            )


def degree_of(model: BiasModel, channels: Names) -> int:
    """Return the degree of the polynomial by which curves are fitted anew: their largest, or a cubic's."""
    curves = (model.channels[name].curve for name in channels)
    return max(len(c.coefficients) - 1 if isinstance(c, PolynomialCurve) else CUBIC_DEGREE for c in curves)


def without_curves(run: Run, model: BiasModel, channels: Names) -> Run:
    """Return a run less the curves of a model, of which polynomial effects are part; others are left in."""
    curves = {
        name: one.model_copy(update={"effects": [e for e in one.effects if e.polynomial() is not None]})
        for name, one in model.channels.items()
    }
    return without_model(run, model.model_copy(update={"channels": curves}), channels)


def without_model(run: Run, model: BiasModel, channels: Names) -> Run:
    """Return a run with what a model expects taken from its channels, effects integrated from power-on."""
    temperatures = [temperature_of(name, model, [run]) for name in channels]
    expected = BiasPredictor(model, channels).process(
        np.round(run.time_s * SECOND_NS).astype(np.int64),
        np.zeros(len(run.time_s), np.int64),
        np.column_stack([run.mean[name] for name in temperatures]),
        SampleBlock(run.mean).accel,
        run.mean,
    )
    changed = {name: run.mean[name] - expected.bias[:, at] for at, name in enumerate(channels)}
    return replace(run, mean=run.mean | changed)


def residual_blocks(run: Run, model: BiasModel, channels: Names) -> RunInBlocks:
    """Return block means of what a model leaves of the channels, its effects integrated from power-on."""
    temperatures = dict.fromkeys(temperature_of(name, model, [run]) for name in channels)
    left = without_model(run, model, channels)
    return make_blocks(left, channels, [*temperatures], block_s=common_block_s([run]))


def within_range(model: BiasModel, run: Run, channels: Names, until_s: float | None = None) -> Run:
    """Return a run at rest only where its temperatures are inside the range that a model was fitted on, or
    inside those that the run itself had until `until_s`."""
    # Outside that range the curve continues as a straight line, and what is left there is no effect.
    inside = np.ones(len(run.time_s), bool)
    for name in channels:
        values = run.mean[temperature_of(name, model, [run])]
        known = np.isfinite(values)
        values = np.interp(run.time_s, run.time_s[known], values[known])
        if until_s is None:
            inside &= model.channels[name].inside(values)
        else:
            early = values[run.time_s < until_s]
            inside &= (values >= early.min()) & (values <= early.max())
    return replace(run, rest=np.where(inside, run.rest, 0.0))
