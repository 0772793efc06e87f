from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from imumon.blocks import ColumnArray, SampleBlock
from imumon.errors import EXIT_USAGE, ImumonError, Reason
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.pipeline import Pipeline
from imumon.protocols.device import device_names, load_device, parse_device
from imumon.protocols.ranges import Ranges
from imumon.run.setup import Setup
from imumon.run.stages import pipeline_of
from imumon.simulation.unit import SimulatedUnit, load_scenario
from tests.protocols.streams import feed_in_chunks

GOOD = """\
format: imumon-device/1
name: demo
title: demo
protocol: fixed
axes: FLU
packet:
  length: 12
  byte_order: big
  sync: [0xAA]
  checksum: {type: sum8, first: 0, last: 10, at: 11}
  fields:
    - {at: 1, type: u16, column: packet_counter}
    - {at: 3, type: i16, columns: [gyro_x, gyro_y, gyro_z], scale: 0.01, unit: deg/s}
"""


def complaint(text: str) -> str:
    with pytest.raises(ImumonError) as caught:
        parse_device(text, "my.yaml")
    assert caught.value.reason is Reason.BAD_CONFIG
    assert caught.value.reason.exit_code == EXIT_USAGE
    return caught.value.seen


def test_the_good_file_is_good() -> None:
    assert parse_device(GOOD, "my.yaml").name == "demo"


@pytest.mark.parametrize(
    ("old", "new", "line", "words"),
    [
        ("length: 12", "length: twelve", 7, "packet.length"),
        ("length: 12", "length: 12\n  lenght: 12", 8, "packet.lenght: unknown key"),
        ("sync: [0xAA]", "sync: [0x1AA]", 9, "packet.sync[0]"),
        ("type: sum8", "type: crc17", 10, "packet.checksum.type"),
        ("at: 11}", "at: 12}", 6, "checksum: bytes 12 to 12 are outside the packet of 12 bytes"),
        ("last: 10", "last: 11", 6, "checksum: covers itself"),
        ("column: packet_counter", "columns: []", 12, "packet.fields[0].columns"),
        ("type: u16, column", "type: u12, column", 12, "packet.fields[0].type"),
        ("type: u16, column: packet_counter", "type: u16", 12, "give either column"),
        ("unit: deg/s", "unit: inch", 13, "unit 'inch' does not measure what 'rad/s' measures"),
        ("unit: deg/s", "unit: quux", 13, "unit 'quux' is not known"),
        (", unit: deg/s", "", 13, "gyro_x"),
        ("at: 3, type: i16", "at: 8, type: i16", 6, "outside the packet"),
        ("type: u16, column", "type: u16, mask: 0x10000, column", 12, "mask 0x10000 is wider than u16"),
        ("type: i16, columns", "type: i16, mask: 1, columns", 13, "a mask needs an unsigned type"),
        ("gyro_y, gyro_z]", "gyro_y, gyro_y]", 6, "gyro_y"),
        ("type: u16, column", "type: u64, column", 12, "packet_counter has 32 bits at most"),
        ("axes: FLU", "axes: NED", 5, "axes"),
        ("axes: FLU\n", "", 1, "axes: this key is required"),
        ("protocol: fixed", "protocol: morse", 4, "protocol"),
        ("format: imumon-device/1", "format: imumon-device/9", 1, "format"),
        ("title: demo", "title: demo\ntitle: again", 4, "key 'title' is there twice"),
        ("title: demo", "title: [", 5, "not valid YAML"),
    ],
)
def test_a_wrong_file_is_refused_with_its_line(old: str, new: str, line: int, words: str) -> None:
    assert old in GOOD
    seen = complaint(GOOD.replace(old, new))
    assert f"my.yaml:{line}:" in seen, seen
    assert words in seen, seen


@pytest.mark.parametrize("scale", ["1/16.4", "10/164", "-1/16.4"])
def test_a_scale_may_be_a_fraction_of_decimals(scale: str) -> None:
    device = parse_device(GOOD.replace("scale: 0.01,", f"scale: {scale},"), "my.yaml")
    assert device.name == parse_device(GOOD, "my.yaml").name


@pytest.mark.parametrize("scale", ["1/0", "0", "0/5", "fast", "[1]", "true", "1/1e9"])
def test_a_scale_that_is_none_is_refused_in_one_line(scale: str) -> None:
    seen = complaint(GOOD.replace("scale: 0.01,", f"scale: {scale},"))
    assert "scale: expected a number or a fraction such as 1/16.4" in seen
    assert "\n" not in seen


@pytest.mark.parametrize("name", ["device_time_ns", "arrival_time_ns", "host_time_ns", "segment"])
def test_a_column_that_imumon_sets_is_no_column_of_a_device(name: str) -> None:
    assert "the clock of a device is device_ticks" in complaint(GOOD.replace("packet_counter", name))


@pytest.mark.parametrize("name", device_names())
def test_no_device_has_a_column_that_a_stage_adds(name: str) -> None:
    pipeline_of(load_device(name), Setup(latitude_deg=50.0))


@pytest.mark.parametrize("name", ["gyro_bias_x", "at_rest", "heading"])
def test_a_column_that_a_stage_adds_is_refused_before_anything_is_written(name: str) -> None:
    device = parse_device(GOOD.replace("packet_counter", name), "my.yaml")
    with pytest.raises(ImumonError, match=f"device demo has column {name}, which stage .* adds") as caught:
        pipeline_of(device, Setup(latitude_deg=50.0))
    assert "another name in the device file" in caught.value.hint
    pipeline_of(device, only=())


def test_a_device_without_a_checksum() -> None:
    packet = parse_device(GOOD.replace("{type: sum8, first: 0, last: 10, at: 11}", "none"), "my.yaml")
    block = feed_in_chunks(packet.decoder(), b"\xaa\x00\x07" + bytes(9), [5])
    assert block["packet_counter"].tolist() == [7]
    assert "packet.checksum" in complaint(GOOD.replace("{type: sum8, first: 0, last: 10, at: 11}", "null"))


def test_an_empty_file_and_a_list_are_refused() -> None:
    assert "my.yaml:1: expected a mapping of keys, got an empty file" in complaint("")
    assert "got a list" in complaint("- 1\n- 2\n")


def test_an_unknown_device_names_those_that_there_are() -> None:
    with pytest.raises(ImumonError, match="no device 'ax2'") as caught:
        load_device("ax2")
    for name in device_names():
        assert name in caught.value.hint
    assert "ax1" in device_names()


def test_a_path_that_is_not_there_is_reported_as_missing(tmp_path: Path) -> None:
    with pytest.raises(ImumonError, match="no such file"):
        load_device(str(tmp_path / "mine.yaml"))


def test_a_device_can_be_given_by_path(tmp_path: Path) -> None:
    path = tmp_path / "mine.yaml"
    path.write_text(GOOD, encoding="utf-8")
    assert load_device(str(path)).name == "demo"


def test_a_device_file_declares_the_range_of_its_sensors() -> None:
    assert load_device("witmotion").range == Ranges(gyro_deg_per_s=2000.0, accel_g=16.0)
    assert parse_device(GOOD, "my.yaml").range == Ranges()
    assert "range.gyro_deg_per_s" in complaint(GOOD + "range: {gyro_deg_per_s: -200}\n")


@pytest.mark.parametrize(("given", "end_deg_per_s"), [(None, 100.0), (Ranges(gyro_deg_per_s=50.0), 50.0)])
def test_the_range_of_a_device_holds_unless_another_is_given(
    given: Ranges | None, end_deg_per_s: float
) -> None:
    device = parse_device(GOOD + "range: {gyro_deg_per_s: 100}\n", "my.yaml")
    sent: dict[str, ColumnArray] = {f"gyro_{axis}": np.linspace(0.01, 3.0, 301) for axis in "xyz"}
    sent |= {"device_time_ns": 10_000_000 * np.arange(301), "segment": np.zeros(301, np.int64)}
    pipeline = Pipeline(device, [RestDetector()], given)
    pipeline.push(SampleBlock(sent))
    beyond = sent["gyro_x"] > 0.998 * np.radians(end_deg_per_s)
    assert pipeline.counters.left_out == 3 * np.sum(beyond) > 0


def test_the_complete_file_of_the_docs_decodes_and_is_that_of_the_tutorial() -> None:
    docs = Path(__file__).parents[2] / "docs"
    text = (docs / "device-files.md").read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    assert text in (docs / "tutorials" / "your-device.md").read_text(encoding="utf-8")
    device = parse_device(text, "docs/device-files.md")
    packets = device.encoder().encode(SimulatedUnit(load_scenario("bench")).samples(100))
    pipeline = Pipeline(device)
    pipeline.feed(b"".join(packets), 0)
    assert pipeline.counters.bytes_in_packets == pipeline.counters.bytes_received == 100 * 18
    force = pipeline.take().accel
    assert force is not None
    assert np.linalg.norm(force[50]) == pytest.approx(9.8, abs=0.2)
