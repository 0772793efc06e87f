from __future__ import annotations

import csv
import struct

import numpy as np
import pytest

from imumon.blocks import NO_INT, SampleBlock
from imumon.errors import ImumonError
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.protocols.framing import IMPOSSIBLE
from imumon.protocols.text import sentence
from imumon.protocols.vectornav import XMODEM, VectorNavDecoder, read_contents
from tests.data_folder import measured
from tests.protocols.streams import feed_in_chunks

YMR = (
    b"$VNYMR,-095.878,+008.933,-009.419,+00.1785,+00.1474,+00.5479,+00.252,-03.706,-03.874,-01.012502,"
    b"-00.234810,+00.247165*66\r\n"
)
TORN = (
    b"$VNYMR,+123.516,-007.151,-005.958,+00.0541,+00.0360,+00.1152,-01.286,+01.053,-10.195,+00.00051032,"
    b"+00.0677,+00.1286,-01.290,+01.075,-10.187,+00.000800,+00.000521,+00.000615*6B\r\n"
)
AUTHORS_COLUMNS = {
    **{f"mag_{axis}": 100.0 for axis in "xyz"},
    **{f"accel_{axis}": 1.0 for axis in "xyz"},
    **{f"gyro_{axis}": 1.0 for axis in "xyz"},
    "temperature": 1.0,
    "pressure": 1000.0,
    **dict.fromkeys(("yaw", "pitch", "roll"), np.pi / 180),
}
"""Columns in the order of the author's table, and their factors to our units."""


def test_a_capture_in_the_middle_of_foreign_text_is_decoded_as_its_author_did() -> None:
    data = measured("vectornav/vn100-first-half.bin").read_bytes()
    with measured("vectornav/vn100-first-half-author.csv").open() as file:
        rows = list(csv.reader(file))[2:]
    theirs = np.array([[float(cell) for cell in row if cell.strip()] for row in rows])
    decoder = VectorNavDecoder()
    block = feed_in_chunks(decoder, data, [997])
    assert decoder.counters().packets_by_type == {"binary": 4446}
    assert decoder.notices() == decoder.warnings() == []
    for k, (name, factor) in enumerate(AUTHORS_COLUMNS.items()):
        # Seven digits in the author's table.
        np.testing.assert_allclose(block[name][: len(theirs)] / factor, theirs[:, k], rtol=1e-6, atol=1e-7)


def test_the_vendors_example() -> None:
    block = feed_in_chunks(VectorNavDecoder(), bytes.fromhex("FA01080093502E42833EF13F48B504BB9288"), [5])
    assert np.rad2deg(block["yaw"][0]) == pytest.approx(43.578686)
    assert np.rad2deg(block["pitch"][0]) == pytest.approx(1.8847202)
    assert np.rad2deg(block["roll"][0]) == pytest.approx(-0.0020249, rel=1e-4)


def test_sentences_are_read_and_torn_ones_refused() -> None:
    decoder = VectorNavDecoder()
    block = feed_in_chunks(decoder, YMR + TORN + YMR, [50])
    assert len(block) == 2
    assert decoder.counters().checksum_errors == 1
    assert block["gyro_x"][0] == -1.012502
    assert block["mag_z"][0] == pytest.approx(54.79)
    assert np.rad2deg(block["yaw"][1]) == pytest.approx(-95.878)
    assert any("filter" in text and "UncompGyro" in text for text in decoder.warnings())


def test_rates_that_the_filter_has_corrected_step_back_for_those_of_the_factory() -> None:
    block = SampleBlock({"device_ticks": np.arange(1, 4) * 1000, "gyro_x": np.full(3, 0.5)})
    raw = VectorNavDecoder().encoder(["Common.TimeStartup", "Imu.UncompGyro"]).encode(block)
    corrected = VectorNavDecoder().encoder(["Common.TimeStartup", "Common.AngRate"]).encode(block)
    alone = feed_in_chunks(decoder := VectorNavDecoder(), b"".join(corrected), [99])
    np.testing.assert_array_equal(alone["gyro_x"], 0.5)
    assert decoder.warnings()
    mixed = feed_in_chunks(decoder := VectorNavDecoder(), b"".join(raw[:1] + corrected + raw[1:]), [7])
    np.testing.assert_array_equal(np.isnan(mixed["gyro_x"]), [False, True, True, True, False, False])
    np.testing.assert_array_equal(mixed["gyro_compensated_x"][1:4], 0.5)
    assert decoder.warnings() == []


def test_a_recording_of_corrected_rates_alone_is_warned_of() -> None:
    block = SampleBlock({"device_ticks": np.arange(1, 50) * 20_000_000})
    packets = VectorNavDecoder().encoder(["Common.TimeStartup", "Common.AngRate"]).encode(block)
    pipeline = Pipeline(load_device("vectornav"), [])
    pipeline.feed(b"".join(packets), 1)
    pipeline.finish()
    assert any("UncompGyro" in text for text in pipeline.warnings())
    assert pipeline.warnings() == []


@pytest.mark.parametrize(
    ("header", "names"),
    [
        ("fa14 3e00 3a00", ["UncompMag", "UncompAccel", "UncompGyro", "Temperature", "Pressure", "Ypr", "Dcm",
                            "MagNed", "AccelNed"]),
        ("fa01 0900", ["TimeStartup", "Ypr"]),
        ("fa81 10 0100 0200", ["TimeStartup", "Tow"]),
        ("fa08 0080 0400", ["AltMsl"]),
    ],
)  # fmt: skip
def test_headers(header: str, names: list[str]) -> None:
    found = read_contents(bytes.fromhex(header) + bytes(64))
    assert not isinstance(found, int)
    assert [item.name for item, *_ in found.fields] == names


@pytest.mark.parametrize("header", ["fa00", "fa01 0000", "fa02 0004", "fa8001", "fa8181", "fa08 0080 0080"])
def test_headers_that_nobody_knows(header: str) -> None:
    assert read_contents(bytes.fromhex(header) + bytes(8)) == IMPOSSIBLE


def test_accelerations_with_gravity_and_without_have_columns_of_their_own() -> None:
    with_gravity = XMODEM.sealed(bytes.fromhex("fa10 2000") + struct.pack("<3f", 0.5, 0.25, -9.5))
    without = XMODEM.sealed(bytes.fromhex("fa10 8000") + struct.pack("<3f", 0.5, 0.25, 0.125))
    line = sentence("$VNYIA,+1,+2,+3,+0.5,+0.25,+0.125,+0,+0,+0") + b"\r\n"
    block = feed_in_chunks(VectorNavDecoder(), with_gravity + without + line, [7])
    np.testing.assert_array_equal(block["accel_ned_z"], [-9.5, np.nan, np.nan])
    np.testing.assert_array_equal(block["free_accel_ned_z"], [np.nan, 0.125, 0.125])


@pytest.mark.parametrize("satellites", [0, 3, 20])
def test_fields_that_count_themselves(satellites: int) -> None:
    information = bytes([satellites, 0]) + bytes(range(8 * satellites))
    body = bytes.fromhex("08 1840") + bytes([9, 3]) + information
    packet = XMODEM.sealed(b"\xfa" + body)
    block = feed_in_chunks(VectorNavDecoder(), packet * 3, [11])
    assert block["gnss1_satellites"].tolist() == [9, 9, 9]
    assert block["gnss1_fix"].tolist() == [3, 3, 3]


def test_a_field_that_is_not_there_is_named() -> None:
    with pytest.raises(ImumonError, match=r"Imu\.Nonsense"):
        VectorNavDecoder().encoder(["Imu.Nonsense"])


def test_packets_of_the_third_receiver_are_read_between_others() -> None:
    inertial = XMODEM.sealed(bytes.fromhex("fa04 0800") + struct.pack("<3f", 1.0, 2.0, 3.0))
    third = XMODEM.sealed(bytes.fromhex("fa80 10 0800") + bytes([7]))
    both = XMODEM.sealed(bytes.fromhex("fa81 10 8000 1800") + struct.pack("<3fBB", 1.0, 2.0, 3.0, 8, 3))
    decoder = VectorNavDecoder()
    block = feed_in_chunks(decoder, (inertial + third + both) * 40, [100])
    assert decoder.counters().bytes_skipped == decoder.counters().length_errors == 0
    assert block["gnss3_satellites"][:3].tolist() == [NO_INT, 7, 8]


def test_columns_are_declared_before_the_first_packet() -> None:
    names = {column.name for column in VectorNavDecoder().possible_columns}
    assert {"gyro_x", "gyro_compensated_x", "mag_x", "temperature", "pressure", "q_w"} <= names
    assert not {"roll", "pitch"} & names


def test_every_error_of_the_device_is_reported_once() -> None:
    decoder = VectorNavDecoder()
    lines = b"".join(sentence(f"$VNERR,0{code}") + b"\r\n" for code in (3, 7, 3))
    assert len(feed_in_chunks(decoder, lines, [9])) == 0
    assert decoder.notices() == ["the device reports error 03", "the device reports error 07"]
