"""Against other programs, in one process on the same data: decoding, Allan deviation, gyro bias, files."""

from __future__ import annotations

from benchmarks import race_allan, race_bias, race_decoders, race_files
from benchmarks.measure import Bar, Table


def run() -> tuple[list[Table], list[Bar]]:
    """Run all four; nothing here is a bar, as a row says itself who is better."""
    return [race_decoders.table(), race_allan.table(), race_bias.table(), race_files.table()], []
