"""The arrangement of a live view, changed in place: what a person has chosen (tab, pause, sizes) stays.

A blueprint that is sent as Rerun sends it replaces the one that is shown, and whoever looks on is led back to
the first tab.  Here only the parts that have changed are sent, to the blueprint that a viewer makes by itself
of an application for which none was sent: its name is that of the application.
"""

from __future__ import annotations

import time
import uuid
from collections import Counter
from io import BytesIO
from typing import Any

import pyarrow as pa
import rerun as rr
import rerun.blueprint as rrb

from imumon.view.rrd import (
    BLUEPRINT,
    END,
    FRAME,
    HEAD_BYTES,
    LIVE_APPLICATION,
    PART,
    RECORDING,
    messages,
    store_id,
)

TIMELINE = "blueprint"
"""Of a part the latest on it counts; what a person does comes one after the latest."""
STEP = 1000
"""Between parts, on `TIMELINE`, which counts microseconds: what a viewer does with half of an arrangement
comes before the rest of it."""
ONE_BY_ONE = {"flush_num_rows": 1, "flush_num_bytes": 0, "chunk_max_rows_if_unsorted": 1}
"""What is inside must arrive before what it is in: a viewer takes out what it does not find, for good."""
OUTERMOST = "viewport"
"""The part that names the outermost."""
ROOM = 1000
"""Parts that are handed over at once: Rerun 0.41 takes 1024 and then waits for ever, with the interpreter."""


class InPlace:
    """Sends arrangements to who reads a recording stream, as far as they are not what was sent before.

    Parameters
    ----------
    rec : RecordingStream
        Of the application `LIVE_APPLICATION`.
    """

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec = rec
        self._parts = rr.RecordingStream(
            LIVE_APPLICATION,
            recording_id=LIVE_APPLICATION,
            send_properties=False,
            batcher_config=rr.ChunkBatcherConfig(**ONE_BY_ONE),
        )
        self._written = rr.binary_stream(self._parts)
        self._sent: dict[tuple[str, str, bool], list[pa.Array]] = {}
        self._at = 0

    def forget(self) -> None:
        """Send everything the next time: there is a new reader."""
        self._sent.clear()

    def send(self, whole: rrb.Blueprint) -> None:
        """Send what is not as it was sent last."""
        name_parts(whole.root_container)
        self._at = max(time.time_ns() // 1000, self._at)
        stream: Any = self
        whole._log_to_stream(stream)
        written = self._written.read() or b""
        parts = as_blueprint(written)
        for first in range(0, len(parts), ROOM):
            piece = b"".join([written[:HEAD_BYTES], *parts[first : first + ROOM], FRAME.pack(END, 0)])
            self._rec.log_file_from_contents("arrangement.rbl", piece)
            if first + ROOM < len(parts):
                self._rec.flush()  # or the pieces overtake each other

    def log(self, path: str, what: Any, *, static: bool = False) -> None:
        """Take a part, as a blueprint logs it."""
        key = path, type(what).__name__, static
        values = [one.as_arrow_array() for one in what.as_component_batches()]
        # Which part is outermost a viewer changes by itself: single tabs, once somebody has clicked.
        if path == OUTERMOST or self._sent.get(key) != values:
            self._sent[key] = values
            self._at += STEP
            self._parts.set_time(TIMELINE, sequence=self._at)
            self._parts.log(path, what, static=static)


def name_parts(part: Any, above: str = "") -> None:
    """Let each part of an arrangement have the id that it had in the one before."""
    part.id = uuid.uuid5(uuid.NAMESPACE_OID, above)
    if isinstance(part, rrb.Container):
        seen: Counter[str] = Counter()
        for inner in part.contents:
            name = str(inner.name or type(inner).__name__)
            name_parts(inner, f"{above}/{name}/{seen[name]}")
            seen[name] += 1


def as_blueprint(written: bytes) -> list[bytes]:
    """Return the parts that Rerun wrote for a recording, for the blueprint of the application."""
    here, there = (store_id(kind, LIVE_APPLICATION, LIVE_APPLICATION) for kind in (RECORDING, BLUEPRINT))
    return [message.replace(here, there) for kind, message in messages(BytesIO(written)) if kind == PART]
