"""The decoder of the 58-byte packet: from bytes to columns, by chunk size, whole and damaged."""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import partial

import numpy as np

from benchmarks.measure import Bar, Table, Time, measure, millions
from benchmarks.streams import Damaged, damage, samples
from imumon.blocks import SampleBlock, join
from imumon.protocols.device import DeviceFile, load_device
from imumon.protocols.fixed.device import FixedDevice
from imumon.protocols.framing import Decoder
from imumon.protocols.stream import ByteArray

CHUNKS = (256, 1024, 4096, 16_384, 65_536, 262_144, 1_048_576)
PACKETS = 20_000
TAKEN_AFTER = 65_536
"""As a recording is read."""
CODES = {"u8": "u1", "u16": "u2", "i16": "i2", "u32": "u4", "i32": "i4"}
STRUCT_CODES = {"u8": "B", "u16": "H", "i16": "h", "u32": "I", "i32": "i"}


def feed_all(decoder: Decoder, chunks: list[ByteArray], take: bool) -> None:
    """Feed the chunks; take the columns after each chunk, or about once in `TAKEN_AFTER` bytes."""
    waiting = 0
    for chunk in chunks:
        decoder.feed(chunk, 1)
        waiting += len(chunk)
        if take or waiting >= TAKEN_AFTER:
            decoder.take()
            waiting = 0
    decoder.take()


def cut(data: bytes, size: int) -> list[ByteArray]:
    """Cut a stream into chunks of a size, no longer than the stream."""
    whole = np.frombuffer(data, np.uint8)
    return [whole[start : start + size] for start in range(0, len(whole), size)]


def by_numpy(device: FixedDevice, data: bytes) -> Callable[[], object]:
    """Return what NumPy does for packets that are known to be whole and aligned: no search, no checksum."""
    placed = device.packet.placed()
    layout = np.dtype(
        {
            "names": [item.name for item in placed],
            "formats": [(">" if item.big else "<") + CODES[item.value.type] for item in placed],
            "offsets": [item.at for item in placed],
            "itemsize": device.packet.length,
        }
    )

    def decode() -> object:
        records = np.frombuffer(data, layout)
        return [records[item.name] * item.value.factor + item.value.offset for item in placed]

    return decode


def by_struct(device: FixedDevice, data: bytes) -> Callable[[], object]:
    """Return what a plain loop in Python does for aligned packets: no search, no checksum."""
    placed = sorted(device.packet.placed(), key=lambda item: item.at)
    code, at = ">", 0
    for item in placed:
        code += f"{item.at - at}x{STRUCT_CODES[item.value.type]}"
        at = item.at + struct.calcsize(STRUCT_CODES[item.value.type])
    code += f"{device.packet.length - at}x"
    scales = [(item.value.factor, item.value.offset) for item in placed]

    def decode() -> object:
        return [
            [raw * scale + offset for raw, (scale, offset) in zip(row, scales, strict=True)]
            for row in struct.iter_unpack(code, data)
        ]

    return decode


def decoded(device: DeviceFile, data: bytes, size: int) -> SampleBlock:
    """Return all rows of a stream fed in chunks of a size."""
    decoder, blocks = device.decoder(), []
    for chunk in cut(data, size):
        decoder.feed(chunk, 1)
        blocks.append(decoder.take())
    decoder.finish()
    return join([*blocks, decoder.take()])


def lost(device: FixedDevice, whole: SampleBlock, stream: Damaged, size: int) -> int:
    """Count the intact packets that do not come out of the damaged stream with all their values."""
    names = [name for name in whole.columns if name != "arrival_time_ns"]
    out = decoded(device, stream.data, size)
    found = set(zip(*(out[name].tolist() for name in names), strict=True))
    intact = zip(*(whole[name][stream.intact].tolist() for name in names), strict=True)
    return sum(row not in found for row in intact)


def run() -> tuple[list[Table], list[Bar]]:
    """Measure all chunk sizes on the whole and the damaged stream."""
    device = load_device("ax1")
    assert isinstance(device, FixedDevice)
    packets = device.encoder().encode(samples(PACKETS))
    data, damaged = b"".join(packets), damage(packets, seed=2)
    functions: dict[str, Callable[[], object]] = {}
    for size in CHUNKS:
        for name, stream in (("whole", data), ("damaged", damaged.data)):
            for take in (False, True):
                chunks = cut(stream, size)
                functions[f"{name} {size} {take}"] = partial(feed_all, device.decoder(), chunks, take)
    target = np.zeros(len(data), np.uint8)
    source = np.frombuffer(data, np.uint8)
    functions |= {
        "memcpy": lambda: np.copyto(target, source),
        "numpy": by_numpy(device, data),
        "struct": by_struct(device, data),
    }
    times = measure(functions)
    whole = decoded(device, data, CHUNKS[-1])
    missing = max(lost(device, whole, damaged, size) for size in CHUNKS)
    return [_references(times), *_tables(times, len(whole.columns), len(damaged.intact), missing)], _bars(
        times, missing
    )


def _references(times: dict[str, Time]) -> Table:
    table = Table("Reference work on the same packets", ["work", "ns/packet", "median", "million/s"])
    titles = {
        "memcpy": "copy the bytes",
        "numpy": "NumPy, aligned packets, no search, no checksum",
        "struct": "Python struct loop, the same",
    }
    for name, title in titles.items():
        best, middle = times[name].best / PACKETS, times[name].median / PACKETS
        table.rows.append([title, f"{best:.1f}", f"{middle:.1f}", f"{1e3 / best:.2f}"])
    return table


def _tables(times: dict[str, Time], columns: int, intact: int, missing: int) -> list[Table]:
    tables = []
    for name, packets in (("whole", PACKETS), ("damaged", intact)):
        table = Table(
            f"58-byte packet, {columns} columns, Fletcher checksum, {name} stream",
            ["chunk bytes", "feed ns/packet", "median", "million/s", "× NumPy", "× struct",
             "feed + take ns/packet", "million/s"],
        )  # fmt: skip
        for size in CHUNKS:
            feed, taken = times[f"{name} {size} False"], times[f"{name} {size} True"]
            best = feed.best / packets
            table.rows.append([
                str(size), f"{best:.1f}", f"{feed.median / packets:.1f}", f"{1e3 / best:.2f}",
                f"{times['numpy'].best / PACKETS / best:.1f}", f"{times['struct'].best / PACKETS / best:.0f}",
                f"{taken.best / packets:.1f}", f"{millions(packets, taken.best):.2f}",
            ])  # fmt: skip
        tables.append(table)
    tables[1].notes.append(
        f"1 % of the packets with a flipped bit, 0.5 % cut, 0.5 % with junk before them; {intact} of "
        f"{PACKETS} packets are intact, of these {missing} were lost at the worst chunk size."
    )
    return tables


def _bars(times: dict[str, Time], missing: int) -> list[Bar]:
    return [
        Bar("58-byte packets to columns, 64 KiB chunks, million/s", 4.0,
            millions(PACKETS, times["whole 65536 False"].best)),
        Bar("the same, and taken as arrays of their own, million/s", 2.0,
            millions(PACKETS, times["whole 65536 True"].best)),
        Bar("58-byte packets to columns, 1 KiB chunks, million/s", 2.0,
            millions(PACKETS, times["whole 1024 False"].best)),
        Bar("intact packets lost in the damaged stream", 0, missing, at_most=True, required=True),
    ]  # fmt: skip
