"""From bytes to columns: the 58-byte packet by chunk size, and every device, whole and damaged."""

from collections.abc import Callable
from functools import partial

import numpy as np
from study import Cells, Table

from benchmarks.measure import Bar, Result, measure
from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.protocols.base import ByteArray
from imumon.protocols.decoder import Decoder
from imumon.protocols.device import DeviceFile, device_names, load_device
from imumon.protocols.fixed import FixedDevice
from imumon.protocols.text import TextDevice

CHUNKS = (256, 1024, 4096, 65_536, 1_048_576)
CHUNK = 65_536
"""As a recording is read: the columns are taken about once in so many bytes."""
PACKETS, PACKETS_OF_DEVICE = 20_000, 4000
CODES = {"u8": "u1", "u16": "u2", "i16": "i2", "u32": "u4", "i32": "i4"}
FLIPS, CUTS, JUNK = 0.01, 0.005, 0.005
"""Shares of packets with a flipped bit, of packets cut short, and of packets with junk before them."""
LONGEST_JUNK = 60


def samples(n: int) -> SampleBlock:
    """Return n samples of an AHRS: random, so that no checksum or branch has an easy case."""
    random = np.random.default_rng(1)
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


def damage(packets: list[bytes], seed: int) -> bytes:
    """Flip a bit, cut bytes out of the middle, or put junk before."""
    random = np.random.default_rng(seed)
    stream = bytearray()
    for packet in packets:
        draw, changed = random.random(), bytearray(packet)
        if draw < FLIPS:
            changed[random.integers(len(changed))] ^= 1 << int(random.integers(8))
        elif draw < FLIPS + CUTS:
            start = int(random.integers(len(changed)))
            del changed[start : start + int(random.integers(1, len(changed)))]
        elif draw < FLIPS + CUTS + JUNK:
            stream += random.bytes(int(random.integers(1, LONGEST_JUNK)))
        stream += changed
    return bytes(stream)


def feed_all(decoder: Decoder, chunks: list[ByteArray], take: bool) -> None:
    """Feed the chunks; take the columns after each chunk, or about once in `CHUNK` bytes."""
    waiting = 0
    for chunk in chunks:
        decoder.feed(chunk, 1)
        waiting += len(chunk)
        if take or waiting >= CHUNK:
            decoder.take()
            waiting = 0
    decoder.take()


def cut(data: bytes, size: int) -> list[ByteArray]:
    """Cut a stream into chunks of a size, no longer than the stream."""
    whole = np.frombuffer(data, np.uint8)
    return [whole[start : start + size] for start in range(0, len(whole), size)]


def by_numpy(device: FixedDevice, data: bytes) -> Callable[[], object]:
    """Return what NumPy does for packets that are known to be whole and aligned: no search, no checksum."""
    placed = device.packet.numbers
    layout = np.dtype(
        {
            "names": [item.name for item in placed],
            "formats": [(">" if item.big else "<") + CODES[item.type] for item in placed],
            "offsets": [item.at for item in placed],
            "itemsize": device.packet.length,
        }
    )

    def decode() -> object:
        records = np.frombuffer(data, layout)
        return [records[item.name] * item.factor + item.offset for item in placed]

    return decode


def decoded(device: DeviceFile, data: bytes, size: int) -> SampleBlock:
    """Return all rows of a stream fed in chunks of a size."""
    decoder, blocks = device.decoder(), []
    for chunk in cut(data, size):
        decoder.feed(chunk, 1)
        blocks.append(decoder.take())
    decoder.finish()
    return join([*blocks, decoder.take()])


def chunks() -> Result:
    """Measure all chunk sizes."""
    device = load_device("ax1")
    assert isinstance(device, FixedDevice)
    data = b"".join(device.encoder().encode(samples(PACKETS)))
    functions: dict[str, Callable[[], object]] = {"NumPy": by_numpy(device, data)}
    for size in CHUNKS:
        functions[f"whole {size}"] = partial(feed_all, device.decoder(), cut(data, size), False)
        functions[f"taken {size}"] = partial(feed_all, device.decoder(), cut(data, size), True)
    ns = {name: time / PACKETS for name, time in measure(functions).items()}
    times = [(size, ns[f"whole {size}"], ns[f"taken {size}"]) for size in CHUNKS]
    rows: list[Cells] = [[size, feed, 1e3 / feed, ns["NumPy"] / feed, taken] for size, feed, taken in times]
    heads = ["chunk bytes", "feed ns/packet", "million/s", "× NumPy", "feed + take ns/packet"]
    title = f"## 58-byte packet, {len(device.decoder().columns)} columns, Fletcher checksum"
    note = f"NumPy, aligned packets, no search, no checksum: {ns['NumPy']:.1f} ns/packet."
    return [Table(title, heads, rows, note, ("", ".1f", ".2f", ".1f", ".1f"))], []


def devices() -> Result:
    """Measure the devices that come with imumon, in 64 KiB chunks, whole and damaged."""
    functions, facts = {}, {}
    for name in device_names():
        device = load_device(name)
        packets = device.encoder().encode(samples(PACKETS_OF_DEVICE))
        for kind, data in (("whole", b"".join(packets)), ("damaged", damage(packets, 3))):
            decoder = device.decoder()
            functions[f"{name} {kind}"] = partial(feed_all, decoder, cut(data, CHUNK), False)
            functions[f"{name} {kind}"]()
            facts[name] = [sum(map(len, packets)) / PACKETS_OF_DEVICE, len(decoder.columns)]
    ns = {name: time / PACKETS_OF_DEVICE for name, time in measure(functions).items()}
    rows: list[Cells] = []
    for name, fact in facts.items():
        whole, damaged = ns[f"{name} whole"], ns[f"{name} damaged"]
        rows.append([name, *fact, whole, 1e3 / whole, damaged])
    heads = ["device", "bytes", "columns", "ns/packet", "million/s", "damaged ns/packet"]
    note = "Damaged: 1 % of the packets with a flipped bit, 0.5 % cut, 0.5 % with junk before them."
    formats = ("", ".0f", "", ".1f", ".2f", ".1f")
    slowest = max(ns[f"{name} whole"] for name in facts if not isinstance(load_device(name), TextDevice))
    bar = Bar("slowest binary packet, ns", 1000.0, slowest, at_most=True)
    return [Table("## Every device, 64 KiB chunks", heads, rows, note, formats)], [bar]
