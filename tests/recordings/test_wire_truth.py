"""Whatever happens to a wire file, no read comes out with a wrong byte or time; every loss is reported."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from imumon.recordings.wire import CHECK_OP, MAGIC, MESSAGE_OP, RECORD
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.run.recovery import rewrite
from imumon.transport.reader import Bytes, Item
from tests.faults.damage import made_items, record

ITEMS = made_items(0.6, 100.0, 24, 5)


def records(whole: bytes | bytearray) -> list[tuple[int, int]]:
    """Return where each record of the data begins, and its type."""
    found, at = [], len(MAGIC)
    while at + RECORD.size <= len(whole):
        opcode, length = RECORD.unpack_from(whole, at)
        found.append((at, opcode))
        at += RECORD.size + length
    return found


def summary_of(path: Path, content: bytes | bytearray) -> tuple[list[Item], WireSummary]:
    path.write_bytes(content)
    reader = WireReader(path)
    return list(reader), reader.summary


def is_reported(summary: WireSummary) -> bool:
    damage = summary.damage
    return bool(damage.places or summary.tail_bytes or not summary.complete)


def faults_of(path: Path, contents: Iterable[tuple[str, bytes]]) -> Iterator[str]:
    """Yield what comes out wrong of damaged files: a false item, or a loss that is not reported."""
    for what, content in contents:
        items, summary = summary_of(path, content)
        if not _is_part_of(items, ITEMS):
            yield f"{what}: false or doubled items"
        # How much is missing behind the end of a file that was not finished, nothing in it can say.
        lost = len(ITEMS) - len(items)
        is_cut = items == ITEMS[: len(items)] and not summary.complete
        if lost and not is_cut and not summary.damage.messages:
            yield f"{what}: {lost} items lost, which is not reported"
        if lost and summary.complete and summary.damage.messages != lost:
            yield f"{what}: {lost} items lost, {summary.damage.messages} reported"


def _is_part_of(items: list[Item], written: list[Item]) -> bool:
    """Return whether the items are some of those written, in their order, each once."""
    left = iter(written)
    return all(any(item == one for one in left) for item in items)


@pytest.fixture(params=["closed", "killed", "recovered"])
def whole(request: pytest.FixtureRequest, tmp_path: Path) -> bytes:
    path = tmp_path / "whole.mcap"
    record(path, ITEMS, closed=request.param != "killed")
    if request.param == "recovered":
        rewrite(path)
    return path.read_bytes()


@pytest.mark.long
def test_every_bit_of_every_length(whole: bytes, tmp_path: Path) -> None:
    def flipped() -> Iterator[tuple[str, bytes]]:
        for at, opcode in records(whole):
            for bit in range(64):
                damaged = bytearray(whole)
                damaged[at + 1 + bit // 8] ^= 1 << bit % 8
                yield f"bit {bit} of the length of the record of type {opcode} at {at}", bytes(damaged)

    path = tmp_path / "w.mcap"
    assert not [*faults_of(path, flipped())]


def test_random_bits(whole: bytes, tmp_path: Path) -> None:
    rng = np.random.default_rng(11)

    def flipped() -> Iterator[tuple[str, bytes]]:
        for at in rng.integers(len(whole), size=1000).tolist():
            damaged = bytearray(whole)
            damaged[at] ^= 1 << int(rng.integers(8))
            yield f"a bit of byte {at}", bytes(damaged)

    path = tmp_path / "w.mcap"
    assert not [*faults_of(path, flipped())]


def test_cuts_and_doublings_at_every_record(whole: bytes, tmp_path: Path) -> None:
    """The end cut off, pieces cut out and pieces that are there twice, of one record and of many."""
    starts = [at for at, _ in records(whole)]

    def changed() -> Iterator[tuple[str, bytes]]:
        for at in starts:
            yield f"cut at {at}", whole[:at]
        for count in (1, 7, 40):
            for begin, end in zip(starts, starts[count:], strict=False):
                yield f"{begin} to {end} cut out", whole[:begin] + whole[end:]
                yield f"{begin} to {end} twice", whole[:end] + whole[begin:]

    path = tmp_path / "w.mcap"
    assert not [*faults_of(path, changed())]


def test_a_doubled_piece_loses_at_most_the_block_that_it_was_put_into(whole: bytes, tmp_path: Path) -> None:
    checks = [at for at, opcode in records(whole) if opcode == CHECK_OP]
    for begin, end in zip(checks, checks[3:], strict=False):
        items, summary = summary_of(tmp_path / "w.mcap", whole[:end] + whole[begin:])
        assert len(ITEMS) - len(items) <= 11
        assert is_reported(summary)


def test_a_recovered_file_still_reports_what_was_lost_and_when(tmp_path: Path) -> None:
    path = tmp_path / "w.mcap"
    record(path, ITEMS, closed=True)
    damaged = bytearray(path.read_bytes())
    messages = [at for at, opcode in records(damaged) if opcode == MESSAGE_OP]
    damaged[messages[50] + 3] ^= 2
    items, before = summary_of(path, damaged)
    assert before.damage.messages == len(ITEMS) - len(items) > 0
    rewrite(path)
    reader = WireReader(path)
    assert list(reader) == items
    after = reader.summary
    assert after.complete
    assert after.checksum_ok
    assert after.damage.messages == before.damage.messages
    assert after.damage.seconds == pytest.approx(before.damage.seconds, abs=0.02)
    assert after.bytes == sum(len(item.data) for item in items if isinstance(item, Bytes))
    assert after.bytes_unrecorded == 0
