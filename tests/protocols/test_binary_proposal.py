"""Device files proposed for binary packets: known devices taken for unknown ones, and what is no packet."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from imumon.protocols.binary_proposal import propose
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.protocols.fixed import SeveralDevice
from imumon.simulation.unit import SimulatedUnit, load_scenario
from tests.protocols.streams import feed_in_chunks

RNG = np.random.default_rng(4)
LAYOUTS = {
    "ax1": ([0xA5, 0x5A], 58, "fletcher16-256", 2),
    "bno08x-rvc": ([0xAA, 0xAA], 19, "sum8", 2),
    "kvh1750": ([0xFE, 0x81, 0xFF, 0x55], 36, "crc32-mpeg2", 0),
    "microstrain": ([0x75, 0x65, 0x80, 0x34], 58, "fletcher16-256", 0),
    "openimu": ([0x55, 0x55], 47, "crc16-aug-ccitt", 2),
    "xsens": ([0xFA, 0xFF, 0x36, 0x5A], 95, "sum8-negated", 1),
}
"""Sync pattern, length, checksum and its first byte as the formats have them."""


def packets(name: str, n: int = 400) -> list[bytes]:
    """Return what a virtual device sends."""
    return list(load_device(name).encoder().encode(SimulatedUnit(load_scenario("bench")).samples(n)))


def damaged(stream: bytes, share: float) -> bytes:
    data = np.frombuffer(stream, np.uint8).copy()
    hit = RNG.random(len(data)) < share
    data[hit] ^= RNG.integers(1, 256, hit.sum(), dtype=np.uint8)
    return data.tobytes()


def share_framed(proposal: str, stream: bytes) -> float:
    decoder = parse_device(proposal, "proposed").decoder()
    feed_in_chunks(decoder, stream, [500])
    return decoder.counters().bytes_in_packets / len(stream)


@pytest.mark.parametrize("heard", [2500, 30_000])
@pytest.mark.parametrize("damage", [0.0, 0.01])
@pytest.mark.parametrize("name", LAYOUTS)
def test_a_device_taken_for_an_unknown_one_gets_its_layout(name: str, damage: float, heard: int) -> None:
    stream = b"".join(packets(name))[13:]
    part = damaged(stream[:heard], damage)
    proposal = propose(part, 4.0 * len(part) / len(stream), 115_200)
    assert proposal is not None
    packet = yaml.safe_load(proposal.text)["packet"]
    check = packet["checksum"]
    assert (packet["sync"], packet["length"], check["type"], check["first"]) == LAYOUTS[name]
    assert share_framed(proposal.text, stream) > 0.95


def test_counter_clock_and_unknown_bytes_are_given() -> None:
    proposal = propose(b"".join(packets("ax1")), 4.0, 115_200)
    assert proposal is not None
    data = yaml.safe_load(proposal.text)
    fields = data["packet"]["fields"]
    assert {"at": 4, "type": "u16", "column": "packet_counter"} in fields
    assert {"at": 6, "type": "u32", "column": "device_ticks", "unit": "us"} in fields
    assert data["packet"]["byte_order"] == "big"
    assert data["rate_hz"] == pytest.approx(100, rel=0.01)
    covered = [field["at"] for field in fields if field["column"].startswith("byte_")]
    assert covered == [2, 3, *range(10, 56)]
    assert "unknown: give type" in proposal.text
    assert "right in 399 of 399 packets" in proposal.text


def test_a_counter_of_one_byte_tells_nothing_of_the_order() -> None:
    text, source = device_text("ax1")
    for old, new in (
        ("byte_order: big", "byte_order: little"),
        ("type: u16, column: packet", "type: u8, column: packet"),
    ):
        assert old in text
        text = text.replace(old, new)
    sent = parse_device(text, source).encoder().encode(SimulatedUnit(load_scenario("bench")).samples(400))
    found = propose(b"".join(sent), 4.0, 115_200)
    assert found is not None
    packet = yaml.safe_load(found.text)["packet"]
    assert {"at": 4, "type": "u8", "column": "packet_counter"} in packet["fields"]
    assert packet["byte_order"] == "little"


def test_a_counter_of_seven_bits_stays_unknown() -> None:
    found = propose(b"".join(packets("kvh1750")[:400]), 4.0, 115_200)
    assert found is not None
    assert "packet_counter" not in found.text


def test_packets_of_several_lengths_get_no_proposal() -> None:
    device = load_device("kvh1750")
    assert isinstance(device, SeveralDevice)
    others = device.model_copy(update={"sends": ["b"]}).encoder()
    b = list(others.encode(SimulatedUnit(load_scenario("bench")).samples(200)))
    pairs = zip(packets("kvh1750", 200), b, strict=True)
    stream = b"".join(x + y if RNG.random() < 0.5 else y + x for x, y in pairs)
    assert propose(stream, 2.0, 921_600) is None


def test_where_no_checksum_fits_the_length_is_proposed_alone() -> None:
    stream = b"".join(packets("hipnuc"))  # its checksum is in the middle of the packet
    proposal = propose(stream, 4.0, 115_200)
    assert proposal is not None
    assert not proposal.checked
    assert "No checksum that imumon knows fits" in proposal.text
    assert yaml.safe_load(proposal.text)["packet"]["length"] == 82
    assert share_framed(proposal.text, stream) > 0.95


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(20_000),
        bytes(range(256)) * 50,
        RNG.integers(0, 256, 2048, dtype=np.uint8).tobytes(),
        RNG.integers(0, 256, 60_000, dtype=np.uint8).tobytes(),
        RNG.choice(np.array([0, 128, 255], np.uint8), 20_000).tobytes(),
    ],
    ids=["nothing", "zeros", "ramp", "noise", "long noise", "three values"],
)
def test_what_is_no_packet_gets_no_proposal(data: bytes) -> None:
    assert propose(data, 1.0, 115_200) is None


@pytest.mark.parametrize("checked", [True, False])
def test_high_bytes_of_a_counter_or_a_reading_are_no_sync(checked: bool) -> None:
    def packet(k: int) -> bytes:
        begin = b"\xeb\x90" + k.to_bytes(4, "big") + RNG.integers(0, 256, 10, dtype=np.uint8).tobytes()
        return begin + (sum(begin) & 0xFFFF if checked else 0x5555 * k & 0xFFFF).to_bytes(2, "little")

    heard, later = (b"".join(packet(k) for k in range(at, at + 200)) for at in (5, 70_000_000))
    proposal = propose(heard, 2.0, 115_200)
    assert proposal is not None
    assert proposal.checked is checked
    assert share_framed(proposal.text, later) > 0.9
