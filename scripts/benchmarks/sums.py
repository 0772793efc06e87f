"""Every checksum over the bytes of a 58-byte packet, as the decoder calls them."""

from __future__ import annotations

from functools import partial

import numpy as np
from numba import njit

from benchmarks.measure import Bar, Table, measure
from imumon.protocols.checksums import CHECKSUM_NAMES, Checksum, checksum, make_checksum
from imumon.protocols.stream import ByteArray

LENGTHS = (16, 58, 255)
BYTES = 16_384


@njit(nogil=True)
def over_packets(check: Checksum, buf: ByteArray, length: int) -> np.int64:
    """Add up the checksums of packets that lie one behind the other."""
    total = np.int64(0)
    for start in range(0, len(buf) - length + 1, length):
        total += checksum(check, buf, start, start + length)
    return total


def run() -> tuple[list[Table], list[Bar]]:
    """Measure all checksums at three lengths."""
    buf = np.random.default_rng(0).integers(0, 256, BYTES, np.uint8)
    functions = {}
    for name in CHECKSUM_NAMES:
        check = make_checksum(name)
        for length in LENGTHS:
            functions[f"{name} {length}"] = partial(over_packets, check, buf, length)
    times = measure(functions)
    table = Table("Checksums, ns by bytes covered", ["checksum", *map(str, LENGTHS), "ns/byte beyond 58"])
    for name in CHECKSUM_NAMES:
        if name != "none":
            costs = [times[f"{name} {length}"].best / (BYTES // length) for length in LENGTHS]
            slope = (costs[2] - costs[1]) / (LENGTHS[2] - LENGTHS[1])
            table.rows.append([name, *(f"{cost:.1f}" for cost in costs), f"{slope:.2f}"])
    return [table], []
