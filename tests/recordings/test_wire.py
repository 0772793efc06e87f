from __future__ import annotations

import errno
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

from imumon.errors import ImumonError, Reason
from imumon.recordings import wire
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import FORMATS, WireReader, WireSummary
from imumon.transport.reader import Bytes, Event, EventKind, Item

ITEMS: list[Item] = [
    Event(EventKind.OPENED, 1_700_000_000_000_000_000, "open µ"),
    Bytes(b"\xfa\xff\x36", 1_700_000_000_000_000_001),
    Bytes(b"\x89MCAP0\r\n" * 3, 1_700_000_000_010_000_003),
    Event(EventKind.LOST, 1_700_000_000_020_000_000, 'gone "away"\n'),
    Bytes(bytes(range(256)), 1_700_000_000_030_000_000),
]


def record(path: Path, items: list[Item]) -> WireWriter:
    writer = WireWriter(path, {"device": "test"})
    for item in items:
        writer.write(item)
    return writer


def test_what_is_written_is_read_in_order_with_its_times(tmp_path: Path) -> None:
    record(tmp_path / "w.mcap", ITEMS).close()
    reader = WireReader(tmp_path / "w.mcap")
    assert list(reader) == ITEMS
    assert reader.summary == WireSummary(
        3,
        283,
        2,
        complete=True,
        checksum_ok=True,
        last_ns=1_700_000_000_030_000_000,
        metadata={"device": "test"},
    )


@given(reads=st.lists(st.tuples(st.binary(max_size=300), st.integers(0, 2**63 - 1)), max_size=40))
@settings(max_examples=40, deadline=None)
def test_reads_of_any_content_and_time_come_back(
    tmp_path_factory: pytest.TempPathFactory, reads: list[tuple[bytes, int]]
) -> None:
    path = tmp_path_factory.mktemp("wire") / "w.mcap"
    items: list[Item] = [Bytes(data, time_ns) for data, time_ns in reads]
    record(path, items).close()
    assert list(WireReader(path)) == items


def test_a_file_cut_at_any_byte_is_read_to_its_last_whole_block(tmp_path: Path) -> None:
    path, cut = tmp_path / "w.mcap", tmp_path / "cut.mcap"
    ends = []
    writer = WireWriter(path, {})
    writer.flush()
    ends.append(path.stat().st_size)
    for item in ITEMS:
        writer.write(item)
        writer.flush()
        ends.append(path.stat().st_size)
    writer.close()
    whole = path.read_bytes()
    for size in range(len(whole)):
        cut.write_bytes(whole[:size])
        reader = WireReader(cut)
        count = sum(end <= size for end in ends[1:])
        assert list(reader) == ITEMS[:count], size
        assert not reader.summary.complete
        if ends[0] <= size < ends[-1]:
            assert reader.summary.tail_bytes == size - max(end for end in ends if end <= size)
            assert not reader.summary.damage.places


def test_a_tail_of_zeros_as_a_power_failure_leaves_it_is_reported(tmp_path: Path) -> None:
    path = tmp_path / "w.mcap"
    writer = record(path, ITEMS)
    writer.flush()
    with path.open("ab") as file:
        file.write(bytes(3_000_000))
    reader = WireReader(path)
    assert list(reader) == ITEMS
    assert reader.summary.tail_bytes == 3_000_000
    writer.close()


def test_a_flipped_bit_costs_the_block_that_it_is_in(tmp_path: Path) -> None:
    path = tmp_path / "w.mcap"
    writer = WireWriter(path, {"device": "test"})
    for item in ITEMS:
        writer.write(item)
        writer.flush()
    writer.close()
    content = bytearray(path.read_bytes())
    content[content.index(b"\xfa\xff\x36")] ^= 1
    path.write_bytes(content)
    reader = WireReader(path)
    assert list(reader) == [ITEMS[0], *ITEMS[2:]]
    assert reader.summary.damage.messages == 1
    assert reader.summary.checksum_ok is False


def test_the_file_is_mcap_for_other_readers(tmp_path: Path) -> None:
    record(tmp_path / "w.mcap", ITEMS).close()
    with (tmp_path / "w.mcap").open("rb") as file:
        messages = [(channel.topic, m.log_time) for _, channel, m in make_reader(file).iter_messages()]
        file.seek(0)
        [metadata] = make_reader(file).iter_metadata()
    assert [topic for topic, _ in messages] == ["/event", "/wire", "/wire", "/event", "/wire"]
    assert messages[1] == ("/wire", ITEMS[1].time_ns)
    assert (metadata.name, metadata.metadata) == ("imumon", {"device": "test"})


@pytest.mark.parametrize("profile", FORMATS)
def test_a_file_that_another_tool_put_into_chunks_is_refused(tmp_path: Path, profile: str) -> None:
    path = tmp_path / "chunked.mcap"
    with path.open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD, chunk_size=4000)
        writer.start(profile=profile)
        channel = writer.register_channel("/wire", "x-bytes", 0)
        for index in range(500):
            writer.add_message(channel, index, b"%d" % index, index)
        writer.finish()  # type: ignore[no-untyped-call]  # the library does not say
    with pytest.raises(ImumonError, match="into chunks"):
        list(WireReader(path))


def test_other_tools_know_what_is_in_it(tmp_path: Path) -> None:
    """Rerun's own loader warns of what it does not know; the reader of ROS 2 messages raises."""
    path = tmp_path / "w.mcap"
    record(path, ITEMS).close()
    with path.open("rb") as file:
        decoded = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages("/wire")
        assert [bytes(message.data) for *_, message in decoded] == [
            item.data for item in ITEMS if isinstance(item, Bytes)
        ]
        file.seek(0)
        for schema, channel, _ in make_reader(file).iter_messages():
            assert schema is not None
            assert schema.id == channel.schema_id
    load = "import sys, rerun; rerun.RecordingStream('t').log_file_from_path(sys.argv[1])"
    done = subprocess.run(
        [sys.executable, "-c", load, path],
        env=os.environ | {"RUST_LOG": "warn", "CI": "1"}, capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stderr == ""


def test_a_file_of_version_1_is_read_up_to_what_is_damaged(tmp_path: Path) -> None:
    path = tmp_path / "w.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start(profile="imumon-wire/1")
        bare, events = (
            writer.register_channel(topic, encoding, 0)
            for topic, encoding in (("/wire", "x-bytes"), ("/event", "json"))
        )
        for number, item in enumerate(ITEMS):
            if isinstance(item, Bytes):
                channel, at, data = bare, item.time_ns, item.data
            else:
                channel, at = events, item.time_ns
                data = json.dumps({"kind": item.kind.value, "detail": item.detail}).encode()
            writer.add_message(channel, at, data, at, number)
        writer.finish()  # type: ignore[no-untyped-call]  # the library does not say
    whole = path.read_bytes()
    assert list(WireReader(path)) == ITEMS
    damaged = whole.index(bytes(range(256))) - 30
    path.write_bytes(whole[:damaged] + bytes(8) + whole[damaged + 8 :])
    reader = WireReader(path)
    assert list(reader) == ITEMS[:-1]
    assert reader.summary.tail_bytes > 256
    assert not reader.summary.complete


@pytest.mark.parametrize("content", [b"gx,gy,gz\n1,2,3\n", b"\x89MCAP1\r\n" + bytes(40)])
def test_a_file_of_another_kind_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "w.mcap"
    path.write_bytes(content)
    with pytest.raises(ImumonError, match="is not a wire file") as caught:
        list(WireReader(path))
    assert caught.value.reason is Reason.BAD_DATA


def test_an_mcap_file_of_another_profile_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "w.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start(profile="ros2")
        writer.finish()  # type: ignore[no-untyped-call]  # the library does not say
    with pytest.raises(ImumonError, match="profile 'ros2'"):
        list(WireReader(path))


def test_an_existing_file_is_not_overwritten(tmp_path: Path) -> None:
    record(tmp_path / "w.mcap", ITEMS).close()
    before = (tmp_path / "w.mcap").read_bytes()
    with pytest.raises(ImumonError) as caught:
        WireWriter(tmp_path / "w.mcap", {})
    assert caught.value.reason is Reason.EXISTS
    assert (tmp_path / "w.mcap").read_bytes() == before


class FullDisk:
    """os.write with room for so many bytes."""

    def __init__(self, room: int) -> None:
        self.room = room

    def write(self, descriptor: int, data: bytearray) -> int:
        if not self.room:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = self._write(descriptor, bytes(data[: self.room]))
        self.room -= count
        return count

    _write = staticmethod(os.write)


@pytest.mark.parametrize("room", range(0, 120, 7))
def test_after_a_full_disk_the_file_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    writer = WireWriter(tmp_path / "w.mcap", {})
    disk = FullDisk(room)
    monkeypatch.setattr("imumon.recordings.wire.os.write", disk.write)
    for item in ITEMS:
        writer.write(item)
    with pytest.raises(OSError, match="No space left"):
        writer.flush()
    assert writer.counters.bytes_on_disk < writer.counters.bytes
    disk.room = 1 << 20
    writer.flush()
    assert writer.counters.bytes_on_disk == writer.counters.bytes
    writer.close()
    reader = WireReader(tmp_path / "w.mcap")
    assert list(reader) == ITEMS
    assert reader.summary.complete
    assert reader.summary.checksum_ok


def test_bytes_beyond_the_limit_are_counted_and_the_file_reports_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(wire, "PENDING_LIMIT", 100)
    disk = FullDisk(0)
    writer = WireWriter(tmp_path / "w.mcap", {})
    monkeypatch.setattr("imumon.recordings.wire.os.write", disk.write)
    items = [Bytes(bytes([index]) * 60, index) for index in range(6)]
    for item in items[:5]:
        writer.write(item)
    assert writer.counters.bytes == 300
    assert writer.counters.bytes_unrecorded == 180
    disk.room = 1 << 20
    writer.flush()
    writer.write(items[5])
    writer.close()
    reader = WireReader(tmp_path / "w.mcap")
    assert list(reader) == [*items[:2], items[5]]
    assert reader.summary.bytes_unrecorded == 180
    assert writer.counters.bytes_on_disk == 180


def test_closing_on_a_full_disk_counts_what_is_lost_and_leaves_a_readable_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    writer = record(tmp_path / "w.mcap", ITEMS[:2])
    writer.flush()
    monkeypatch.setattr("imumon.recordings.wire.os.write", FullDisk(68).write)
    writer.write(ITEMS[2])
    writer.write(ITEMS[4])
    with pytest.raises(OSError, match="No space left"):
        writer.close()
    assert writer.counters.bytes_on_disk == 3
    assert writer.counters.bytes_unrecorded == 24 + 256
    reader = WireReader(tmp_path / "w.mcap")
    assert list(reader) == ITEMS[:2]
    assert reader.summary.tail_bytes == 68
    writer.close()


def test_an_event_of_a_newer_version_is_refused_rather_than_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "w.mcap"
    writer = record(path, ITEMS)
    writer._add_event("moon", 1_700_000_000_030_000_001, {"detail": "rising"})
    writer.close()
    with pytest.raises(ImumonError, match="moon"):
        list(WireReader(path))
