"""Run a recording again, at its own pace or faster, and show it as it was shown live."""

import time
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from imumon.blocks import SampleBlock
from imumon.pipeline import Digest, Pipeline
from imumon.recordings.folder import Session
from imumon.recordings.source import Count, feed, no_count, run_over
from imumon.transport.reader import Bytes, Item, Reads

from .narration import Narrator
from .setup import Setup

BATCH_NS = 50_000_000
TICK_NS = 500_000_000
LONGEST_WAIT_S = 1e9
"""More is no time to wait for but a damaged stamp, and the system refuses it."""
SHOWN = 5
"""So many names of columns are in a verdict."""


def replay(
    items: Iterable[Item | SampleBlock],
    pipeline: Pipeline,
    narrator: Narrator | None = None,
    speed: float | None = None,
    count: Count = no_count,
) -> Iterator[SampleBlock]:
    """Run what was recorded through a new pipeline; yield the samples in order, to the last byte.

    `items`, `count`: as for `imumon.recordings.source.run_over`.
    `narrator`: shows the run as it would be shown live; needs items with times.
    `speed`: 1 is as fast as it was recorded, 2 twice as fast; None is as fast as it goes.
    """
    if speed is not None:
        items = _paced(items, speed)
    if narrator is None:
        yield from run_over(items, pipeline, count)
        return

    def taken() -> SampleBlock:
        block = pipeline.take()
        narrator.samples(block, pipeline.side)
        return block

    next_batch_ns = next_tick_ns = now_ns = 0
    for item in items:
        now_ns = _time_ns(item, now_ns)
        count(feed(item, pipeline))
        if not isinstance(item, SampleBlock):
            narrator.item(Reads.of([item]) if isinstance(item, Bytes) else item)
        if not 0 < next_batch_ns - now_ns <= BATCH_NS:  # passed, or the clock jumped back
            next_batch_ns = now_ns + BATCH_NS
            yield taken()
        if not 0 < next_tick_ns - now_ns <= TICK_NS:
            next_tick_ns = now_ns + TICK_NS
            narrator.tick(now_ns)
    pipeline.finish()
    yield taken()
    narrator.tick(now_ns)


def digested(blocks: Iterable[SampleBlock], pipeline: Pipeline, digest: Digest) -> Iterator[SampleBlock]:
    """Pass samples on, and add them and those of the side streams to a digest."""
    for block in blocks:
        digest.update(block, pipeline.side)
        yield block


class Comparison(NamedTuple):
    """The results of a replay beside those of the live run, column by column."""

    identical: bool | None  # None where they cannot be compared
    compared: int = 0  # how many columns both have
    differing: Sequence[str] = ()
    # Columns of stages that did not run in the replay, or were switched off in it.
    only_live: Sequence[str] = ()
    only_replay: Sequence[str] = ()
    reason: str = ""  # why they cannot be compared

    def as_dict(self) -> dict[str, object]:
        """Return it as ``--json`` has it."""
        return {
            "identical_to_live": self.identical,
            "columns_compared": self.compared,
            "columns_differing": self.differing,
            "columns_only_live": self.only_live,
            "columns_only_replay": self.only_replay,
        }

    def __str__(self) -> str:
        if self.identical is None:
            return f"not compared with a live run: {self.reason}"
        rest = _listed("; only in the live run", self.only_live)
        rest += _listed("; only in the replay", self.only_replay)
        if not self.identical:
            why = "; another version, or bytes missing"
            return f"NOT those of the live run{_listed('', self.differing)}{rest}{why}"
        count = f" ({self.compared} columns compared)" if rest else ""
        return f"bit for bit those of the live run{count}{rest}"


def _listed(label: str, names: Sequence[str]) -> str:
    """Return the first names behind a label; nothing without names."""
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return f"{label}: {', '.join(names[:SHOWN])}{more}" if names else ""


def compare_with_live(session: Session, setup: Setup, digest: Digest, pipeline: Pipeline) -> Comparison:
    """Compare the results of a replay, which went through `pipeline`, with those of the live run.

    A column of a stage that only one of the two ran does not count.
    """
    metadata = session.metadata
    if metadata.results_digest is None or setup.text() != metadata.pipeline_yaml:
        return Comparison(None, reason="there is none of the same setup")
    if not metadata.column_crc32:
        if metadata.results_digest == digest.hexdigest():
            return Comparison(True, len(digest.columns()))
        return Comparison(None, reason="an earlier version kept one digest of all columns, this is another")
    live, again = metadata.column_crc32, digest.columns(pipeline.irreproducible)
    common = live.keys() & again.keys()
    # No stage makes a column of a side stream: one that lacks was lost.
    lost = {name for name in live.keys() ^ again.keys() if "/" in name}
    differing = sorted(lost | {name for name in common if live[name] != again[name]})
    return Comparison(
        identical=bool(common) and not differing,
        compared=len(common),
        differing=tuple(differing),
        only_live=tuple(sorted(live.keys() - again - lost)),
        only_replay=tuple(sorted(again.keys() - live - lost)),
    )


def _paced(items: Iterable[Item | SampleBlock], speed: float) -> Iterator[Item | SampleBlock]:
    """Yield the items when it is time for data of their age."""
    first_ns: int | None = None
    began, now_ns = time.monotonic(), 0
    for item in items:
        now_ns = _time_ns(item, now_ns)
        first_ns = now_ns if first_ns is None else first_ns
        ahead = (now_ns - first_ns) * 1e-9 / speed - (time.monotonic() - began)
        if ahead > 0:
            time.sleep(min(ahead, LONGEST_WAIT_S))
        yield item


def _time_ns(item: Item | SampleBlock, before_ns: int) -> int:
    if isinstance(item, SampleBlock):
        return int(item["device_time_ns"][-1]) if len(item) else before_ns
    return item.time_ns
