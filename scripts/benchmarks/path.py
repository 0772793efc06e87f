"""The whole path from bytes to dated samples, as live and as over a recording, and the fingerprint."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.measure import Bar, Table, measure
from benchmarks.streams import samples
from imumon.pipeline import Digest, Pipeline
from imumon.protocols.device import DeviceFile, load_device

PACKETS = 6000
LIVE_BYTES, LIVE_TAKE = 100, 5
"""Live at 100 Hz: reads of about 100 bytes; five of them are 80 ms."""
BULK_BYTES = 65_536
NS_PER_BYTE = 10_000_000 / 58


def through(device: DeviceFile, data: bytes, size: int, every: int, digest: bool) -> None:
    """Run a new pipeline over the stream in chunks of a size, and take after every so many."""
    pipeline, fingerprint = Pipeline(device), Digest()
    for number, start in enumerate(range(0, len(data), size)):
        pipeline.feed(data[start : start + size], int((start + size) * NS_PER_BYTE))
        if number % every == every - 1:
            block = pipeline.take()
            if digest:
                fingerprint.update(block)
    pipeline.finish()
    block = pipeline.take()
    if digest:
        fingerprint.update(block)
        fingerprint.hexdigest()


def run() -> tuple[list[Table], list[Bar]]:
    """Measure the pipeline without estimators on one minute at 100 Hz."""
    device = load_device("ax1")
    data = b"".join(device.encoder().encode(samples(PACKETS)))
    functions: dict[str, Callable[[], object]] = {
        "live: 100-byte reads, taken every 80 ms": lambda: through(
            device, data, LIVE_BYTES, LIVE_TAKE, False
        ),
        "bulk: 64 KiB reads, taken after each": lambda: through(device, data, BULK_BYTES, 1, False),
        "bulk with Digest": lambda: through(device, data, BULK_BYTES, 1, True),
    }
    times = measure(functions)
    table = Table(
        "Pipeline of decoder and clocks, 58-byte packet",
        ["way", "ns/packet", "median", "share of a core at 100 Hz"],
    )
    for name, time in times.items():
        cost = time.best / PACKETS
        table.rows.append([name, f"{cost:.0f}", f"{time.median / PACKETS:.0f}", f"{cost * 100 / 1e9:.4%}"])
    table.notes.append("making the pipeline and its arrays is included")
    return [table], []
