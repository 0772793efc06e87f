from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from multiprocessing import get_context
from pathlib import Path

import pytest

from imumon.fleet.rack.description import load_rack
from imumon.fleet.rack.feed import OfUnit, Overview
from imumon.fleet.rack.rack import Rack, Unit
from imumon.fleet.rack.unit import Update, run_unit
from imumon.protocols.device import load_device
from imumon.recordings.folder import open_session
from imumon.view.items import Log, Samples, State, ViewItem
from tests.cli.command import imumon
from tests.faults.killed import OPENED
from tests.faults.rack import Feeder, packets, rack_command, recorded, write_rack
from tests.waiting import LIMIT_S, wait_until

RATE_HZ = 100.0
SENT_S = 600.0
"""As long as a test may take."""


@contextmanager
def feeding(folder: Path, *names: str) -> Iterator[Feeder]:
    """Feed ports of these names from a thread, once it is started."""
    sent = packets(load_device("ax1"), RATE_HZ, SENT_S)
    with closing(Feeder(folder, names, sent, RATE_HZ, waits=True)) as feeder:
        yield feeder


def is_recorded(sessions: Path, *names: str) -> bool:
    """Test whether recordings say that the ports of these units are open: what came before is thrown away."""
    wires = {name: sessions.glob(f"*-{name}/wire.mcap") for name in names}
    return all(any(OPENED in wire.read_bytes() for wire in wires[name]) for name in names)


class Watching:
    """A rack that is looked after while a test waits."""

    def __init__(self, folder: Path) -> None:
        self.said: list[str] = []
        self.shown: list[ViewItem] = []
        self.rack = Rack(folder, self._say, self.shown.append)

    def _say(self, level: str, text: str) -> None:
        self.said.append(f"{level} {text}")

    def until(self, condition: Callable[[], bool]) -> None:
        def met() -> bool:
            self.rack.look()
            time.sleep(0.02)
            return condition()

        assert wait_until(met), self.said

    def unit(self, name: str) -> Unit:
        return next(unit for unit in self.rack.units if unit.plan.name == name)

    def state(self, name: str) -> str:
        return self.unit(name).state

    def has_packets(self, name: str, more: int = 1) -> Callable[[], bool]:
        before = self.unit(name).vitals.bytes_received if self.unit(name).process is not None else 0
        return lambda: self.unit(name).vitals.bytes_received > before + 58 * more


@pytest.mark.long
def test_a_unit_that_hangs_dies_or_floods_harms_no_other(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("imumon.fleet.rack.rack.HANGS_S", 6.0)
    monkeypatch.setattr("imumon.fleet.rack.rack.KILLED_S", 8.0)
    names = ("good", "stopped", "killed", "flooding")
    with feeding(tmp_path, *names) as feeder:
        watching = Watching(tmp_path / "sessions")
        rack, unit = watching.rack, watching.unit
        three = load_rack(write_rack(tmp_path, feeder, "ax1", names[:3]))
        rack.change(three)
        try:
            watching.until(lambda: is_recorded(tmp_path / "sessions", *names[:3]))
            feeder.flooding.add("flooding")
            feeder.start()
            for name in names[:3]:
                watching.until(watching.has_packets(name))

            stopped, killed = unit("stopped").process, unit("killed").process
            assert stopped is not None
            assert killed is not None
            os.kill(stopped.pid, signal.SIGSTOP)
            os.kill(killed.pid, signal.SIGKILL)
            rack.change(load_rack(write_rack(tmp_path, feeder, "ax1", names)))
            watching.until(lambda: watching.state("killed") == "DEAD (-9)")
            watching.until(lambda: watching.state("stopped") == "HANGS")
            watching.until(lambda: unit("killed").process is not None)
            watching.until(watching.has_packets("killed", 20))
            watching.until(lambda: unit("stopped").deaths == [-9])  # it was ended, as it said nothing
            watching.until(lambda: unit("stopped").process is not None)
            watching.until(watching.has_packets("stopped", 20))
            watching.until(lambda: watching.state("flooding") == "no packets")
            watching.until(lambda: unit("flooding").vitals.bytes_received > 100_000)

            rack.change(three)
            watching.until(lambda: len(rack.units) == 3)
            watching.until(watching.has_packets("good", 20))
            feeder.end()
            sessions = sorted((tmp_path / "sessions").glob("*-good"))
            watching.until(lambda: recorded(sessions) == feeder.written("good"))
        finally:
            rack.stop()
        told = rack.as_dict()

        assert recorded(sessions) == feeder.written("good")
        assert len(sessions) == 1
        assert told["good"]["deaths"] == []
        assert told["good"]["sessions"][0]["packets_missing"] == 0
        for name in ("stopped", "killed"):  # both parts are what was sent, from some moment to another
            first, second = sorted((tmp_path / "sessions").glob(f"*-{name}"))
            assert recorded([first]) in feeder.stream
            assert recorded([second]) in feeder.stream
            assert open_session(first).state == "interrupted"
            assert open_session(second).state == "closed"
            assert told[name]["deaths"] == [-9]
            assert told[name]["interrupted"] == [str(first)]
        (flooded,) = told["flooding"]["sessions"]
        assert flooded["bytes_recorded"] == flooded["bytes_received"] > 100_000
        assert flooded["packets"] == 0
        assert "none of them a packet" in told["flooding"]["problem"]
    _sees_it_all(watching.shown)
    assert any("killed: its process died (signal 9)" in line for line in watching.said)
    log = (tmp_path / "sessions" / "rack.jsonl").read_text().splitlines()
    assert any("leaves the rack" in json.loads(line)["text"] for line in log)


def _sees_it_all(shown: list[ViewItem]) -> None:
    """The view is told of every unit, by the host's clock, with a tenth of the work."""
    items = [item for item in shown if isinstance(item, OfUnit)]
    assert len({one.setup.title for one in items}) == len({repr(one.setup) for one in items})  # also anew
    samples = [one.item for one in items if one.setup.title == "good" and isinstance(one.item, Samples)]
    assert samples
    assert all(one.times.host_ns is not None and one.times.device_ns is None for one in samples)
    assert all("gyro_x" in one.block and "packet_counter" not in one.block for one in samples)
    lanes = {(one.setup.title, one.item.state) for one in items if isinstance(one.item, State)}
    assert {
        ("good", "open"),
        ("stopped", "HANGS"),
        ("killed", "DEAD: signal 9"),
        ("killed", "recording"),
    } <= lanes
    assert any("hangs: no report" in one.item.text for one in items if isinstance(one.item, Log))
    pages = [item for item in shown if isinstance(item, Overview)]
    assert ("good", "stopped", "killed", "flooding") in [page.units for page in pages]
    assert any("| stopped | HANGS |" in page.markdown for page in pages)
    assert pages[-1].units == ("good", "stopped", "killed")


@pytest.mark.long
def test_the_command_follows_its_file_and_ends_in_order(tmp_path: Path) -> None:
    with feeding(tmp_path, "a", "b") as feeder:
        path = write_rack(tmp_path, feeder, "ax1", ["a"])
        (tmp_path / "more.yaml").write_text(path.read_text() + "  absent: {port: /dev/ttyNONE}\n")
        command = rack_command(path, tmp_path, "none")
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
            try:
                assert wait_until(lambda: is_recorded(tmp_path / "sessions", "a"))
                feeder.start()
                good = path.read_text()
                path.write_text(good.replace("ax1", "ax2"))
                stderr = child.stderr
                assert stderr is not None
                said: list[str] = []
                while not said or "goes on as it is" not in said[-1]:
                    said.append(stderr.readline())
                assert "no device 'ax2'" in said[-1]
                write_rack(tmp_path, feeder, "ax1", ["a", "b"])
                path.write_text(path.read_text() + "  absent: {port: /dev/ttyNONE}\n")
                assert wait_until(lambda: is_recorded(tmp_path / "sessions", "b"))
                of_b = list((tmp_path / "sessions").glob("*-b"))
                assert wait_until(lambda: len(recorded(of_b)) > 0)
                feeder.end()
                of_a = list((tmp_path / "sessions").glob("*-a"))
                assert wait_until(lambda: recorded(of_a) == feeder.written("a"))
                child.send_signal(signal.SIGINT)
                out, err = child.communicate(timeout=LIMIT_S)
            finally:
                child.kill()
        told = json.loads(out)["units"]
        assert list(told) == ["a", "b", "absent"]
        assert told["a"]["sessions"], err
        sessions = [Path(one["session"]) for one in told["a"]["sessions"]]
        assert recorded(sessions) == feeder.written("a")
        assert recorded(Path(one["session"]) for one in told["b"]["sessions"]) in feeder.stream
        assert told["absent"] == {**told["absent"], "sessions": [], "problem": "its port was never opened"}
        assert "absent: waits for its port" in "".join(said) + err
        assert child.returncode == 1


@pytest.mark.long
def test_a_unit_whose_rack_is_gone_closes_its_session(tmp_path: Path) -> None:
    with feeding(tmp_path, "left") as feeder:
        (plan,) = load_rack(write_rack(tmp_path, feeder, "ax1")).values()
        context = get_context("forkserver")
        ours, theirs = context.Pipe()
        arguments = (plan, tmp_path / "sessions", theirs)
        process = context.Process(target=run_unit, args=arguments)
        process.start()
        theirs.close()
        try:
            assert wait_until(lambda: feeder.is_open("left"))
            feeder.start()
            for _ in range(2):
                assert ours.poll(LIMIT_S)
                assert isinstance(ours.recv(), Update)
            ours.close()
            process.join(LIMIT_S)
            assert process.exitcode == 0
        finally:
            process.kill()
    (session,) = (tmp_path / "sessions").iterdir()
    assert open_session(session).state == "closed"
    assert recorded([session]) in feeder.stream


def test_a_wrong_file_or_view_is_reported_before_anything_begins(tmp_path: Path) -> None:
    path = tmp_path / "rack.yaml"
    path.write_text("format: imumon-rack/1\nunits:\n  a: {prot: /dev/ttyUSB0}\n")
    done = imumon("rack", path, "--view", "none", cwd=tmp_path)
    assert done.returncode == 2
    assert f"{path}:3: units.a.prot: unknown key" in done.stderr
    done = imumon("rack", path, "--view", "terminal", cwd=tmp_path)
    assert (done.returncode, "is no terminal" in done.stderr) == (2, True)
    assert list(tmp_path.iterdir()) == [path]
