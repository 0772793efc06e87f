"""Streams of packets as devices send them, whole and damaged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock
from imumon.protocols.device import DeviceFile, parse_device

FLIPS, CUTS, JUNK = 0.01, 0.005, 0.005
"""Shares of packets with a flipped bit, of packets cut short, and of packets with junk before them."""
LONGEST_JUNK = 60


@dataclass(frozen=True)
class Damaged:
    """A damaged stream, and the packet counters of the packets that are whole in it."""

    data: bytes
    intact: ColumnArray


def samples(n: int, seed: int = 1) -> SampleBlock:
    """Return n samples of an AHRS: random, so that no checksum or branch has an easy case."""
    random = np.random.default_rng(seed)
    columns: dict[str, ColumnArray] = {
        f"{name}_{axis}": random.normal(size=n) for name in ("gyro", "accel", "mag") for axis in "xyz"
    }
    for name in ("roll", "pitch"):
        columns[name] = random.uniform(-1, 1, n)
    columns["yaw"] = random.uniform(0, 3, n)
    for axis in "xyz":
        columns[f"temperature_{axis}"] = random.uniform(20, 60, n)
    columns["supply_voltage"] = random.uniform(4, 6, n)
    columns["packet_counter"] = np.arange(n)
    columns["device_ticks"] = np.arange(n) * 10_000
    return SampleBlock(columns)


def damage(packets: list[bytes], seed: int) -> Damaged:
    """Flip a bit, cut bytes out of the middle, or put junk before; the packet number is its counter."""
    random = np.random.default_rng(seed)
    stream, intact = bytearray(), []
    for number, packet in enumerate(packets):
        draw, changed = random.random(), bytearray(packet)
        if draw < FLIPS:
            changed[random.integers(len(changed))] ^= 1 << int(random.integers(8))
        elif draw < FLIPS + CUTS:
            start = int(random.integers(len(changed)))
            del changed[start : start + int(random.integers(1, len(changed)))]
        else:
            intact.append(number)
            if draw < FLIPS + CUTS + JUNK:
                stream += random.bytes(int(random.integers(1, LONGEST_JUNK)))
        stream += changed
    return Damaged(bytes(stream), np.array(intact))


def made_device(
    length: int, columns: int, number: str = "i16", checksum: str = "fletcher16-256"
) -> DeviceFile:
    """Return a device with a packet of this length and this many columns of one type."""
    size = {"i16": 2, "i32": 4, "f32": 4}[number]
    names = ", ".join(f"extra_{i}" for i in range(columns))
    assert 5 + size * columns <= length - 4
    text = f"""
format: imumon-device/1
name: made
title: a packet for measuring
protocol: fixed
axes: FLU
packet:
  length: {length}
  byte_order: big
  sync: [0xA5, 0x5A]
  checksum: {{type: {checksum}, first: 2, last: {length - 5}, at: {length - 4}}}
  fields:
    - {{at: 3, type: u16, column: packet_counter}}
    - {{at: 5, type: {number}, columns: [{names}], scale: 0.01, unit: V}}
"""
    return parse_device(text, "made.yaml")
