"""Bytes that make a decoder search again and again: what a call costs must grow as its bytes do."""

from __future__ import annotations

import gc
import time
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from imumon.blocks import SampleBlock
from imumon.protocols.device import DeviceFile, device_names, load_device
from tests.faults.rows import Row

SIZE = 10_000
FACTOR = 4
STEEPEST = 2.2 * FACTOR
"""Linear cost gives 4, quadratic 16; caches and a busy machine are between."""
NOISE_S = 0.004
"""A call that takes less is not measured well enough to be judged, and costs nobody anything."""


def sample_packet(device: DeviceFile) -> bytes:
    """Return what the device sends for one sample."""
    sent = device.encoder().encode(SampleBlock({"packet_counter": np.arange(2)}))
    return b"".join(sent)[: max(len(sent[0]), 4)]


def hostile_streams(packet: bytes) -> dict[str, Callable[[int], bytes]]:
    """Return makers of streams of a length: heads without ends, lengths that lie, ends without heads."""
    rng = np.random.default_rng(0)
    noise = rng.bytes(FACTOR * SIZE)

    def repeated(unit: bytes) -> Callable[[int], bytes]:
        return lambda size: (unit * (size // max(1, len(unit)) + 1))[:size]

    streams = {f"the first {n} bytes over and over": repeated(packet[:n]) for n in (1, 2, 3, 4, 6, 8, 12)}
    streams |= {f"byte {value:#04x}": repeated(bytes([value])) for value in (0x00, 0x20, 0x2C, 0xFF)}
    for n in (2, 3, 4, 5):
        streams[f"{n} bytes of a head, then 0xff"] = repeated(packet[:n] + b"\xff" * 4)
        streams[f"{n} bytes of a head, then 0xff to the end"] = (
            lambda size, n=n: (packet[:n] * 50 + b"\xff" * size)[:size]  # type: ignore[misc]
        )
    broken = bytearray(packet)
    broken[-1] ^= 0xFF
    streams["packets whose last byte is wrong"] = repeated(bytes(broken))
    streams["packets cut in half"] = repeated(packet[: len(packet) // 2 + 1])
    streams["random bytes"] = lambda size: noise[:size]
    streams["heads among random bytes"] = repeated(packet[:3] + noise[:5] + packet[:4] + noise[9:16])
    return streams


def seconds_of(device: DeviceFile, data: bytes, repeats: int = 3) -> float:
    """Return the least processor time that one call with these bytes takes, of its own thread: those that
    earlier tests left in the process work beside it."""
    best = np.inf
    gc.disable()  # it looks at all that the process has, more often the longer the call
    for _ in range(repeats):
        decoder = device.decoder()
        began = time.thread_time()
        decoder.feed(data, 0)
        decoder.finish()
        decoder.take()
        decoder.notices()
        best = min(best, time.thread_time() - began)
    gc.enable()
    return float(best)


def growth(device: DeviceFile) -> Iterator[tuple[str, float, float]]:
    """Yield each stream with the time of the longer call, and how many times that of the shorter it is."""
    packet = sample_packet(device)
    seconds_of(device, packet * 3)  # compiles
    gc.collect()  # once: in a large process each takes longer than what is measured
    for name, make in hostile_streams(packet).items():
        long = seconds_of(device, make(FACTOR * SIZE), repeats=1)
        if long < NOISE_S:
            yield name, long, 1.0
            continue
        long = min(long, seconds_of(device, make(FACTOR * SIZE)))
        yield name, long, long / max(seconds_of(device, make(SIZE)), 1e-6)


def measure_all(names: Sequence[str] | None = None) -> Iterator[Row]:
    """Measure these devices, or every one that is known."""
    for name in names or device_names():
        measured = list(growth(load_device(name)))
        slowest = max(measured, key=lambda item: item[1])
        steepest = max(measured, key=lambda item: item[2])
        yield Row(
            f"{name}: heads without ends, lengths that lie, {FACTOR * SIZE // 1000} kB in one call",
            len(measured),
            f"at most {slowest[1] * 1e3:.1f} ms ({slowest[0]}); {FACTOR} x the bytes cost at most"
            f" {steepest[2]:.1f} x",
            held=steepest[2] <= STEEPEST,
        )
