"""What is kept of a file of Rerun."""

from __future__ import annotations

from pathlib import Path

import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from imumon.view.rrd import APPLICATION, PART, copy_latest, messages
from tests.view.streams import record_batches


def _recorded(path: Path) -> None:
    rec = rr.RecordingStream(APPLICATION, recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    for name in ("first", "second"):
        rec.send_blueprint(rrb.Blueprint(rrb.TimeSeriesView(origin="/a", name=name)))
        for row in range(3):
            rec.set_time("sample", sequence=row)
            rec.log(f"/{name}", rr.Scalars(float(row)))
    rec.disconnect()


@pytest.mark.filterwarnings("ignore:RRD file has no footer")
def test_of_two_arrangements_the_later_stays_and_all_data(tmp_path: Path) -> None:
    whole, copy = tmp_path / "whole.rrd", tmp_path / "copy.rrd"
    _recorded(whole)
    assert len(RrdReader(str(whole)).blueprints()) == 2
    copy_latest(whole, copy)
    reader = RrdReader(str(copy))
    (left,) = reader.blueprints()
    batches = [chunk.to_record_batch() for chunk in reader.stream(store=left)]
    names = [
        batch.column("ViewBlueprint:display_name").to_pylist()
        for batch in batches
        if "ViewBlueprint:display_name" in batch.schema.names
    ]
    assert names == [[["second"]]]
    for name in ("first", "second"):
        assert sum(batch.num_rows for batch in record_batches(copy, f"/{name}")) == 3


def test_of_a_file_that_was_cut_whole_messages_are_read(tmp_path: Path) -> None:
    path = tmp_path / "whole.rrd"
    _recorded(path)
    with path.open("rb") as written:
        parts = sum(kind == PART for kind, _ in messages(written))
    path.write_bytes(path.read_bytes()[:3000])
    with path.open("rb") as written:
        assert 0 < sum(kind == PART for kind, _ in messages(written)) < parts
