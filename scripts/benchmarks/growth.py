"""How the cost of a packet grows with its bytes and its columns."""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.decoders import cut, feed_all
from benchmarks.measure import Bar, Table, measure
from benchmarks.streams import made_device
from imumon.blocks import SampleBlock

SHAPES = ((16, 1), (32, 1), (32, 10), (64, 1), (64, 12), (64, 25), (128, 1), (128, 25), (128, 55),
          (256, 1), (256, 60), (256, 120), (1024, 1), (1024, 100), (1024, 250))  # fmt: skip
CHUNK = 65_536


def run() -> tuple[list[Table], list[Bar]]:
    """Measure packets of many shapes and fit a + b * bytes + c * columns to them."""
    functions, counts = {}, {}
    for number in ("i16", "f32"):
        for length, columns in SHAPES:
            if number == "f32" and 9 + 4 * columns > length:
                continue
            device = made_device(length, columns, number)
            n = CHUNK // length
            data = b"".join(device.encoder().encode(SampleBlock({"packet_counter": np.arange(n)})))
            key = f"{number} {length} {columns}"
            functions[key] = partial(feed_all, device.decoder(), cut(data, CHUNK), False)
            counts[key] = n
    times = measure(functions)
    tables = []
    for number in ("i16", "f32"):
        shapes = [shape for shape in SHAPES if f"{number} {shape[0]} {shape[1]}" in times]
        costs = [times[key].best / counts[key] for key in (f"{number} {a} {b}" for a, b in shapes)]
        # Relative errors count, as the costs span two decades.
        model = np.array([[1, length, columns + 1] for length, columns in shapes]) / np.array(costs)[:, None]
        fixed, per_byte, per_column = np.linalg.lstsq(model, np.ones(len(costs)))[0]
        table = Table(
            f"Packets of {number} columns, 64 KiB chunks",
            ["bytes", "columns", "ns/packet", "million/s", "model ns/packet"],
        )
        for (length, columns), cost in zip(shapes, costs, strict=True):
            fitted = fixed + per_byte * length + per_column * (columns + 1)
            row = [str(length), str(columns + 1), f"{cost:.1f}", f"{1e3 / cost:.2f}", f"{fitted:.1f}"]
            table.rows.append(row)
        table.notes.append(
            f"cost of a packet = {fixed:.1f} ns + {per_byte:.3f} ns × bytes + {per_column:.2f} ns × columns "
            "(least squares of the relative error)"
        )
        tables.append(table)
    return tables, []
