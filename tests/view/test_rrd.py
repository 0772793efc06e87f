"""The messages of a file of Rerun."""

from __future__ import annotations

from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from imumon.view.rrd import APPLICATION, PART, messages


def _recorded(path: Path) -> None:
    rec = rr.RecordingStream(APPLICATION, recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    for name in ("first", "second"):
        rec.send_blueprint(rrb.Blueprint(rrb.TimeSeriesView(origin="/a", name=name)))
        for row in range(3):
            rec.set_time("sample", sequence=row)
            rec.log(f"/{name}", rr.Scalars(float(row)))
    rec.disconnect()


def test_of_a_file_that_was_cut_whole_messages_are_read(tmp_path: Path) -> None:
    path = tmp_path / "whole.rrd"
    _recorded(path)
    with path.open("rb") as written:
        parts = sum(kind == PART for kind, _ in messages(written))
    path.write_bytes(path.read_bytes()[:3000])
    with path.open("rb") as written:
        assert 0 < sum(kind == PART for kind, _ in messages(written)) < parts
