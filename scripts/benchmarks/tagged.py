"""Decoders of all devices, in 64 KiB chunks, with what each device file sends."""

from __future__ import annotations

from functools import partial

from benchmarks.decoders import cut, feed_all
from benchmarks.measure import Bar, Table, measure
from benchmarks.streams import damage, samples
from imumon.protocols.device import device_names, load_device

DEVICES = tuple(device_names())
CHUNK = 65_536
PACKETS = 4000


def run() -> tuple[list[Table], list[Bar]]:
    """Measure the devices that come with imumon, whole and damaged."""
    functions, lengths, columns = {}, {}, {}
    for name in DEVICES:
        device = load_device(name)
        packets = device.encoder().encode(samples(PACKETS))
        lengths[name] = sum(map(len, packets)) / PACKETS
        for kind, data in (("whole", b"".join(packets)), ("damaged", damage(packets, 3).data)):
            decoder = device.decoder()
            functions[f"{name} {kind}"] = partial(feed_all, decoder, cut(data, CHUNK), False)
            functions[f"{name} {kind}"]()
            columns[name] = len(decoder.columns)
    times = measure(functions)
    table = Table(
        "Every device, 64 KiB chunks",
        ["device", "bytes", "columns", "ns/packet", "median", "million/s", "damaged ns/packet"],
    )
    for name in DEVICES:
        whole, damaged = times[f"{name} whole"], times[f"{name} damaged"]
        best = whole.best / PACKETS
        table.rows.append([
            name, f"{lengths[name]:.0f}", str(columns[name]), f"{best:.1f}", f"{whole.median / PACKETS:.1f}",
            f"{1e3 / best:.2f}", f"{damaged.best / PACKETS:.1f}",
        ])  # fmt: skip
    return [table], []
