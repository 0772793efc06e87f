"""Damage inside a wire file: what is lost of it, and whether it is told."""

from __future__ import annotations

from bisect import bisect_right
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imumon.config import dump_yaml
from imumon.errors import ImumonError
from imumon.files import write_text
from imumon.protocols.device import device_text
from imumon.recordings.folder import METADATA_NAME, SessionMetadata, read_metadata
from imumon.recordings.wire import CHECK_SIZE, MARKER, RECORD, WIRE_CHANNEL, WireWriter
from imumon.recordings.wire_reader import WireReader, WireSummary
from imumon.transport.reader import Bytes, Event, EventKind, Item
from tests.faults.rows import Row

Attack = Callable[[bytearray, np.random.Generator], None]
SECTOR = 4096
START_NS = 1_700_000_000_000_000_000
FLUSH_NS = 100_000_000


def made_items(seconds: float, rate_hz: float, packet: int, seed: int) -> list[Item]:
    """Return what a port gave: packets of random bytes, each read by itself, and some events."""
    rng = np.random.default_rng(seed)
    items: list[Item] = [Event(EventKind.OPENED, START_NS, "open µ")]
    for number in range(round(seconds * rate_hz)):
        time_ns = START_NS + round((number + 1) / rate_hz * 1e9)
        items.append(Bytes(rng.bytes(packet), time_ns))
        if number % 1000 == 999:
            items.append(Event(EventKind.SILENT, time_ns, "no byte for 1 s"))
            items.append(Event(EventKind.RESUMED, time_ns, "bytes again"))
    return items


def record(path: Path, items: list[Item], *, closed: bool) -> None:
    """Write a wire file as the recorder does, flushed every 0.1 s; `closed`: with its footer."""
    writer = WireWriter(path, {"device": "made"})
    flushed_ns = START_NS
    for item in items:
        time_ns = item.time_ns
        if time_ns - flushed_ns >= FLUSH_NS:
            writer.flush()
            flushed_ns = time_ns
        writer.write(item)
    writer.flush()
    whole = path.read_bytes()
    writer.close()
    if not closed:
        path.write_bytes(whole)


def flip_bit(data: bytearray, rng: np.random.Generator) -> None:
    """Flip one bit."""
    data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))


def flip_byte(data: bytearray, rng: np.random.Generator) -> None:
    """Put another byte in the place of one."""
    data[int(rng.integers(len(data)))] ^= int(rng.integers(1, 256))


def flip_length(data: bytearray, rng: np.random.Generator) -> None:
    """Change a byte of the length of a message."""
    at = data.find(bytes(6) + WIRE_CHANNEL.to_bytes(2, "little"), int(rng.integers(len(data))))
    data[at + int(rng.integers(-2, 6))] ^= int(rng.integers(1, 256))


def zero_sector(data: bytearray, rng: np.random.Generator) -> None:
    """Zero a sector of 4 kB."""
    at = int(rng.integers(max(1, len(data) // SECTOR))) * SECTOR
    data[at : at + SECTOR] = bytes(len(data[at : at + SECTOR]))


def cut_out(data: bytearray, rng: np.random.Generator) -> None:
    """Take up to 200 bytes out."""
    at = int(rng.integers(len(data)))
    del data[at : at + int(rng.integers(1, 200))]


def put_in(data: bytearray, rng: np.random.Generator) -> None:
    """Put up to 200 random bytes in."""
    at = int(rng.integers(len(data)))
    data[at:at] = rng.bytes(int(rng.integers(1, 200)))


ATTACKS: dict[str, Attack] = {
    "one bit flipped": flip_bit,
    "one byte changed": flip_byte,
    "a length byte changed": flip_length,
    "4 kB of zeros": zero_sector,
    "up to 200 bytes cut out": cut_out,
    "up to 200 bytes put in": put_in,
}


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one attack did."""

    lost: int
    """Reads that do not come out."""
    invented: int
    """Items that come out otherwise than they were written, or twice."""
    told: bool
    summary: WireSummary


def strike(path: Path, items: list[Item], whole: bytes, attack: Attack, rng: np.random.Generator) -> Outcome:
    """Damage the file, read it, and compare with what was written."""
    damaged = bytearray(whole)
    attack(damaged, rng)
    path.write_bytes(damaged)
    reader = WireReader(path)
    read, written = Counter(reader), Counter(items)
    lost, invented = written - read, read - written
    summary = reader.summary
    told = bool(summary.damage.places or summary.tail_bytes or summary.checksum_ok is False)
    return Outcome(lost.total(), invented.total(), told or damaged == whole, summary)


def attack_all(folder: Path, times: int, seed: int, seconds: float = 10.0) -> list[Row]:
    """Try each attack so many times on a closed and on a killed recording."""
    rows = []
    items = made_items(seconds, 200.0, 40, seed)
    for closed in (True, False):
        path = folder / f"{'closed' if closed else 'killed'}.mcap"
        record(path, items, closed=closed)
        whole = path.read_bytes()
        path.unlink()
        for name, attack in ATTACKS.items():
            rng = np.random.default_rng([seed, times, closed])
            outcomes = [strike(path, items, whole, attack, rng) for _ in range(times)]
            lost = np.array([outcome.lost for outcome in outcomes])
            untold = sum(not outcome.told for outcome in outcomes)
            # A block holds the 20 reads of a flush, and events; 4 kB touch four blocks, anything else two.
            bound = 82 if attack is zero_sector else 42
            invented = sum(outcome.invented for outcome in outcomes)
            rows.append(
                Row(
                    f"{name}, {'closed' if closed else 'killed'} recording of {len(items)} reads",
                    times,
                    f"{lost.mean():.2f} reads lost on average, at most {lost.max()};"
                    f" altered or misdated: {invented}; unreported: {untold}",
                    held=bool(lost.max() <= bound) and not untold and not invented,
                )
            )
    return rows


def truncate_all(folder: Path, step: int) -> Iterator[Row]:
    """Cut a wire file at every so many bytes of its last second, and session.yaml anywhere."""
    items = made_items(3.0, 100.0, 58, 1)
    for closed in (True, False):
        path = folder / "cut.mcap"
        record(path, items, closed=closed)
        whole = path.read_bytes()
        path.unlink()
        reads = [whole.index(item.data) for item in items if isinstance(item, Bytes)]
        ends = [whole.index(MARKER, at) - RECORD.size + CHECK_SIZE for at in reads]  # of their blocks
        offsets, wrong = range(ends[-100], len(whole), step), 0
        for offset in offsets:
            path.write_bytes(whole[:offset])
            reader = WireReader(path)
            read = list(reader)
            kept = sum(isinstance(item, Bytes) for item in read)
            told = reader.summary.tail_bytes or not reader.summary.complete
            wrong += read != items[: len(read)] or kept < bisect_right(ends, offset) or not told
        path.unlink()
        kind = "closed" if closed else "killed"
        said = f"each read of a whole block before the cut is there, and the cut is reported; not so: {wrong}"
        yield Row(f"cut in its last second, {kind} recording", len(offsets), said, held=not wrong)
    path = folder / METADATA_NAME
    written = SessionMetadata.begun("live", 1, device="ax1", device_yaml=device_text("ax1")[0])
    write_text(path, dump_yaml(written.model_dump()))
    whole, refused = path.read_bytes(), 0
    offsets = range(0, len(whole), 8 * step)
    for offset in offsets:
        path.write_bytes(whole[:offset])
        with suppress(ImumonError):
            read_metadata(path)
            refused -= 1
        refused += 1
    yield Row(
        "session.yaml cut anywhere", len(offsets), f"refused with a message {refused} times, read otherwise"
    )
