"""The log as a text that wraps."""

from __future__ import annotations

from pathlib import Path

import rerun as rr
from rerun.chunk import RrdReader

from imumon.view.items import Instant, Log, ViewItem, ViewSetup
from imumon.view.lanes import LINES, LOG_TEXT
from imumon.view.logger import StreamLogger


def last_text(path: Path, *lines: ViewItem) -> str:
    """Return the text of the log after these lines."""
    rec = rr.RecordingStream("imumon", recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    logger = StreamLogger(rec, ViewSetup("test", "test"), live=False)
    logger.begin()
    logger.log(lines)
    rec.disconnect()
    chunks = list(RrdReader(str(path)).stream().filter(content=[LOG_TEXT]))
    return str(chunks[-1].to_record_batch().column("TextDocument:text")[-1].as_py()[0])


def test_the_newest_line_stands_first_with_its_time_and_its_level(tmp_path: Path) -> None:
    opened = Log(Instant(0, None, 1_700_000_000_000_000_000), "port opened")
    text = last_text(tmp_path / "a.rrd", opened, Log(Instant(0, None, None), "too *hot* | <b>", "WARN"))
    first, second = text.split("\n\n")
    assert first == r"`--:--:--` **WARN** too \*hot\* \| \<b\>"
    assert second.endswith("port opened")
    assert second[3] == ":"


def test_memory_is_bounded_and_a_damaged_time_is_no_crash(tmp_path: Path) -> None:
    lines = [Log(Instant(0, None, 2**63 - 1), str(number)) for number in range(100)]
    assert last_text(tmp_path / "a.rrd", *lines).count("`") == 2 * LINES
