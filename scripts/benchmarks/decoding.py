"""From bytes to columns: the 58-byte packet by chunk size, every device, and the pipeline without stages."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from benchmarks.measure import Bar, Result, Table, measure
from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.pipeline import Digest, Pipeline
from imumon.protocols.base import ByteArray
from imumon.protocols.decoder import Decoder
from imumon.protocols.device import DeviceFile, device_names, load_device
from imumon.protocols.fixed import FixedDevice

CHUNKS = (256, 1024, 4096, 65_536, 1_048_576)
CHUNK = 65_536
"""As a recording is read: the columns are taken about once in so many bytes."""
PACKETS, PACKETS_OF_DEVICE, PACKETS_OF_PIPELINE = 20_000, 4000, 6000
CODES = {"u8": "u1", "u16": "u2", "i16": "i2", "u32": "u4", "i32": "i4"}
FLIPS, CUTS, JUNK = 0.01, 0.005, 0.005
"""Shares of packets with a flipped bit, of packets cut short, and of packets with junk before them."""
LONGEST_JUNK = 60
LIVE_BYTES, LIVE_TAKE = 100, 5
"""Live at 100 Hz: reads of about 100 bytes; five of them are 80 ms."""
NS_PER_BYTE = 10_000_000 / 58


@dataclass(frozen=True)
class Damaged:
    """A damaged stream, and how many packets are whole in it."""

    data: bytes
    intact: int


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


def damage(packets: list[bytes], seed: int) -> Damaged:
    """Flip a bit, cut bytes out of the middle, or put junk before."""
    random = np.random.default_rng(seed)
    stream, intact = bytearray(), 0
    for packet in packets:
        draw, changed = random.random(), bytearray(packet)
        if draw < FLIPS:
            changed[random.integers(len(changed))] ^= 1 << int(random.integers(8))
        elif draw < FLIPS + CUTS:
            start = int(random.integers(len(changed)))
            del changed[start : start + int(random.integers(1, len(changed)))]
        else:
            intact += 1
            if draw < FLIPS + CUTS + JUNK:
                stream += random.bytes(int(random.integers(1, LONGEST_JUNK)))
        stream += changed
    return Damaged(bytes(stream), intact)


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
    """Measure all chunk sizes on the whole and the damaged stream."""
    device = load_device("ax1")
    assert isinstance(device, FixedDevice)
    packets = device.encoder().encode(samples(PACKETS))
    data, damaged = b"".join(packets), damage(packets, seed=2)
    source, target = np.frombuffer(data, np.uint8), np.zeros(len(data), np.uint8)
    functions: dict[str, Callable[[], object]] = {
        "copy the bytes": lambda: np.copyto(target, source),
        "NumPy, aligned packets, no search, no checksum": by_numpy(device, data),
    }
    references = list(functions)
    for size in CHUNKS:
        functions[f"whole {size}"] = partial(feed_all, device.decoder(), cut(data, size), False)
        functions[f"taken {size}"] = partial(feed_all, device.decoder(), cut(data, size), True)
        functions[f"damaged {size}"] = partial(feed_all, device.decoder(), cut(damaged.data, size), False)
    ns = {name: time / PACKETS for name, time in measure(functions).items()}
    reference = Table("Reference work on the same packets", ["work", "ns/packet"])
    reference.rows = [[name, f"{ns[name]:.1f}"] for name in references]
    table = Table(
        f"58-byte packet, {len(device.decoder().columns)} columns, Fletcher checksum",
        ["chunk bytes", "feed ns/packet", "million/s", "× NumPy", "feed + take ns/packet", "damaged"],
    )
    for size in CHUNKS:
        feed, taken = ns[f"whole {size}"], ns[f"taken {size}"]
        hurt = ns[f"damaged {size}"] * PACKETS / damaged.intact
        row = [f"{feed:.1f}", f"{1e3 / feed:.2f}", f"{ns[references[1]] / feed:.1f}", f"{taken:.1f}"]
        table.rows.append([str(size), *row, f"{hurt:.1f}"])
    table.notes = [
        "Damaged: 1 % of the packets with a flipped bit, 0.5 % cut, 0.5 % with junk before them; "
        f"{damaged.intact} of {PACKETS} are intact."
    ]
    return [reference, table], [
        Bar("58-byte packets to columns, 64 KiB chunks, million/s", 4.0, 1e3 / ns["whole 65536"]),
        Bar("the same, and taken as arrays of their own, million/s", 2.0, 1e3 / ns["taken 65536"]),
        Bar("58-byte packets to columns, 1 KiB chunks, million/s", 2.0, 1e3 / ns["whole 1024"]),
    ]


def devices() -> Result:
    """Measure the devices that come with imumon, in 64 KiB chunks, whole and damaged."""
    functions, facts = {}, {}
    for name in device_names():
        device = load_device(name)
        packets = device.encoder().encode(samples(PACKETS_OF_DEVICE))
        for kind, data in (("whole", b"".join(packets)), ("damaged", damage(packets, 3).data)):
            decoder = device.decoder()
            functions[f"{name} {kind}"] = partial(feed_all, decoder, cut(data, CHUNK), False)
            functions[f"{name} {kind}"]()
            length = sum(map(len, packets)) / PACKETS_OF_DEVICE
            facts[name] = [f"{length:.0f}", str(len(decoder.columns))]
    ns = {name: time / PACKETS_OF_DEVICE for name, time in measure(functions).items()}
    heads = ["device", "bytes", "columns", "ns/packet", "million/s", "damaged ns/packet"]
    table = Table("Every device, 64 KiB chunks", heads)
    for name, fact in facts.items():
        whole, damaged = ns[f"{name} whole"], ns[f"{name} damaged"]
        table.rows.append([name, *fact, f"{whole:.1f}", f"{1e3 / whole:.2f}", f"{damaged:.1f}"])
    return [table], []


def pipeline() -> Result:
    """Measure decoder and clocks on one minute at 100 Hz, making the pipeline and its arrays included."""
    device = load_device("ax1")
    data = b"".join(device.encoder().encode(samples(PACKETS_OF_PIPELINE)))

    def through(size: int, every: int, digest: bool) -> None:
        path, fingerprint = Pipeline(device), Digest()
        for number, start in enumerate(range(0, len(data), size), 1):
            path.feed(data[start : start + size], int((start + size) * NS_PER_BYTE))
            if number % every == 0 and digest:
                fingerprint.update(path.take())
            elif number % every == 0:
                path.take()
        path.finish()
        fingerprint.update(path.take())

    functions = {
        "live: 100-byte reads, taken every 80 ms": partial(through, LIVE_BYTES, LIVE_TAKE, False),
        "bulk: 64 KiB reads, taken after each": partial(through, CHUNK, 1, False),
        "bulk with Digest": partial(through, CHUNK, 1, True),
    }
    table = Table("Decoder and clocks, 58-byte packet", ["way", "ns/packet", "share of a core at 100 Hz"])
    for name, time in measure(functions).items():
        cost = time / PACKETS_OF_PIPELINE
        table.rows.append([name, f"{cost:.0f}", f"{cost * 100 / 1e9:.4%}"])
    return [table], []
