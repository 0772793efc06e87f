"""What of the data is used, and what is named instead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from imumon.errors import ImumonError, Reason
from imumon.lab.diagnosis.blocks import common_block_s, white_floor
from imumon.lab.diagnosis.diagnose import diagnose, search_block_s
from imumon.lab.diagnosis.prepare import usable_blocks, usable_channels, usable_drivers
from imumon.lab.diagnosis.runs import MOSTLY, SENSORS, Run
from tests.lab.diagnosis.units import ramps, run, three

SECONDS = 2400
NAMES = ["gyro_x"], ["temperature"], list[str]()


def still(time: np.ndarray, temperature: np.ndarray) -> np.ndarray:  # noqa: ARG001 - as all biases
    return np.zeros_like(time)


def moving(run: Run) -> Run:
    """Return a run of a unit that moves all the time."""
    return replace(run, rest=np.zeros_like(run.rest))


def test_a_channel_with_one_value_is_left_out_and_reported() -> None:
    train, test = three(still, SECONDS)
    for one in (*train, *test):
        one.mean["gyro_y"], one.variance["gyro_y"] = np.zeros(SECONDS), np.zeros(SECONDS)
        one.count["gyro_y"] = one.count["gyro_x"]
    remark = "gyro_y is left out: it has one value throughout, 0 rad/s"
    remarks: list[str] = []
    assert usable_channels(train, test, SENSORS, remarks) == ["gyro_x"]
    assert remarks == [remark]


def test_a_channel_of_one_value_whose_means_differ_in_the_last_bit_is_left_out_and_reported() -> None:
    train, test = three(still, SECONDS)
    for one in (*train, *test):
        value = np.full(SECONDS, 0.001)
        value[::2] = np.nextafter(0.001, 1.0)
        one.mean["gyro_y"], one.variance["gyro_y"] = value, np.full(SECONDS, np.spacing(0.001) ** 2)
        one.count["gyro_y"] = one.count["gyro_x"]
    diagnosis = diagnose(train, test)
    assert [verdict.name for verdict in diagnosis.verdicts] == ["gyro_x"]
    assert "gyro_y is left out: it has one value throughout, 0.001 rad/s" in diagnosis.caveats


def test_a_channel_that_a_training_run_lacks_is_left_out_and_reported() -> None:
    train, test = three(still, SECONDS)
    both = {**train[0].mean, "gyro_z": train[0].mean["gyro_x"]}
    train[0] = replace(train[0], mean=both, variance={**train[0].variance, "gyro_z": np.ones(SECONDS)})
    remark = f"gyro_z is left out: {train[1].name} hardly has it"
    remarks: list[str] = []
    assert usable_channels(train, test, SENSORS, remarks) == ["gyro_x"]
    assert remarks == [remark]


def test_runs_that_move_or_lack_a_temperature_are_named_and_the_others_used() -> None:
    train, test = three(still, SECONDS)
    block_s = common_block_s(train)
    bare = replace(train[0], name="bare", mean={"gyro_x": train[0].mean["gyro_x"]})
    remarks: list[str] = []
    found = usable_blocks([moving(train[0]), train[1], bare], *NAMES, block_s, remarks, training=True)
    assert [one.in_slots.name for one in found] == [train[1].name]
    assert remarks == [
        f"{train[0].name}: not used, the unit moves: at rest for 0% of its {SECONDS / 60:.0f} min",
        "bare: not used, it lacks temperature",
    ]
    with pytest.raises(ImumonError, match="the unit moves"):
        usable_blocks([moving(train[0])], *NAMES, block_s, [], training=True)
    caveats = diagnose(train, [moving(test[0])]).caveats
    assert "no run can be used as a test: there is no independent proof" in caveats
    assert train[1].rest_share > MOSTLY > moving(train[1]).rest_share


def jump(time: np.ndarray, temperature: np.ndarray) -> np.ndarray:  # noqa: ARG001 - as all biases
    return np.where(time > 1500.0, 12.0, 0.0)


def test_a_jump_is_in_its_run_where_a_short_run_before_has_too_few_blocks_to_be_scored() -> None:
    short = run(7, *ramps(360, True), still)
    gaps = np.zeros(360, bool)
    gaps[:90] = np.tile(np.repeat([False, True, False, True, True], [7, 3, 7, 3, 10]), 3)
    short.mean["gyro_x"][gaps], short.count["gyro_x"][gaps] = np.nan, 0.0
    train = [short, run(1, *ramps(3000, True), still), run(2, *ramps(3000, False), jump)]
    diagnosis = diagnose(train, [run(3, *ramps(3000, True, 1.0), still)])
    assert [one.in_slots.name for one in diagnosis.train] == ["run 1", "run 2"]
    (claim,) = diagnosis.verdicts[0].claims
    assert claim.finding.name == "step"
    assert [diagnosis.train[at].in_slots.name for at in claim.parts[0].separate_runs] == ["run 2"]


@pytest.mark.parametrize("every", [25, 3])
def test_the_white_floor_of_a_log_that_lacks_a_sample_in_every_block(every: int) -> None:
    """It was zero, and a unit that lacks nothing was unexplained."""
    train, test = three(still, SECONDS)
    for one in (*train, *test):
        lost = np.arange(len(one.time_s)) % every == 7 % every
        for name in one.mean:
            one.mean[name] = np.where(lost, np.nan, one.mean[name])
            one.count[name] = np.where(lost, 0, one.count[name])
    (verdict,) = diagnose(train, test, "polynomial 1", sensors=("gyro",)).verdicts
    expected = one_floor(train) * np.sqrt(every / (every - 1.0))
    assert verdict.channel.floor.sd == pytest.approx(expected, rel=0.15)
    assert not verdict.unexplained


def one_floor(runs: list[Run]) -> float:
    """Return the standard deviation of white noise of a mean of 30 s, from single slots."""
    slots = runs[0].mean["gyro_x"]
    return float(np.nanstd(np.diff(slots)) / np.sqrt(2.0 * 30.0 / runs[0].slot_s))


@pytest.mark.long
def test_a_stuck_thermometer_of_one_axis_takes_no_curve_from_the_others() -> None:
    """No axis had a curve where the first thermometer was stuck."""
    runs = []
    for seed, up, rate in ((1, True, 1.5), (2, False, 1.5), (3, True, 1.0)):
        one = run(seed, *ramps(SECONDS, up, rate), still, ("gyro_x", "gyro_y"))
        one.mean |= {"temperature_x": np.full(SECONDS, 25.0), "temperature_y": one.mean.pop("temperature")}
        one.count |= dict.fromkeys(one.mean, one.count["gyro_x"])
        runs.append(one)
    x, y = diagnose(runs[:2], runs[2:]).verdicts
    assert x.unexplained
    assert y.row.state == "nothing missing"


def slow(one: Run, slot_s: int) -> Run:
    """Return the same run as a slower log, with every so many a sample."""
    every = slice(slot_s // 2, None, slot_s)
    mean, variance, count = (
        {name: values[every] for name, values in part.items()} for part in (one.mean, one.variance, one.count)
    )
    time_s = (np.arange(len(one.time_s[every]), dtype=np.float64) + 0.5) * slot_s
    return replace(
        one, time_s=time_s, mean=mean, variance=variance, count=count, rest=one.rest[every], slot_s=slot_s
    )


def test_the_white_floor_of_logs_of_two_rates_depends_on_no_order() -> None:
    """Blocks of the second log were as many slots as those of the first: five times as long."""
    fast, other = three(still, SECONDS)[0]
    logs = [fast, slow(other, 5)]
    floors, alone = [], []
    for runs in (logs, logs[::-1]):
        blocks = usable_blocks(runs, *NAMES, common_block_s(logs), [], training=True)
        floors.append(white_floor("gyro_x", blocks).sd)
        alone = [white_floor("gyro_x", [one]).sd for one in blocks]
        assert search_block_s(blocks) == search_block_s(blocks[::-1])
    assert floors[0] == pytest.approx(floors[1], rel=1e-9)
    assert min(alone) < floors[0] < max(alone)


def test_a_run_is_not_halved_that_rests_too_little_for_two_halves() -> None:
    """It was refused as too short."""
    one = run(4, *ramps(2520, True), still)
    rest = np.ones(2520)
    rest[np.arange(2520) % 420 < 60] = 0.0
    diagnosis = diagnose([replace(one, rest=rest)], [])
    assert not diagnosis.test
    assert sum(map(len, diagnosis.train)) > 60


@pytest.mark.parametrize("every", [2, 5])
def test_a_slow_sensor_beside_gyros_is_left_out_and_reported(every: int) -> None:
    """The log was too short: a block has samples of every channel."""
    train, test = three(still, SECONDS)
    for one in (*train, *test):
        field = np.full(SECONDS, np.nan)
        field[::every] = 20.0 + np.random.default_rng(1).standard_normal(len(field[::every]))
        one.mean["mag_x"], one.count["mag_x"] = field, np.isfinite(field).astype(float)
        one.variance["mag_x"] = np.full(SECONDS, np.nan)
    diagnosis = diagnose(train, test, sensors=("gyro", "mag"))
    assert [verdict.name for verdict in diagnosis.verdicts] == ["gyro_x"]
    assert any("mag_x is left out: run 1, run 2 hardly has it" in text for text in diagnosis.caveats)


def test_a_channel_is_used_that_is_there_whenever_a_log_with_long_gaps_is() -> None:
    train, test = three(still, 3 * SECONDS)
    for one in (*train, *test):
        lost = np.arange(len(one.time_s)) // 600 % 3 > 0
        for name in one.mean:
            one.mean[name] = np.where(lost, np.nan, one.mean[name])
            one.count[name] = np.where(lost, 0.0, one.count[name])
    assert usable_channels(train, test, SENSORS, []) == ["gyro_x"]


def test_a_thermometer_with_the_name_of_any_channels_own_drives_nothing_and_that_is_reported() -> None:
    """The thermometer of the axis was tried in its place, with the scale of this one."""
    train, test = three(still, SECONDS)
    for one in (*train, *test):
        one.mean |= {"temperature_x": one.mean["temperature"], "temperature": one.mean["temperature"][::-1]}
    beside, remarks = ["temperature_x", "gyro_x"], list[str]()
    assert usable_drivers(train, test, beside, None, [], remarks) == []
    assert [text.partition(":")[0] for text in remarks] == [
        "no effect of the column temperature is looked for"
    ]
    with pytest.raises(ImumonError, match="--drivers: temperature"):
        usable_drivers(train, test, beside, ["temperature"], [], [])


@pytest.mark.parametrize("every_s", [30, 60])
def test_a_channel_that_changes_between_blocks_only_is_diagnosed(every_s: int) -> None:
    """A white floor of 0 was divided by."""
    train, test = three(still, SECONDS)
    for seed, one in enumerate((*train, *test)):
        readings = 1e5 + np.random.default_rng(seed).standard_normal(SECONDS // every_s)
        one.mean["pressure"], one.variance["pressure"] = readings.repeat(every_s), np.zeros(SECONDS)
        one.count["pressure"] = one.count["gyro_x"]
    (verdict,) = diagnose(train, test, sensors=("pressure",)).verdicts
    assert 0.3 < verdict.channel.floor.sd < 1.0  # 1 is the noise of a reading
    assert not verdict.claims


@pytest.mark.parametrize("wrong", ["gyro_u", "acel", "", "mag"])
def test_a_channel_that_is_not_there_is_refused_with_those_that_are(wrong: str) -> None:
    """It was ignored beside others."""
    train, test = three(still, SECONDS)
    with pytest.raises(ImumonError, match=f"--channels: '{wrong}' is not in the training data") as error:
        diagnose(train, test, sensors=("gyro_x", wrong))
    assert error.value.reason is Reason.BAD_CONFIG
    assert error.value.hint == "there are gyro_x"


def test_a_test_with_one_reading_of_the_temperature_is_not_used_and_that_is_reported() -> None:
    """It ended in a KeyError."""
    train, test = three(still, SECONDS)
    test[0].mean["temperature"][1:] = np.nan
    diagnosis = diagnose(train, test)
    assert not diagnosis.test
    assert f"{test[0].name}: not used, it lacks temperature" in diagnosis.caveats


def test_a_driver_in_every_slot_of_a_slow_log_is_used() -> None:
    """With slots of more than a minute every driver was hardly recorded."""

    def slow(one: Run) -> Run:
        pressure = np.asarray(1000.0 + np.arange(SECONDS) % 7, np.float64)
        return replace(one, slot_s=120.0, mean={**one.mean, "pressure": pressure})

    train, test = ([slow(one) for one in runs] for runs in three(still, SECONDS))
    assert usable_drivers(train, test, ["temperature", "gyro_x"], None, [], []) == ["pressure"]
