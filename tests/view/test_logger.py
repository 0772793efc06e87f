from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from rerun.chunk import RrdReader

from imumon.blocks import ColumnArray, SampleBlock
from imumon.charts import BLUE, GREEN, GREY, ORANGE, RED, VIOLET
from imumon.view.items import Instant, Log, Numbers, State, Status, Timebase, Times, ViewItem, ViewSetup
from imumon.view.lanes import LOG_TEXT
from imumon.view.layout import Line, Strip, read_as, xyzw
from imumon.view.logger import StreamLogger, status_card
from imumon.view.panels import PANELS
from imumon.view.rows import Rows
from imumon.view.window import Window
from tests.view.streams import ACCEL, GYRO, QUATERNION, Stream, block, entities, record_batches, scalars

Write = Callable[[StreamLogger], None]


@pytest.fixture
def write(tmp_path: Path) -> Callable[[Write], Path]:
    """Log to a file and return it."""

    def written(fill: Write) -> Path:
        path = tmp_path / "log.rrd"
        rec = rr.RecordingStream("imumon", recording_id="test")
        rec.set_sinks(rr.FileSink(path))
        logger = StreamLogger(rec, ViewSetup("test", "test"), live=True)
        logger.begin()
        fill(logger)
        rec.disconnect()
        return path

    return written


def test_samples_read_back_bit_for_bit_in_si(write: Callable[[Write], Path]) -> None:
    sent: list[Stream] = []

    def fill(logger: StreamLogger) -> None:
        stream = Stream(lambda item: logger.log([item]))
        for _ in range(5):
            stream.send(20)
        sent.append(stream)

    path = write(fill)
    sample, device, host, accel = scalars([path], "/samples/accel")
    np.testing.assert_array_equal(sample, np.arange(100))
    np.testing.assert_array_equal(device, block(0, 100)["device_time_ns"])
    np.testing.assert_array_equal(host, block(0, 100)["host_time_ns"])
    np.testing.assert_array_equal(accel, sent[0].column(ACCEL))
    np.testing.assert_allclose(scalars([path], "/view/gyro")[3], np.rad2deg(sent[0].column(GYRO)))


@pytest.mark.parametrize("rows", [3, 8, 50])
def test_estimates_come_five_times_a_second_however_the_samples_come(
    write: Callable[[Write], Path], rows: int
) -> None:
    """Rows at 100 Hz: of those at 0.00, 0.01 ... s the ones at 0.0, 0.2 ... s."""
    sd = {f"gyro_bias_sd_{axis}": np.full(300, 1e-5) for axis in "xyz"}
    bias = {f"gyro_bias_{axis}": np.arange(300.0) for axis in "xyz"}

    def fill(logger: StreamLogger) -> None:
        timebase, whole = Timebase(), block(0, 300).with_columns({**bias, **sd})
        for start in range(0, 300, rows):
            logger.log([timebase.samples(whole.rows(start, min(start + rows, 300)))])

    batches = [b for b in record_batches(write(fill), "/view/gyro_bias/x") if "device_time" in b.schema.names]
    device = np.concatenate([b.column("device_time").cast("int64").to_numpy() for b in batches])
    assert (np.diff(np.sort(device) // 200_000_000) == 1).all()
    assert len(device) == pytest.approx(300 / 20, abs=1)


def test_panels_of_what_a_device_does_not_send_do_not_exist(write: Callable[[Write], Path]) -> None:
    path = write(
        lambda logger: Stream(lambda item: logger.log([item]), ("mag", "q_", "temperature")).send(50)
    )
    there = entities(path)
    assert {"/samples/accel", "/view/gyro"} <= there
    assert not {"/samples/mag", "/samples/temperature", "/attitude/body"} & there


def test_columns_of_nan_alone_do_not_make_a_panel(write: Callable[[Write], Path]) -> None:
    silent = {name: np.full(20, np.nan) for name in ("mag_x", "mag_y", "mag_z")}
    samples = Timebase().samples(block(0, 20).with_columns(silent))
    assert "/samples/mag" not in entities(write(lambda logger: logger.log([samples])))


@pytest.mark.parametrize("reports", [True, False])
def test_an_estimated_attitude_turns_the_body_of_a_device_that_reports_none(
    write: Callable[[Write], Path], reports: bool
) -> None:
    sent = block(0, 100)
    names = [f"attitude_estimate_{part}" for part in "wxyz"]
    estimated = {name: np.r_[np.nan, sent[own][1:]] for name, own in zip(names, QUATERNION, strict=True)}
    if not reports:
        sent = block(0, 100, leave_out=("q_",))
    path = write(lambda logger: logger.log([Timebase().samples(sent.with_columns(estimated))]))
    there = {name for name in entities(path) if name.endswith("/body")}
    assert there == {"/attitude/body" if reports else "/attitude_estimate/body"}


def test_unknown_columns_are_recorded_too(write: Callable[[Write], Path]) -> None:
    extra = block(0, 20).with_columns({"humidity": np.linspace(40.0, 41.0, 20)})
    path = write(lambda logger: logger.log([Timebase().samples(extra)]))
    np.testing.assert_array_equal(scalars([path], "/samples/other/humidity")[3][:, 0], extra["humidity"])


def test_a_side_stream_has_entities_of_its_own(write: Callable[[Write], Path]) -> None:
    def fill(logger: StreamLogger) -> None:
        timebase = Timebase()
        logger.log([timebase.samples(block(0, 20))])
        times = {name: block(0, 2)[name] for name in ("device_time_ns", "host_time_ns", "segment")}
        side = {"gnss_latitude": np.array([48.0, 48.5])}
        logger.log([timebase.side("gnss", SampleBlock({**times, **side}))])

    there = entities(write(fill))
    assert "/samples/other/gnss/latitude" in there
    assert "/samples/other/gnss_latitude" not in there


def test_state_before_the_first_sample_shows_on_device_time(write: Callable[[Write], Path]) -> None:
    path = write(lambda logger: Stream(lambda item: logger.log([item])).send(10))
    times = [
        time
        for batch in record_batches(path, "/1-Port")
        if "device_time" in batch.schema.names
        for time in batch.column("device_time").cast("int64").to_pylist()
    ]
    assert times == [int(block(0, 1)["device_time_ns"][0]) - 100_000_000]


def test_device_without_any_time_is_shown_over_the_sample_index(write: Callable[[Write], Path]) -> None:
    bare = SampleBlock({name: block(0, 20)[name] for name in GYRO})
    path = write(lambda logger: logger.log([Timebase().samples(bare)]))
    (batch,) = record_batches(path, "/view/gyro")
    assert {"sample"} == {"sample", "device_time", "host_time"} & set(batch.schema.names)


def test_numbers_and_card_are_logged(write: Callable[[Write], Path]) -> None:
    timebase = Timebase()
    first = timebase.samples(block(0, 10))
    at = timebase.at()
    numbers = {
        "packet_rate": 100.0,
        "link_load": 0.25,
        "packets_lost": 2.0,
        "packets_damaged": 1.0,
        "odd": 7.0,
    }
    items: list[ViewItem] = [
        first,
        Numbers(at, numbers),
        Status(at, {"Port": "/dev/ttyUSB0"}),
        State(at, "clock", "ok"),
    ]
    path = write(lambda logger: logger.log(items))
    assert scalars([path], "/view/link_load")[3].tolist() == [[25.0]]
    assert scalars([path], "/samples/losses")[3].tolist() == [[2.0, 1.0]]
    assert scalars([path], "/samples/other/odd")[3].tolist() == [[7.0]]
    assert {"/status", "/4-Clock"} <= entities(path)


def test_panel_keys_and_columns_are_unique_enough_to_tell_panels_apart() -> None:
    assert len({panel.key for panel in PANELS}) == len(PANELS)
    assert all(panel.columns for panel in PANELS)


def test_euler_angles_and_quaternion_turn_the_body_alike() -> None:
    rng = np.random.default_rng(1)
    angles = rng.uniform([-3.0, -1.5, -3.0], [3.0, 1.5, 3.0], (50, 3))
    for (roll, pitch, yaw), (x, y, z, w) in zip(angles, xyzw(angles), strict=True):
        about_x = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        about_y = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        about_z = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        turned = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
            ]
        )
        np.testing.assert_allclose(turned, about_z @ about_y @ about_x, atol=1e-12)
    assert xyzw(np.array([[1.0, 2.0, 3.0, 4.0]])).tolist() == [[2.0, 3.0, 4.0, 1.0]]


def test_units_are_those_of_the_device() -> None:
    assert read_as(ViewSetup("t", "t"), "mag_x") == ("µT", 1.0)
    assert read_as(ViewSetup("t", "t", units={"mag_x": "arbitrary"}), "mag_x") == ("a.u.", 1.0)
    assert read_as(ViewSetup("t", "t"), "unheard_of") == ("", 1.0)


def test_status_card_is_a_table() -> None:
    card = status_card(Status(Timebase().at(), {"Port": "/dev/ttyUSB0", "Lost": "0"}))
    assert "| **Port** | /dev/ttyUSB0 |" in card.splitlines()


def luminance(color: tuple[int, int, int]) -> float:
    """Relative luminance (WCAG 2, without the linear toe, which no colour here reaches)."""
    return float(np.dot([0.2126, 0.7152, 0.0722], (np.array(color) / 255.0) ** 2.4))


@pytest.mark.parametrize("color", [RED, GREEN, BLUE, ORANGE, VIOLET, GREY])
def test_colours_read_on_the_dark_and_on_the_light_theme(color: tuple[int, int, int]) -> None:
    dark, light = luminance((13, 16, 17)), 1.0
    assert (luminance(color) + 0.05) / (dark + 0.05) > 2.2
    assert (light + 0.05) / (luminance(color) + 0.05) > 2.2


def test_limits_and_the_raw_rate_stand_in_the_view_of_a_strip(write: Callable[[Write], Path]) -> None:
    panel = Strip("a", "A", (Line("temperature", "t", RED),), limits=(-2.0, 2.0), beside="/view/gyro")
    n = 30
    values: dict[str, ColumnArray] = {"temperature": np.linspace(0.0, 1.0, n)}
    rows = Rows(values, Times(np.arange(n), None, None))
    path = write(lambda logger: panel.log(logger._rec, rows))
    (batch,) = record_batches(path, "/samples/a/limits")
    np.testing.assert_array_equal(batch.column("sample").to_numpy(), [0, n - 1])
    np.testing.assert_array_equal(batch.column("Scalars:scalars").flatten().to_numpy(), [-2, 2, -2, 2])
    view = panel.view(ViewSetup("test", "test"), Window())
    assert view.contents == ["/samples/a/**", "/view/gyro"]


def test_of_a_sparse_column_only_the_rows_with_a_value_are_logged(write: Callable[[Write], Path]) -> None:
    panel = Strip("a", "A", (Line("temperature", "t", RED),), look="points", limits=(-3.0, 3.0))
    values = np.full(30, np.nan)
    values[[4, 17]] = 1.5, -0.5
    rows = Rows({"temperature": values}, Times(np.arange(30), None, None))
    empty = Rows({"temperature": np.full(5, np.nan)}, Times(np.arange(30, 35), None, None))

    def fill(logger: StreamLogger) -> None:
        panel.log(logger._rec, rows)
        panel.log(logger._rec, empty)

    path = write(fill)
    (batch,) = record_batches(path, "/samples/a")
    np.testing.assert_array_equal(batch.column("sample").to_numpy(), [4, 17])
    np.testing.assert_array_equal(batch.column("Scalars:scalars").flatten().to_numpy(), [1.5, -0.5])


def test_an_estimate_is_drawn_in_its_two_sigma_band(write: Callable[[Write], Path]) -> None:
    n = 200
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.arange(n) * 10_000_000,
        "segment": np.zeros(n, np.int64),
    }
    sds = {"temperature_estimate": 0.25, "temperature_rate": 0.001}
    for name, sd in sds.items():
        columns |= {name: np.linspace(1.0, 2.0, n), f"{name}_sd": np.full(n, sd)}
    columns["temperature_rate"][:50] = np.nan
    path = write(lambda logger: logger.log([Timebase().samples(SampleBlock(columns))]))
    for entity, sd, drawn in (
        ("/view/temperature_estimate/sensor", 0.25, 10),
        ("/view/temperature_rate/sensor", 0.001 * 3600, 7),
    ):
        batches = [b for b in record_batches(path, entity) if "Measurements:values" in b.schema.names]
        variances = np.concatenate([b.column("Measurements:variances").flatten().to_numpy() for b in batches])
        np.testing.assert_allclose(variances, (2 * sd) ** 2)
        assert len(variances) == drawn


def test_states_and_log_are_repeated_on_all_timelines_for_who_takes_the_newest_first(tmp_path: Path) -> None:
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(tmp_path / "a.rrd"))
    logger = StreamLogger(rec, ViewSetup("test", "test"), live=True)
    logger.begin()
    timebase = Timebase()
    early = Instant(None, None, 1)
    logger.log([State(early, "port", "open"), Log(early, "opened")])
    logger.log([timebase.samples(block(0, 50))])
    rec.flush()
    rec.set_sinks(rr.FileSink(tmp_path / "later.rrd"))
    logger.repeat()
    rec.disconnect()
    for entity in ("/1-Port", LOG_TEXT):
        chunks = RrdReader(str(tmp_path / "later.rrd")).stream().filter(content=[entity])
        assert any("device_time" in chunk.to_record_batch().schema.names for chunk in chunks)
