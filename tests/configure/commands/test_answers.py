"""Answers among data, whatever comes over the line."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.configure.core import Message, Request, family_of
from imumon.protocols.device import load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.wing import firmware_of

DEVICES = ("xsens", "microstrain", "vectornav", "witmotion")


def exchange(name: str) -> tuple[list[Request], bytes]:
    """Return all reading requests of a family, and data with the answers of a device between the packets."""
    device = load_device(name)
    family, firmware = family_of(device), firmware_of(device.protocol)(device, 100.0)
    assert firmware is not None
    requests = [family.hello, *family.quiet, *map(family.read, family.settings)]
    samples = SimulatedUnit(load_scenario("bench").played(100.0, device.axes)).samples(len(requests))
    packets = device.encoder().encode(samples)
    parts = [packet + firmware.receive(q.frame) for q, packet in zip(requests, packets, strict=True)]
    return requests, b"".join(parts) + packets[0]


STREAMS = {name: exchange(name) for name in DEVICES}


def understood(name: str, data: bytes) -> list[bytes | str]:
    """Return what a family makes of bytes as answers to its requests."""
    requests, _ = STREAMS[name]
    messages, done = family_of(load_device(name)).messages(data)
    assert 0 <= done <= len(data)
    readers = [request.answer for request in requests if request.answer is not None]
    found = [reader(message) for message in messages for reader in readers]
    return [item for item in found if item is not None]


@pytest.mark.parametrize("name", DEVICES)
def test_answers_are_found_between_packets(name: str) -> None:
    requests, data = STREAMS[name]
    messages, _ = family_of(load_device(name)).messages(data)
    for request in requests:
        assert request.answer is not None
        assert any(request.answer(message) is not None for message in messages), request.meaning


@pytest.mark.parametrize("name", DEVICES)
@pytest.mark.parametrize("size", [1, 2, 7, 64])
def test_answers_are_found_whatever_the_chunks(name: str, size: int) -> None:
    _, data = STREAMS[name]
    family, held, seen = family_of(load_device(name)), b"", list[Message]()
    for at in range(0, len(data), size):
        messages, done = family.messages(held + data[at : at + size])
        seen += [message for message in messages if message not in seen]
        held = (held + data[at : at + size])[done:]
    whole, _ = family.messages(data)
    assert {m.payload for m in whole} <= {m.payload for m in seen}


@pytest.mark.parametrize("name", DEVICES)
@settings(deadline=None)
@given(data=st.data())
def test_damaged_bytes_never_raise(name: str, data: st.DataObject) -> None:
    stream = bytearray(STREAMS[name][1])
    for _ in range(data.draw(st.integers(1, 8))):
        at = data.draw(st.integers(0, len(stream) - 1))
        kind = data.draw(st.sampled_from("xdi"))
        if kind == "x":
            stream[at] ^= data.draw(st.integers(1, 255))
        elif kind == "d" and len(stream) > 1:
            del stream[at : at + data.draw(st.integers(1, 9))]
            stream += b"\0" if not stream else b""
        else:
            stream[at:at] = data.draw(st.binary(max_size=9))
    understood(name, bytes(stream))


@pytest.mark.parametrize("name", DEVICES)
@settings(deadline=None)
@given(
    kind=st.integers(0, 255), payload=st.binary(max_size=64), letters=st.sampled_from(["RRG", "WRG", "ERR"])
)
def test_well_formed_nonsense_never_raises(name: str, kind: int, payload: bytes, letters: str) -> None:
    family = family_of(load_device(name))
    message = Message(letters if name == "vectornav" else kind, payload)
    for setting in family.settings:
        reader = family.read(setting).answer
        assert reader is not None
        found = reader(message)
        if isinstance(found, bytes):
            family.describe(setting, found)
            family.baud_of(found)
            family.settled(setting, found, found)


@pytest.mark.parametrize("name", DEVICES)
@settings(deadline=None)
@given(noise=st.binary(max_size=300))
def test_firmware_bears_any_bytes(name: str, noise: bytes) -> None:
    firmware = firmware_of(load_device(name).protocol)(load_device(name), 100.0)
    assert firmware is not None
    firmware.receive(noise)
    firmware.receive(STREAMS[name][0][0].frame)
