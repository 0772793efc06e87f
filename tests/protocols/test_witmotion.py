from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.protocols.witmotion import WitMotionDecoder
from tests.protocols.streams import feed_in_chunks

FAMILY = WitMotionDecoder()
COMBINED = bytes.fromhex("5561 d8fd3905de05 bb01ff00fbff ab0fb1ed808a 1a0616 0e2901 1903")
"""A frame of a card: 2026-06-22 14:41:01.793."""


def test_a_frame_worked_out_by_hand() -> None:
    block = feed_in_chunks(WitMotionDecoder(), bytes.fromhex("5551000000000008C4097B"), [4])
    assert block["accel_z"][0] == pytest.approx(9.80665)
    assert block["temperature"][0] == pytest.approx(25.0)


def test_frames_of_one_sample_are_one_row() -> None:
    rng = np.random.default_rng(0)
    sent = {name: rng.normal(0, 0.5, 300) for name in ("gyro_x", "accel_y", "roll", "temperature", "q_w")}
    packets = FAMILY.encoder(["accel", "gyro", "angle"]).encode(SampleBlock(sent))
    pipeline = Pipeline(load_device("witmotion"), [])
    for k, packet in enumerate(packets):
        pipeline.feed(packet, (k + 1) * 100_000_000)
    pipeline.finish()
    block = pipeline.take()
    assert len(block) == 300
    for name, step in (("gyro_x", 2000 / 32768 * np.pi / 180), ("accel_y", 9.80665 / 2048), ("roll", 1e-4)):
        assert np.abs(block[name] - sent[name]).max() <= step


def test_the_combined_form_counts_when_the_next_follows() -> None:
    decoder = WitMotionDecoder()
    block = feed_in_chunks(decoder, COMBINED * 3, [9])
    assert len(block) == 2
    assert block["accel_x"][0] / 9.80665 == pytest.approx(-0.2695, abs=1e-4)
    assert np.rad2deg(block["gyro_x"][0]) == pytest.approx(27.04, abs=0.01)
    assert np.rad2deg(block["yaw"][0]) == pytest.approx(-165.235, abs=0.01)
    moment = np.datetime64("2026-06-22T14:41:01.793")
    assert block["device_ticks"][0] == moment.astype("datetime64[ms]").astype(np.int64)
    assert decoder.counters().bytes_pending == len(COMBINED)


def test_the_short_combined_form() -> None:
    block = feed_in_chunks(WitMotionDecoder(), COMBINED[:20] * 4, [7])
    assert len(block) == 3
    assert "device_ticks" not in block


@pytest.mark.parametrize(("zeros", "said"), [(9, False), (10, True)])
def test_rates_of_exactly_zero_are_reported(zeros: int, said: bool) -> None:
    rate = np.r_[np.ones(20), np.zeros(zeros), np.ones(20)]
    decoder = WitMotionDecoder()
    for packet in FAMILY.encoder(["gyro"]).encode(SampleBlock({"gyro_z": rate})):
        decoder.feed(packet, 0)
        decoder.take()
    assert any("exactly zero" in text for text in decoder.warnings()) is said


def test_a_position_is_in_degrees() -> None:
    value = 12_030_00000  # 120 degrees, 30.00000 minutes
    body = bytes([0x55, 0x57]) + value.to_bytes(4, "little") + (-value).to_bytes(4, "little", signed=True)
    block = feed_in_chunks(WitMotionDecoder(), body + bytes([sum(body) & 0xFF]), [3])
    assert block["longitude"][0] == pytest.approx(120.5)
    assert block["latitude"][0] == pytest.approx(-120.5)


def test_a_frame_that_is_not_there_is_named() -> None:
    with pytest.raises(ImumonError, match="sonar"):
        FAMILY.encoder(["sonar"])
