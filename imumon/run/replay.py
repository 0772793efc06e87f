"""Run a recording again, at its own pace or faster, and show it as it was shown live."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator

from imumon.blocks import SampleBlock
from imumon.pipeline import Digest, Pipeline
from imumon.recordings.folder import Session
from imumon.recordings.source import feed, reading, run_over
from imumon.run.narration import Narrator
from imumon.run.setup import Setup
from imumon.transport.reader import Bytes, Item

BATCH_NS = 50_000_000
TICK_NS = 500_000_000
LONGEST_WAIT_S = 1e9
"""More is no time to wait for but a damaged stamp, and the system refuses it."""


def replay(
    items: Iterable[Item | SampleBlock],
    pipeline: Pipeline,
    narrator: Narrator | None = None,
    speed: float | None = None,
) -> Iterator[SampleBlock]:
    """Run what was recorded through a new pipeline; yield the samples in order, to the last byte.

    Parameters
    ----------
    items : iterable of Bytes and Event, or of SampleBlock
        As for `imumon.recordings.source.run_over`.
    narrator : Narrator or None
        Shows the run as it would be shown live; needs items with times.
    speed : float or None
        1 is as fast as it was recorded, 2 twice as fast; None is as fast as it goes.
    """
    if speed is not None:
        items = _paced(items, speed)
    return run_over(items, pipeline) if narrator is None else _narrated(items, pipeline, narrator)


def digested(blocks: Iterable[SampleBlock], pipeline: Pipeline, digest: Digest) -> Iterator[SampleBlock]:
    """Pass samples on, and add them and those of the side streams to a digest."""
    for block in blocks:
        digest.update(block, pipeline.side)
        yield block


def identical_to_live(session: Session, setup: Setup, digest: Digest) -> bool | None:
    """Tell whether the results of a replay are those of the live run; None where there was no such run.

    Nor where an earlier version made the digest of it in another way.
    """
    metadata = session.metadata
    live = metadata.results_digest if setup.text() == metadata.pipeline_yaml else None
    return None if live is None or not live.startswith(Digest.KIND) else live == digest.hexdigest()


def _narrated(
    items: Iterable[Item | SampleBlock], pipeline: Pipeline, narrator: Narrator
) -> Iterator[SampleBlock]:
    """Run over the items, and tell the narrator of each as the live run does."""
    next_batch_ns = next_tick_ns = now_ns = 0
    told = reading.get()
    for item in items:
        now_ns = _time_ns(item, now_ns)
        told(feed(item, pipeline))
        if isinstance(item, Bytes):
            narrator.received(len(item.data), item.arrival_ns)
        elif not isinstance(item, SampleBlock):
            narrator.event(item)
        if not 0 < next_batch_ns - now_ns <= BATCH_NS:  # passed, or the clock jumped back
            next_batch_ns = now_ns + BATCH_NS
            yield _shown(pipeline, narrator)
        if not 0 < next_tick_ns - now_ns <= TICK_NS:
            next_tick_ns = now_ns + TICK_NS
            narrator.tick(now_ns)
    pipeline.finish()
    yield _shown(pipeline, narrator)
    narrator.tick(now_ns)


def _shown(pipeline: Pipeline, narrator: Narrator) -> SampleBlock:
    block = pipeline.take()
    narrator.samples(block, pipeline.side)
    return block


def _paced(items: Iterable[Item | SampleBlock], speed: float) -> Iterator[Item | SampleBlock]:
    """Yield the items when it is time for data of their age."""
    began: tuple[int, float] | None = None
    now_ns = 0
    for item in items:
        now_ns = _time_ns(item, now_ns)
        began = began or (now_ns, time.monotonic())
        data_ns, wall = began
        ahead = (now_ns - data_ns) * 1e-9 / speed - (time.monotonic() - wall)
        if ahead > 0:
            time.sleep(min(ahead, LONGEST_WAIT_S))
        yield item


def _time_ns(item: Item | SampleBlock, before_ns: int) -> int:
    if isinstance(item, Bytes):
        return item.arrival_ns
    if isinstance(item, SampleBlock):
        return int(item["device_time_ns"][-1]) if len(item) else before_ns
    return item.time_ns
