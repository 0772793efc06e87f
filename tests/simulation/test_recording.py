from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imumon.blocks import SampleBlock, join
from imumon.errors import ImumonError, Reason
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.folder import TRUTH_NAME, Session, open_session
from imumon.recordings.source import open_source, run_over
from imumon.recordings.table import read_table
from imumon.recordings.wire_reader import WireReader
from imumon.simulation.recording import (
    CHAMBER_NAME,
    SCENARIO_NAME,
    START_NS,
    record_session,
    write_table,
)
from imumon.simulation.unit import Scenario, SimulatedUnit, load_scenario
from imumon.simulation.unit.unit import CHUNK
from imumon.transport.reader import Bytes

RESOLUTION = {"gyro": np.radians(0.5e-6), "accel": 0.5e-6, "temperature": 1e-9}
"""Of the packet of an AX1: rad/s, m/s²; the readings are steps of the packet already."""


def plan(seconds: float) -> Scenario:
    return load_scenario("bumps-and-fan").model_copy(update={"duration_s": seconds})


def record(folder: Path, device_name: str, scenario: Scenario, seed: int = 3) -> Session:
    text, source = device_text(device_name)
    device = parse_device(text, source)
    played = scenario.played(scenario.rate_hz, device.axes)
    done: list[int] = []
    session = record_session(played, device, text, seed, folder, done.append)
    assert sum(done) == scenario.samples
    return session


def replay(folder: Path) -> SampleBlock:
    source = open_source(folder)
    return join(list(run_over(source.items, Pipeline(source.device))))


def test_a_session_replays_to_the_simulated_samples(tmp_path: Path) -> None:
    session = record(tmp_path / "s", "ax1", plan(100.0))
    block = replay(session.path)
    sent, truth = SimulatedUnit(plan(100.0), 3).run(10_000)
    assert len(block) == 10_000 > CHUNK
    for kind, resolution in RESOLUTION.items():
        for axis in "xyz":
            name = f"{kind}_{axis}"
            np.testing.assert_allclose(block[name], sent[name], atol=1.01 * resolution, rtol=0, err_msg=name)
    np.testing.assert_array_equal(block["device_time_ns"], sent["device_time_ns"])
    table, columns = read_table(session.path / TRUTH_NAME)
    for name, values in truth.columns.items():
        np.testing.assert_array_equal(table[name], values, err_msg=name)
    assert columns["gyro_bias_x"].unit == "rad/s"
    assert open_session(session.path).state == "closed"
    assert session.metadata.counters["packets"] == 10_000


def test_arrivals_come_in_order_and_after_the_line_has_carried_the_packet(tmp_path: Path) -> None:
    block = replay(record(tmp_path / "s", "ax1", plan(20.0)).path)
    delay = block["arrival_time_ns"] - START_NS - block["device_time_ns"]
    line_ns = 58 * 10 / 115_200 * 1e9
    assert delay.min() >= line_ns
    assert np.median(delay) < line_ns + 2e6
    assert np.all(np.diff(block["arrival_time_ns"]) >= 0)
    late = block["host_time_ns"] - START_NS - block["device_time_ns"]
    assert np.ptp(late) < 1_500_000


@pytest.mark.parametrize("device", ["xsens", "openimu", "microstrain"])
def test_other_devices_send_a_scenario_in_their_own_axes(tmp_path: Path, device: str) -> None:
    session = record(tmp_path / "s", device, plan(3.0))
    block = replay(session.path)
    axes = session.metadata.axes
    assert axes is not None
    sent, truth = SimulatedUnit(plan(3.0).played(100.0, axes), 3).run(300)
    np.testing.assert_allclose(block["accel_z"], sent["accel_z"], atol=1e-3)
    assert len(truth) == len(read_table(session.path / TRUTH_NAME)[0])


def test_the_same_seed_gives_the_same_bytes_at_the_same_times(tmp_path: Path) -> None:
    paths = [record(tmp_path / str(i), "ax1", plan(2.0), seed).wire_path for i, seed in enumerate((1, 1, 2))]
    first, again, other = ([item for item in WireReader(path) if isinstance(item, Bytes)] for path in paths)
    assert first == again
    assert first != other


def test_the_scenario_is_kept_and_can_be_played_again(tmp_path: Path) -> None:
    session = record(tmp_path / "s", "ax1", plan(2.0))
    assert load_scenario(session.path / SCENARIO_NAME) == plan(2.0)


def test_the_log_of_the_chamber_is_beside_the_session(tmp_path: Path) -> None:
    scenario = load_scenario("crs05-ramp").model_copy(update={"duration_s": 30.0})
    session = record(tmp_path / "s", "ax1", scenario)
    table = np.genfromtxt(session.path / CHAMBER_NAME, delimiter=",", names=True)
    assert table.dtype.names == ("time_s", "wall_degc", "case_degc")
    np.testing.assert_array_equal(table["time_s"], [0.0, 10.0, 20.0])
    np.testing.assert_allclose(table["wall_degc"], 27.28, atol=0.25)


def test_what_does_not_fit_is_refused_before_anything_is_made(tmp_path: Path) -> None:
    fast = plan(2.0).played(1000.0, "FRD")
    with pytest.raises(ImumonError) as caught:
        record(tmp_path / "s", "ax1", fast)
    assert caught.value.reason is Reason.BAD_CONFIG
    assert "503%" in caught.value.seen
    assert not (tmp_path / "s").exists()
    record(tmp_path / "s", "ax1", plan(1.0))
    with pytest.raises(ImumonError) as caught:
        record(tmp_path / "s", "ax1", plan(1.0))
    assert caught.value.reason is Reason.EXISTS


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_a_table_has_what_is_sent_and_the_truth(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    write_table(plan(5.0), 4, path, lambda _: None)
    table, columns = read_table(path)
    sent, truth = SimulatedUnit(plan(5.0), 4).run(500)
    for name, values in sent.columns.items():
        np.testing.assert_array_equal(table[name], values, err_msg=name)
    np.testing.assert_array_equal(table["true_gyro_bias_y"], truth["gyro_bias_y"])
    assert columns["true_rate_x"].unit == columns["gyro_x"].unit == "rad/s"
