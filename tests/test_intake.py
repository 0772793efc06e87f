from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, ColumnArray, SampleBlock, join
from imumon.intake import STUBBORN, Intake
from imumon.protocols.ranges import Ranges

Columns = dict[str, ColumnArray]


def record(n: int, seed: int = 0) -> Columns:
    rng = np.random.default_rng(seed)
    columns: Columns = {f"gyro_{axis}": rng.standard_normal(n) for axis in "xyz"}
    columns["temperature"] = 25.0 + np.arange(n) * 0.001
    columns["device_time_ns"] = np.arange(n) * 10_000_000
    columns["segment"] = np.zeros(n, np.int64)
    return columns


def seen(columns: Columns, sizes: list[int] | None = None) -> tuple[SampleBlock, Intake]:
    """Return what the stages see, spread over all rows."""
    parts: list[SampleBlock] = []
    intake, start = Intake(Ranges()), 0
    block = SampleBlock(columns)
    while start < len(block):
        size = sizes[len(parts) % len(sizes)] if sizes else len(block)
        taken = intake.process(block.rows(start, min(start + size, len(block))))
        parts.append(SampleBlock({name: taken.spread(v) for name, v in taken.block.columns.items()}))
        start += size
    return join(parts), intake


def test_a_healthy_record_passes_as_it_is() -> None:
    columns = record(5000)
    block, intake = seen(columns)
    assert intake.left_out == 0
    assert all(np.array_equal(block[name], values) for name, values in columns.items())


@pytest.mark.parametrize("value", [1e30, -1e300, np.inf, -np.inf, 1001.0])
def test_what_no_gyro_reads_is_left_out_and_reported_once(value: float) -> None:
    columns = record(500)
    columns["gyro_y"][100] = value
    block, intake = seen(columns)
    assert np.flatnonzero(np.isnan(block["gyro_y"])).tolist() == [100]
    assert not np.isnan(block["gyro_x"]).any()
    assert intake.notices() == ["left out of all estimates: gyro_y beyond -1000 to 1000 rad/s"]
    assert not intake.notices()
    assert intake.left_out == 1


def test_readings_at_the_end_of_a_declared_range_are_left_out_axis_by_axis() -> None:
    columns = record(3000)
    end = np.radians(100.0)
    sent = np.clip(columns["gyro_y"], -end, end)
    columns["gyro_y"] = sent
    intake = Intake(Ranges(gyro_deg_per_s=100.1))
    block = intake.process(SampleBlock(columns)).block
    beyond = np.abs(sent) >= 0.999 * end
    assert 0 < beyond.sum() < 1500
    np.testing.assert_array_equal(np.isnan(block["gyro_y"]), beyond)
    inside = np.abs(columns["gyro_x"]) < 0.999 * end
    np.testing.assert_array_equal(block["gyro_x"][inside], columns["gyro_x"][inside])
    assert "left out of all estimates: gyro_y at its range of 100.1 deg/s" in intake.notices()
    undeclared = Intake(Ranges())
    assert undeclared.process(SampleBlock(columns)).block["gyro_y"] is sent
    assert undeclared.left_out == 0


def test_a_declared_range_is_that_of_the_sensor_alone() -> None:
    columns = {**record(50), "accel_temperature_x": np.full(50, 45.0), "accel_z": np.full(50, 9.8)}
    block = Intake(Ranges(accel_g=2.0)).process(SampleBlock(columns)).block
    assert not np.isnan(block["accel_temperature_x"]).any()
    assert not np.isnan(block["accel_z"]).any()


def test_what_a_pipeline_file_declares_goes_before_the_device() -> None:
    device = Ranges(gyro_deg_per_s=2000.0, accel_g=16.0)
    assert Ranges(gyro_deg_per_s=250.0).over(device) == Ranges(gyro_deg_per_s=250.0, accel_g=16.0)


def test_a_gyro_that_stands_still_is_left_out_until_it_moves() -> None:
    columns = record(5000)
    for axis in "xyz":
        columns[f"gyro_{axis}"][2000:3000] = 35.0
    block, _ = seen(columns)
    out = np.flatnonzero(np.isnan(block["gyro_x"]))
    assert 2000 < out[0] <= 2005
    assert out[-1] == 2999
    assert len(out) == 3000 - out[0]


def test_a_gyro_that_stands_still_from_the_start_is_left_out_soon() -> None:
    columns = record(5000)
    for axis in "xyz":
        columns[f"gyro_{axis}"][:3000] = -35.0
    block, _ = seen(columns)
    assert np.isnan(block["gyro_x"][1:3000]).all()
    assert not np.isnan(block["gyro_x"][3000:]).any()


def test_a_gyro_that_has_had_one_reading_only_has_no_bias() -> None:
    columns = record(5000)
    for axis in "xyz":
        columns[f"gyro_{axis}"][1:3000] = columns[f"gyro_{axis}"][0]
    block, intake = seen(columns)
    assert np.flatnonzero(np.isnan(block["gyro_x"])).tolist() == list(range(1, 3000))
    assert intake.notices() == [
        "left out of all estimates: gyro while its values are nothing but its first reading"
    ]


def test_an_accelerometer_that_is_off_reads_zero_and_is_left_out() -> None:
    columns = record(500)
    columns |= {f"accel_{axis}": columns[f"gyro_{axis}"].copy() for axis in "xyz"}
    columns["accel_x"][50] = 0.0
    for axis in "xyz":
        columns[f"accel_{axis}"][100:110] = 0.0
    block, intake = seen(columns)
    assert np.flatnonzero(np.isnan(block["accel_x"])).tolist() == list(range(100, 110))
    assert intake.notices() == ["left out of all estimates: accel that is zero in all axes"]
    assert intake.left_out == 10


def test_one_axis_of_a_gyro_may_stay_as_it_is() -> None:
    columns = record(500)
    columns["gyro_x"][:] = 0.01
    block, intake = seen(columns)
    assert intake.left_out == 0
    assert (block["gyro_x"] == 0.01).all()


@pytest.mark.parametrize("each", [2, 10, 100])
def test_a_sensor_that_is_read_more_often_than_it_measures_is_taken(each: int) -> None:
    columns = record(20_000)
    for axis in "xyz":
        columns[f"gyro_{axis}"] = np.repeat(columns[f"gyro_{axis}"][: 20_000 // each], each)
    block, _ = seen(columns)
    assert np.isnan(block["gyro_x"]).mean() < 0.02
    assert not np.isnan(block["gyro_x"][10_000:]).any()


def test_a_gyro_whose_noise_is_below_its_step_may_stand_still_at_rest() -> None:
    columns = record(5000)
    for axis in "xyz":
        columns[f"gyro_{axis}"][2000:] = 0.01
    block, intake = seen(columns)
    assert intake.left_out == 0
    assert np.array_equal(block["gyro_x"], columns["gyro_x"])


def test_a_gyro_with_coarse_steps_is_taken() -> None:
    columns = record(20_000)
    for axis in "xyz":
        columns[f"gyro_{axis}"] = np.round(columns[f"gyro_{axis}"] / 3.0) * 3.0
    block, _ = seen(columns)
    assert np.isnan(block["gyro_x"]).mean() < 0.001


def test_a_thermometer_that_has_not_begun_is_left_out() -> None:
    columns = record(500)
    columns["temperature"][:200] = 0.0
    columns["temperature"][300] = 0.0
    block, _ = seen(columns)
    assert np.flatnonzero(np.isnan(block["temperature"])).tolist() == list(range(200))


def test_where_no_thermometer_works_is_no_temperature() -> None:
    columns = record(500)
    columns["temperature"][[5, 7]] = 6553.5, -273.0
    block, intake = seen(columns)
    assert np.flatnonzero(np.isnan(block["temperature"])).tolist() == [5, 7]
    assert intake.notices(ended=True) == [
        "left out of all estimates: temperature beyond -100 to 250 °C (2 in all)"
    ]


def test_what_cannot_be_neither_begins_a_sensor_nor_ends_its_standing_still() -> None:
    for value in (1e10, np.nan):
        columns = record(2000)
        for axis in "xyz":
            columns[f"gyro_{axis}"][:1000] = 0.0
            columns[f"gyro_{axis}"][500] = value
        columns["temperature"][:1000] = 0.0
        columns["temperature"][500] = value
        block, _ = seen(columns)
        for name in ("gyro_x", "temperature"):
            assert np.isnan(block[name][:1000]).all()
            assert not np.isnan(block[name][1001:]).any()


def test_a_row_that_comes_twice_is_left_out_for_its_time_alone() -> None:
    twice = {name: np.repeat(values, 2) for name, values in record(500).items()}
    block, intake = seen(twice)
    np.testing.assert_array_equal(block["gyro_x"][::2], twice["gyro_x"][::2])
    assert intake.notices(ended=True) == [
        "left out of all estimates: rows whose time does not go on (500 in all)"
    ]


def test_rows_whose_time_stands_still_are_left_out() -> None:
    columns = record(500)
    columns["device_time_ns"][100:200] = columns["device_time_ns"][100]
    block, intake = seen(columns)
    assert np.flatnonzero(np.isnan(block["gyro_x"])).tolist() == list(range(101, 200))
    assert intake.left_out == 99


def test_a_time_that_leaps_and_comes_back_costs_its_rows_only() -> None:
    columns = record(500)
    columns["device_time_ns"][100:105] = 1 << 62
    block, _ = seen(columns)
    assert np.flatnonzero(np.isnan(block["gyro_x"])).tolist() == list(range(100, 105))


@pytest.mark.parametrize("sizes", [None, [1], [3, 50]])
def test_rows_without_a_time_cost_themselves_only(sizes: list[int] | None) -> None:
    columns = record(500)
    columns["device_time_ns"][[0, 1, 300]] = NO_INT
    columns["segment"][250:] = 1
    columns["device_time_ns"][250] = NO_INT
    block, intake = seen(columns, sizes)
    assert np.flatnonzero(np.isnan(block["gyro_x"])).tolist() == [0, 1, 250, 300]
    assert block["segment"][-1] == 1
    assert intake.left_out == 4


def test_a_clock_that_was_set_goes_on_in_a_segment_of_its_own() -> None:
    columns = record(1000)
    columns["device_time_ns"][500:] -= 4_000_000_000
    block, _ = seen(columns)
    assert np.isnan(block["gyro_x"]).sum() == STUBBORN - 1
    assert block["segment"][-1] == 1


@given(
    sizes=st.lists(st.integers(1, 60), min_size=1, max_size=6),
    seed=st.integers(0, 50),
)
@settings(max_examples=60, deadline=None)
def test_the_division_into_blocks_makes_no_difference(sizes: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    columns = record(400, seed)
    for _ in range(6):
        start, length = (int(value) for value in rng.integers(0, 300, 2))
        part, kind = slice(start, start + length), rng.integers(5)
        if kind == 0:
            for axis in "xyz":
                columns[f"gyro_{axis}"][part] = 35.0
        elif kind == 1:
            columns["device_time_ns"][part] = columns["device_time_ns"][start]
        elif kind == 2:
            columns["device_time_ns"][start:] += int(rng.integers(-(10**17), 10**17))
        elif kind == 3:
            columns["gyro_x"][part] = 1e30
        else:
            columns["temperature"][: start // 2] = 0.0
    (whole, one), (parts, other) = seen(columns), seen(columns, sizes)
    for name, values in whole.columns.items():
        np.testing.assert_array_equal(values, parts[name])
    assert one.left_out == other.left_out


AT_50_HZ = 20_000_000


def at_50_hz(n: int, seed: int = 0) -> Columns:
    """Return the record of a unit in motion, each minute of which is 3000 rows."""
    return record(n, seed) | {"device_time_ns": np.arange(n) * AT_50_HZ}


@pytest.mark.parametrize(
    ("value", "said"),
    [(0.0, "0 rad/s without any change"), (0.25, "0.25 rad/s without any change"), (np.nan, "nothing")],
)
@pytest.mark.parametrize("since", [0, 1000])
def test_an_axis_that_stays_as_it_is_beside_those_that_do_not_is_reported(
    value: float, said: str, since: int
) -> None:
    columns = at_50_hz(5000)
    columns["gyro_y"][since:] = value
    for sizes in (None, [1], [7, 700], [1499, 2]):
        _, intake = seen(columns, sizes)
        (text,) = intake.notices()
        window_s = 30.0 if since else 0.0  # the first window in which it never changed
        lasts = f"for 30 s and more, since {window_s:.3f} s of device time, while gyro_"
        assert text.startswith(f"gyro_y reads {said} {lasts}")
        assert not intake.notices()
        assert intake.left_out == 0


def test_an_axis_that_stays_for_a_shorter_time_is_not_reported() -> None:
    columns = at_50_hz(6000)
    for start in (0, 1500, 3000, 4500):  # each time on another value
        columns["gyro_y"][start : start + 1490] = 1e-4 * start
    assert seen(columns)[1].notices() == []


@pytest.mark.parametrize("step_of_noise", [0.1, 1.0, 3.0, 10.0, 100.0])
@pytest.mark.parametrize("seed", range(3))
def test_a_coarse_sensor_at_rest_has_no_dead_axis(step_of_noise: float, seed: int) -> None:
    columns = at_50_hz(6000, seed)
    offset = np.random.default_rng(seed).uniform(-5.0, 5.0, 3)
    offset[0] = 0.5  # between two steps: it goes to and fro whatever the noise
    for axis, bias in zip("xyz", offset, strict=True):
        columns[f"gyro_{axis}"] = np.round(columns[f"gyro_{axis}"] / step_of_noise + bias) * step_of_noise
    assert not [text for text in seen(columns)[1].notices() if "without any change" in text]


def test_an_axis_that_dies_is_reported_beside_a_coarse_one_and_after_rest() -> None:
    columns = at_50_hz(9000)
    for axis in "xyz":  # a minute of rest within a step, then motion
        columns[f"gyro_{axis}"][:3000] = 0.0
        columns[f"gyro_{axis}"] = np.round(columns[f"gyro_{axis}"] / 0.1) * 0.1
    columns["gyro_z"][:] = 0.0
    for sizes in (None, [13, 900]):
        _, intake = seen(columns, sizes)
        texts = [text for text in intake.notices() if "without any change" in text]
        assert len(texts) == 1
        assert texts[0].startswith("gyro_z reads 0 rad/s")


def test_an_axis_that_goes_on_in_a_new_segment_begins_anew() -> None:
    columns = at_50_hz(2800)
    columns["gyro_y"][:] = 0.0
    columns["segment"][1400:] = 1
    assert seen(columns)[1].notices() == []
    columns["segment"][:] = 0
    assert len(seen(columns)[1].notices()) == 1
