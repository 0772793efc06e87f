"""Described packets that are found by frames, and devices that need no more than a description."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.decoder import Decoder
from imumon.protocols.device import load_device, parse_device
from tests.protocols.streams import feed_in_chunks
from tests.protocols.test_device import complaint

KVH = [
    "FE81FF55 37A96A6E 38586C1F B75BF862 BF803E78 BB650D28 3B0A37AC 773D0028 4BFA34D8",
    "FE81FF55 3B041F78 B9B96613 BA234B38 BB7C0410 B8DEF480 3F7F4B7B 701F001D F12FB6EE",
    "FE81FF55 B3D0BBE7 32193EF4 30AC19A5 BA8F78D6 3A290594 3F7ECBD4 7768001D ADC5F651",
    "FE81FF55 B46B86C6 B44F5B83 B4106D09 BB713CB7 BBABD914 3F7E319A 7769001D 95BBDB4F",
]
"""Frames of the manual and of drivers; the checksum of the last is wrong."""

TWO = """\
format: imumon-device/1
name: two
title: two
protocol: fixed-several
axes: FLU
packets:
  - name: fast
    length: 6
    byte_order: little
    sync: [0x11]
    checksum: {type: sum16-words-le, first: 0, last: 3, at: 4}
    tail: [0x0D, 0x0A]
    fields:
      - {at: 1, type: u8, column: packet_counter}
      - {at: 2, type: i16, column: gyro_x, scale: 0.01, unit: deg/s}
  - name: slow
    length: 8
    byte_order: big
    sync: [0x22]
    checksum: {type: crc32-mpeg2, first: 0, last: 3, at: 4, zeros: 3}
    fields:
      - {at: 1, type: u8, column: packet_counter}
      - at: 2
        type: i16
        column: temperature
        scale: 0.01
        unit: degC
        when: {column: packet_counter, modulo: 2, equals: 0}
      - at: 2
        type: i16
        column: supply
        scale: 0.01
        unit: V
        when: {column: packet_counter, modulo: 2, equals: 1}
sends: [fast, slow]
"""


def test_kvh_frames_of_manual_and_drivers() -> None:
    decoder = load_device("kvh1750").decoder()
    block = feed_in_chunks(decoder, bytes.fromhex("".join(KVH)), [9])
    assert decoder.counters().packets_by_type == {"a": 3}
    assert decoder.counters().checksum_errors == 1
    np.testing.assert_allclose(block["gyro_x"], [2.0195930e-2, 2.0160358, -9.7199340e-5], rtol=1e-7)
    assert block["accel_x"][0] / STANDARD_GRAVITY == pytest.approx(-1.0019064)
    assert block["packet_counter"].tolist() == [61, 31, 104]
    assert block["status"].tolist() == [0x77, 0x70, 0x77]
    assert block["temperature"].tolist() == [40, 29, 29]


def test_kvh_format_c_sends_temperature_and_field_by_turns() -> None:
    device = load_device("kvh1750").model_copy(update={"sends": ["c"]})
    n = np.arange(8)
    sent = {
        "packet_counter": n,
        "temperature": 20.0 + n,
        "mag_x": 1.0 + n,
        "mag_y": 2.0 + n,
        "mag_z": 3.0 + n,
    }
    block = feed_in_chunks(device.decoder(), b"".join(device.encoder().encode(SampleBlock(sent))), [13])
    for turn, name in enumerate(("temperature", "mag_x", "mag_y", "mag_z")):
        there = n % 4 == turn
        np.testing.assert_allclose(block[name], np.where(there, sent[name], np.nan), rtol=1e-6)


def test_a_frame_of_a_bno08x() -> None:
    decoder = load_device("bno08x-rvc").decoder()
    block = feed_in_chunks(decoder, bytes.fromhex("AAAADE010092FF25088DFEECFFD103000000E7"), [4])
    np.testing.assert_allclose(
        [np.rad2deg(block[c][0]) for c in ("yaw", "pitch", "roll")], [0.01, -1.10, 20.85]
    )
    # The maker's document rounds the factor.
    np.testing.assert_allclose(
        [block[f"accel_{c}"][0] for c in "xyz"], [-3.63849, -0.19613, 9.57838], rtol=3e-4
    )
    assert block["packet_counter"].tolist() == [0xDE]


@pytest.mark.parametrize("chunk", [1, 5, 1000])
def test_several_packets_with_tails_zeros_and_turns(chunk: int) -> None:
    device = parse_device(TWO, "two.yaml")
    n = np.arange(6)
    sent = {"packet_counter": n, "gyro_x": 0.01 * n, "temperature": 20.0 + n, "supply": 3.0 + n}
    packets = device.encoder().encode(SampleBlock(sent))
    assert {len(packet) for packet in packets} == {16}
    decoder = device.decoder()
    assert isinstance(decoder, Decoder)
    block = feed_in_chunks(decoder, b"\x11\x22" + b"".join(packets) + packets[0][:6], [chunk])
    assert decoder.counters().packets_by_type == {"fast": 7, "slow": 6}
    assert decoder.counters().bytes_skipped == 2
    np.testing.assert_allclose(block["gyro_x"][0:12:2], sent["gyro_x"], atol=1e-4)
    np.testing.assert_allclose(block["temperature"][1:12:2], np.where(n % 2 == 0, 20.0 + n, np.nan))
    np.testing.assert_allclose(block["supply"][1:12:2], np.where(n % 2, 3.0 + n, np.nan))


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("name: slow", "name: fast", "each needs a name of its own"),
        ("sends: [fast, slow]", "sends: [quick]", "no packet quick"),
        ("column: packet_counter, modulo: 2", "column: counter, modulo: 2", "no column counter"),
    ],
)
def test_a_wrong_description_is_refused(old: str, new: str, words: str) -> None:
    assert old in TWO
    assert words in complaint(TWO.replace(old, new))
