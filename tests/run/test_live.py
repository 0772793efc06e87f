from __future__ import annotations

import errno
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue

import numpy as np
import pytest

from imumon.blocks import ColumnArray, SampleBlock, join
from imumon.columns import Column
from imumon.errors import ImumonError, Reason
from imumon.pipeline import Digest, Pipeline
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.recordings.folder import Session, open_session
from imumon.recordings.lines import LOG_NAME
from imumon.recordings.source import run_over, source_of
from imumon.recordings.wire_reader import WireReader
from imumon.run import live
from imumon.run.live import LiveRun, nothing_decoded, warm_up
from imumon.run.replay import compare_with_live
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.reader import Bytes, Event, EventKind, Item, Reads
from imumon.transport.settings import PortSettings
from imumon.view.items import Log, State, Status, ViewItem
from tests.faults.port import FaultyPort
from tests.models.models import three_curves
from tests.waiting import wait_until

AX1 = load_device("ax1")


class Watcher:
    """Takes view items and log lines, as a view would."""

    def __init__(self) -> None:
        self.items: list[ViewItem] = []
        self.lines: list[str] = []

    def say(self, level: str, text: str) -> None:
        self.lines.append(f"{level} {text}")

    def states(self, lane: str) -> list[str]:
        return [item.state for item in self.items if isinstance(item, State) and item.lane == lane]


def start(path: str, folder: Path, watcher: Watcher, baudrate: int = 115200) -> LiveRun:
    run = LiveRun(AX1, device_text("ax1")[0], PortSettings(path, baudrate), Setup(), folder, watcher.say)
    run.open()
    warm_up(AX1, Setup())
    run.begin([watcher.items.append])
    return run


def replayed(session: Session) -> tuple[SampleBlock, Pipeline]:
    device = source_of(session).device
    assert device is not None
    pipeline = Pipeline(device, estimators(device))
    return join(list(run_over(WireReader(session.wire_path), pipeline))), pipeline


@pytest.fixture
def ahrs(tmp_path: Path) -> Iterator[VirtualDevice]:
    with VirtualDevice(AX1, tmp_path / "ahrs") as device:
        yield device


def test_reads_in_a_row_come_at_once_and_nothing_after_the_end() -> None:
    opened, closed = (Event(kind, 5, "") for kind in (EventKind.OPENED, EventKind.CLOSED))
    items: SimpleQueue[Item] = SimpleQueue()
    for item in (opened, Bytes(b"ab", 6), Bytes(b"c", 7), closed, Bytes(b"d", 8)):
        items.put(item)
    first, reads, last = live.arrived(items)
    assert (first, last) == (opened, closed)
    assert isinstance(reads, Reads)
    assert list(reads) == [Bytes(b"ab", 6), Bytes(b"c", 7)]
    assert reads.lengths.tolist() == [2, 1]


@pytest.mark.parametrize(("serial", "said"), [("SN1", True), ("SN2", False), (None, False)])
def test_a_model_of_another_unit_is_reported(
    ahrs: VirtualDevice, tmp_path: Path, serial: str | None, said: bool
) -> None:
    setup = Setup(model=three_curves().model_copy(update={"serial": "SN2"}))
    watcher, settings = Watcher(), PortSettings(ahrs.port.path)
    text = device_text("ax1")[0]
    run = LiveRun(AX1, text, settings, setup, tmp_path / "s", watcher.say, serial=serial)
    run.open()
    run.begin([])
    run.stop()
    assert ("WARN the bias model is of unit SN2, this is SN1" in watcher.lines) is said


@pytest.mark.usefixtures("no_leaks")
def test_a_replay_gives_the_live_samples_bit_for_bit(tmp_path: Path) -> None:
    watcher = Watcher()
    with VirtualDevice(AX1, tmp_path / "ahrs") as device:
        run = start(device.port.path, tmp_path / "session", watcher)
        assert wait_until(lambda: run.pipeline.counters.packets > 150)
        summary = run.stop(["view.rrd"])
    session = open_session(tmp_path / "session")
    block, pipeline = replayed(session)
    digest = Digest()
    digest.update(block)
    assert digest.hexdigest() == summary.results_digest == session.metadata.results_digest
    assert compare_with_live(session, Setup(), digest, pipeline).identical is True
    digest.update(block)
    assert compare_with_live(session, Setup(), digest, pipeline).identical is False
    assert pipeline.counters == summary.counters
    live = join([item.block for item in watcher.items if hasattr(item, "block")])
    for name in block.columns:
        np.testing.assert_array_equal(live[name], block[name], err_msg=name)
    assert session.metadata.state == "closed"
    assert session.metadata.views == ["view.rrd"]
    assert session.metadata.counters["packets"] == summary.counters.packets
    assert session.metadata.counters["packets_by_type.ax1"] == summary.counters.packets
    assert summary.wire.bytes_on_disk == summary.counters.bytes_received
    assert any(isinstance(item, Status) for item in watcher.items)


def test_an_unplugged_device_comes_back_and_a_reboot_begins_a_segment(
    tmp_path: Path, ahrs: VirtualDevice
) -> None:
    watcher = Watcher()
    run = start(ahrs.port.path, tmp_path / "session", watcher)
    assert wait_until(lambda: run.pipeline.counters.packets > 30)
    ahrs.port.unplug()
    assert wait_until(lambda: "lost" in watcher.states("port"))
    ahrs.reboot()
    ahrs.port.replug()
    before = run.pipeline.counters.packets
    assert wait_until(lambda: run.pipeline.counters.packets > before + 30)
    summary = run.stop()
    assert watcher.states("port") == ["open", "lost", "open", "closed"]
    assert summary.counters.clock_restarts == 1
    assert "jumped" in watcher.states("clock")
    assert any("started anew" in item.text for item in watcher.items if isinstance(item, Log))
    block, pipeline = replayed(open_session(tmp_path / "session"))
    assert pipeline.counters == summary.counters
    assert set(block["segment"]) == {0, 1}
    digest = Digest()
    digest.update(block)
    assert digest.hexdigest() == summary.results_digest


def test_silence_is_reported_and_ends_by_itself(tmp_path: Path) -> None:
    watcher, port = Watcher(), FaultyPort(tmp_path / "ahrs")
    with VirtualDevice(AX1, port=port):
        run = start(port.path, tmp_path / "session", watcher)
        assert wait_until(lambda: run.pipeline.counters.packets > 10)
        port.silence()
        assert wait_until(lambda: "silent" in watcher.states("port"))
        port.resume()
        before = run.pipeline.counters.packets
        assert wait_until(lambda: watcher.states("port")[-1] == "open")
        assert wait_until(lambda: run.pipeline.counters.packets > before)
        summary = run.stop()
    assert summary.counters.clock_restarts == 0
    assert summary.counters.packets_missing > 50


def test_a_wrong_baud_rate_is_named(tmp_path: Path, ahrs: VirtualDevice) -> None:
    watcher = Watcher()
    run = start(ahrs.port.path, tmp_path / "session", watcher, baudrate=57600)
    assert wait_until(lambda: "bad: does not frame" in watcher.states("data"))
    summary = run.stop()
    problem = nothing_decoded(PortSettings(ahrs.port.path, 57600), AX1, summary.counters)
    assert problem is not None
    assert problem.reason is Reason.WRONG_BAUD
    assert "imumon detect" in problem.hint
    assert summary.wire.bytes_on_disk == summary.counters.bytes_received > 0


def test_a_port_that_cannot_be_opened_leaves_nothing_behind(tmp_path: Path) -> None:
    watcher = Watcher()
    with pytest.raises(ImumonError) as caught:
        start(str(tmp_path / "nothing"), tmp_path / "session", watcher)
    assert caught.value.reason is Reason.NOT_FOUND
    assert not (tmp_path / "session").exists()


def test_a_session_is_not_overwritten(tmp_path: Path, ahrs: VirtualDevice) -> None:
    run = start(ahrs.port.path, tmp_path / "session", Watcher())
    assert wait_until(lambda: run.pipeline.counters.packets > 5)
    run.stop()
    before = (tmp_path / "session" / "wire.mcap").read_bytes()
    with pytest.raises(ImumonError) as caught:
        start(ahrs.port.path, tmp_path / "session", Watcher())
    assert caught.value.reason is Reason.EXISTS
    assert (tmp_path / "session" / "wire.mcap").read_bytes() == before


def test_a_recording_that_cannot_be_made_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(live, "WireWriter", full)
    with pytest.raises(ImumonError, match="No space left on device") as caught:
        start(str(tmp_path / "ahrs"), tmp_path / "session", Watcher())
    assert caught.value.reason is Reason.BAD_CONFIG
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("no_leaks")
def test_a_run_that_did_not_decode_everything_has_no_digest_to_compare_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[object] = []
    monkeypatch.setattr(threading, "excepthook", lambda event: seen.append(event.exc_value))
    with VirtualDevice(AX1, tmp_path / "ahrs") as device:
        run = start(device.port.path, tmp_path / "session", Watcher())
        assert wait_until(lambda: run.pipeline.counters.packets > 20)

        def fail() -> SampleBlock:
            raise ValueError("a defect")

        monkeypatch.setattr(run.pipeline, "take", fail)
        assert wait_until(lambda: not run.processing)
        received, wire = run.pipeline.counters.bytes_received, tmp_path / "session" / "wire.mcap"
        before = wire.stat().st_size
        assert wait_until(lambda: wire.stat().st_size > before + 20_000)
        summary = run.stop()
    assert [str(error) for error in seen] == ["a defect"]
    assert run.failure is not None
    assert "the recording is whole" in run.failure.hint
    assert summary.results_digest is None
    assert summary.wire.bytes_on_disk == summary.wire.bytes > received
    session = open_session(tmp_path / "session")
    assert session.metadata.results_digest is None
    assert session.metadata.counters["bytes_unrecorded"] == 0
    assert len(replayed(session)[0]) > 40


class _Fails:
    """A stage of another package that fails after ten samples."""

    columns = (Column("mine", "1"),)

    def __init__(self) -> None:
        self._samples = 0

    def process(self, block: SampleBlock) -> dict[str, ColumnArray]:
        self._samples += len(block)
        if self._samples > 10:
            raise ZeroDivisionError("of mine")
        return {"mine": np.ones(len(block))}

    def notices(self) -> list[str]:
        return []


@pytest.mark.usefixtures("no_leaks")
def test_a_stage_that_fails_ends_neither_the_view_nor_the_recording(tmp_path: Path) -> None:
    watcher, folder = Watcher(), tmp_path / "session"
    with VirtualDevice(AX1, tmp_path / "ahrs") as device:
        settings, text = PortSettings(device.port.path), device_text("ax1")[0]
        run = LiveRun(AX1, text, settings, Setup(), folder, watcher.say, [_Fails()])
        run.open()
        run.begin([watcher.items.append])
        assert wait_until(lambda: any("switched off" in line for line in watcher.lines), 15.0)
        samples = run.pipeline.counters.samples
        assert wait_until(lambda: run.pipeline.counters.samples > samples + 20, 15.0)
        assert run.processing
        summary = run.stop()
    assert run.failure is None
    [line] = [line for line in watcher.lines if "switched off" in line]
    assert f"{__file__}:" in line
    assert line.removeprefix("WARN ") in (folder / LOG_NAME).read_text()
    shown = join([item.block for item in watcher.items if hasattr(item, "block")])
    assert np.isnan(shown["mine"][-20:]).all()
    session = open_session(folder)
    assert session.metadata.state == "closed"
    assert summary.wire.bytes_on_disk == summary.counters.bytes_received


@pytest.mark.long
def test_a_device_that_sends_every_two_seconds_is_not_called_silent(tmp_path: Path) -> None:
    text = device_text("ax1")[0].replace("rate_hz: 100", "rate_hz: 0.5")
    slow, watcher = parse_device(text, "slow"), Watcher()
    with VirtualDevice(slow, tmp_path / "ahrs") as device:
        run = LiveRun(slow, text, PortSettings(device.port.path), Setup(), tmp_path / "session", watcher.say)
        run.open()
        run.begin([watcher.items.append])
        assert wait_until(lambda: run.pipeline.counters.packets == 2)
        run.stop()
    assert watcher.states("port") == ["open", "closed"]
