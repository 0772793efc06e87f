"""A simulated device on a pseudo-terminal, read with and without a recording."""

from __future__ import annotations

import asyncio
import logging
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import imumon
from imumon.blocks import NO_INT
from imumon.errors import ImumonError, Reason
from imumon.pipeline import Pipeline
from imumon.protocols.device import load_device
from imumon.recordings import recorder
from imumon.recordings.folder import open_session
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice
from imumon.simulation.virtual_port import VirtualPort
from tests.faults.port import FaultyPort
from tests.waiting import wait_until

pytestmark = pytest.mark.usefixtures("no_leaks")


@pytest.fixture
def device(tmp_path: Path) -> Iterator[VirtualDevice]:
    with VirtualDevice(load_device("ax1"), tmp_path / "imu") as device:
        yield device


@pytest.fixture(params=[False, True], ids=["unrecorded", "recorded"])
def record(request: pytest.FixtureRequest, tmp_path: Path) -> Path | None:
    """Return where the session goes, or None for a unit that is not recorded."""
    return tmp_path / "session" if request.param else None


class Odd:
    """Has no value in every other row."""

    columns = (imumon.Column("odd", "1", "int64"), imumon.Column("odd_is_known", "1"))

    def process(self, block: imumon.SampleBlock) -> dict[str, Any]:
        return {"odd": np.where(block["packet_counter"] % 2, 7, NO_INT), "odd_is_known": np.ones(len(block))}

    def notices(self) -> list[str]:
        return []


class Follower:
    """Knows where the stage before it has no value."""

    columns = (imumon.Column("follower", "1"),)

    def process(self, block: imumon.SampleBlock) -> dict[str, Any]:
        return {"follower": np.where(np.isnan(block["odd"]), -1.0, block["odd"])}

    def notices(self) -> list[str]:
        return []


def test_a_missing_integer_is_nan_for_loops_and_stages(device: VirtualDevice, record: Path | None) -> None:
    with imumon.open(device.port.path, "ax1", stages=[Odd(), Follower()], record=record) as unit:
        for block in unit:
            if len(block) > 1:
                break
    assert set(np.unique(block["follower"])) == {-1.0, 7.0}
    assert np.nanmean(block["odd"]) == 7.0
    assert block["packet_counter"].dtype == block["host_time_ns"].dtype == np.int64


def raised(unit: imumon.Live, reason: Reason) -> ImumonError:
    """Iterate until an error of this reason comes; return it.  A busy computer may cause others before."""
    while True:
        try:
            next(unit)
        except ImumonError as error:
            if error.reason is reason:
                return error


def first_rows(unit: imumon.Live) -> imumon.SampleBlock:
    """Return the first block, however long it takes."""
    while True:
        try:
            return next(unit)
        except ImumonError:
            continue


def test_a_lost_port_is_logged_and_raised_and_comes_back(
    device: VirtualDevice, record: Path | None, caplog: pytest.LogCaptureFixture
) -> None:
    with imumon.open(device.port.path, "ax1", timeout=0.5, record=record) as unit:
        first_rows(unit)
        assert unit.state == "open"
        device.port.unplug()
        assert "was lost: no row for" in str(raised(unit, Reason.LOST))
        assert unit.state == "lost"
        assert any(r.levelno == logging.ERROR and "port lost" in r.message for r in caplog.records)
        device.port.replug()
        first_rows(unit)
        assert unit.state == "open"
    list(unit)
    assert unit.state == "closed"


def test_a_silent_port_is_logged_and_raised(
    tmp_path: Path, record: Path | None, caplog: pytest.LogCaptureFixture
) -> None:
    port = FaultyPort(tmp_path / "imu")
    with (
        VirtualDevice(load_device("ax1"), port=port),
        imumon.open(port.path, "ax1", timeout=0.5, record=record) as unit,
    ):
        first_rows(unit)
        port.silence()
        while unit.state != "silent":
            assert "is open but silent" in str(raised(unit, Reason.SILENT))
        assert any(r.levelno == logging.WARNING and "port silent" in r.message for r in caplog.records)


def test_another_device_than_the_one_named_is_logged_and_raised(
    device: VirtualDevice, record: Path | None, caplog: pytest.LogCaptureFixture
) -> None:
    with imumon.open(device.port.path, "vectornav", timeout=0.5, record=record) as unit:
        while unit.state != "does not frame":
            assert "none of them a packet of vectornav" in str(raised(unit, Reason.WRONG_BAUD))
        assert repr(unit).startswith(f"<imumon.Live: vectornav on {device.port.path} at 115200 8N1, does not")
        assert "only 0% of the bytes are packets: wrong baud rate or device?" in caplog.text


def test_what_came_while_the_loop_was_busy_is_one_block(device: VirtualDevice, record: Path | None) -> None:
    with imumon.open(device.port.path, "ax1", record=record) as unit:
        first = next(unit)
        assert wait_until(lambda: unit.lag_s > 1.0)
        block = next(unit)
        assert len(block) >= 40
        assert block["packet_counter"][0] == first["packet_counter"][-1] + 1
        assert unit.lag_s < 1.0
        assert unit.skipped == 0


def test_with_latest_a_busy_loop_gets_the_newest_rows(device: VirtualDevice, record: Path | None) -> None:
    with imumon.open(device.port.path, "ax1", latest=True, record=record) as unit:
        first = next(unit)
        assert wait_until(lambda: unit.lag_s > 1.0)
        block = next(unit)
        assert np.ptp(block["arrival_time_ns"]) < 0.08e9
        came = block["packet_counter"][-1] - first["packet_counter"][-1]
        assert came >= 40
        assert unit.skipped > 0


def test_blocks_come_to_an_async_loop_and_cancelling_loses_none(
    device: VirtualDevice, record: Path | None
) -> None:
    blocks: list[imumon.SampleBlock] = []
    cancelled = []

    async def gather() -> None:
        with imumon.open(device.port.path, "ax1", record=record) as unit:
            while len(blocks) < 3:
                try:
                    blocks.append(await asyncio.wait_for(anext(unit), 0.02))
                except TimeoutError:
                    cancelled.append(len(blocks))
            async for block in unit:
                blocks.append(block)
                unit.close()
        with pytest.raises(StopAsyncIteration):
            await anext(unit)

    asyncio.run(gather())
    counter = np.concatenate([block["packet_counter"] for block in blocks])
    assert cancelled
    assert np.unique(np.diff(counter)).tolist() == [1]


def test_a_device_that_falls_silent_within_a_packet_is_silent(tmp_path: Path, record: Path | None) -> None:
    packets = load_device("ax1").encoder().encode(SimulatedUnit(load_scenario("bench")).samples(21))
    port = VirtualPort(tmp_path / "imu", 115_200)
    try:
        with imumon.open(port.path, "ax1", timeout=0.5, record=record) as unit:
            port.write(b"".join(packets[:20]))
            while unit.counters.packets < 20:
                first_rows(unit)
            port.write(packets[20][:30])
            arrived = 20 * len(packets[0]) + 30
            while True:
                with pytest.raises(ImumonError) as caught:
                    next(unit)
                assert caught.value.reason is Reason.SILENT
                if unit.counters.bytes_received == arrived:
                    break
    finally:
        port.close()


@pytest.mark.long
def test_no_other_thread_counts_while_the_pipeline_decodes(
    device: VirtualDevice, record: Path | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    counting, counters = set[str](), vars(Pipeline)["counters"].fget

    def counted(pipeline: Pipeline) -> Any:
        counting.add(threading.current_thread().name)
        return counters(pipeline)

    monkeypatch.setattr(recorder, "SAVE_PERIOD_S", 0.1)
    with imumon.open(device.port.path, "ax1", record=record) as unit:
        monkeypatch.setattr(Pipeline, "counters", property(counted))
        rows = len(first_rows(unit))
        while rows < 150:
            rows += len(next(unit))
            assert unit.counters.samples >= rows
        assert counting == {"pipeline"}
    rows += sum(map(len, unit))
    assert unit.counters.samples == rows
    if record is not None:
        kept = open_session(record).metadata.counters
        assert kept == {name: n for name, n in kept.items() if n == unit.counters.as_dict().get(name, n)}
        assert kept["samples"] == rows
