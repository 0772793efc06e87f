from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader

from imumon.errors import ImumonError
from imumon.recordings.wire import CDR, CHECK_SIZE, FIELDS, MARKER, RECORD
from imumon.recordings.wire_reader import WireReader
from imumon.transport.reader import Bytes
from tests.faults.damage import attack_all, made_items, record, truncate_all


def test_damage_costs_what_it_touched_and_is_reported(tmp_path: Path) -> None:
    missed = [row for row in attack_all(tmp_path, 8, 1, seconds=4.0) if not row.held]
    assert not missed


def test_a_file_that_is_cut_anywhere_is_read_up_to_there(tmp_path: Path) -> None:
    assert not [row for row in truncate_all(tmp_path, 41) if not row.held]


def test_other_readers_of_mcap_pass_the_check_records_over(tmp_path: Path) -> None:
    items = made_items(2.0, 100.0, 40, 0)
    record(tmp_path / "w.mcap", items, closed=True)
    reads = [(item.time_ns, item.data) for item in items if isinstance(item, Bytes)]
    with (tmp_path / "w.mcap").open("rb") as file:
        assert file.read().count(MARKER) >= 20
        file.seek(0)
        found = [
            (m.log_time, m.data[CDR.size :]) for _, channel, m in make_reader(file).iter_messages(["/wire"])
        ]
        assert found == reads
        file.seek(0)
        assert make_reader(file).get_summary().statistics.message_count == len(items)  # type: ignore[union-attr]
        file.seek(0)
        assert sum(1 for _ in StreamReader(file, validate_crcs=True).records) > len(items)


def test_a_place_states_where_it_is_how_long_and_how_many_reads(tmp_path: Path) -> None:
    """Ten reads of 0.1 s stand in a block; each has 31 bytes of MCAP and 8 of CDR before its 40."""
    items = made_items(2.0, 100.0, 40, 0)
    record(tmp_path / "w.mcap", items, closed=True)
    content = bytearray((tmp_path / "w.mcap").read_bytes())
    content[content.index(items[55].data)] ^= 1  # type: ignore[union-attr]  # it is Bytes
    (tmp_path / "w.mcap").write_bytes(content)
    reader = WireReader(tmp_path / "w.mcap")
    read = list(reader)
    lost = [item for item in items if item not in read]
    [place] = reader.summary.damage.where
    head = RECORD.size + FIELDS.size + CDR.size
    size = len(lost) * (head + 40) + CHECK_SIZE
    first = content.index(lost[0].data) - head  # type: ignore[union-attr]
    assert (place.offset, place.bytes, place.messages) == (first, size, len(lost)) == (first, size, 10)
    assert place.after_ns == items[items.index(lost[0]) - 1].time_ns
    assert place.seconds == pytest.approx(0.1)


def test_a_block_whose_check_record_is_damaged_is_lost_and_the_next_one_is_not(tmp_path: Path) -> None:
    items = made_items(2.0, 100.0, 40, 0)
    record(tmp_path / "w.mcap", items, closed=False)
    content = bytearray((tmp_path / "w.mcap").read_bytes())
    marker = content.index(MARKER, content.index(items[100].data))  # type: ignore[union-attr]  # it is Bytes
    content[marker + 20] ^= 1
    (tmp_path / "w.mcap").write_bytes(content)
    reader = WireReader(tmp_path / "w.mcap")
    assert len(list(reader)) == len(items) - 10
    assert [place.messages for place in reader.summary.damage.where] == [10]


def test_the_beginning_may_be_gone_altogether(tmp_path: Path) -> None:
    items = made_items(20.0, 100.0, 40, 0)
    record(tmp_path / "w.mcap", items, closed=True)
    content = bytearray((tmp_path / "w.mcap").read_bytes())
    content[:4096] = bytes(4096)
    (tmp_path / "w.mcap").write_bytes(content)
    reader = WireReader(tmp_path / "w.mcap")
    read = list(reader)
    assert read == items[-len(read) :]
    assert reader.summary.damage.messages == len(items) - len(read) < 60


def test_a_block_that_is_there_twice_is_read_once(tmp_path: Path) -> None:
    items = made_items(4.0, 100.0, 40, 0)
    record(tmp_path / "w.mcap", items, closed=True)
    content = (tmp_path / "w.mcap").read_bytes()
    first = content.index(MARKER, 8000) - 9 + CHECK_SIZE
    second = content.index(MARKER, first) - 9 + CHECK_SIZE
    (tmp_path / "w.mcap").write_bytes(content[:second] + content[first:])
    reader = WireReader(tmp_path / "w.mcap")
    assert list(reader) == items
    assert (reader.summary.damage.bytes, reader.summary.damage.messages) == (second - first, 0)


@pytest.mark.parametrize("size", [1, 1000, 100_000])
def test_random_bytes_are_no_wire_file(tmp_path: Path, size: int) -> None:
    (tmp_path / "w.mcap").write_bytes(np.random.default_rng(size).bytes(size))
    with pytest.raises(ImumonError, match="is not a wire file"):
        list(WireReader(tmp_path / "w.mcap"))
