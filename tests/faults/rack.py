"""Attack a rack: many units at once on two cores, for a long time, and what a unit costs."""

from __future__ import annotations

import json
import math
import os
import select
import signal
import subprocess
import sys
import threading
import time
import tty
from collections.abc import Iterable, Sequence
from contextlib import closing, suppress
from pathlib import Path

import numpy as np
import psutil

from imumon.protocols.device import DeviceFile, device_text, load_device
from imumon.recordings.folder import open_session
from imumon.recordings.wire_reader import WireReader
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.unit import MICROSECOND
from imumon.transport.reader import Bytes
from tests.faults.rows import Row
from tests.waiting import wait_until

ROUND_S = 0.0125
"""As often as an adapter with a latency timer of 16 ms hands its bytes over."""
CATCH_UP = 4
"""A feeder that was not run in time sends so many times the line's bytes until it has caught up: a line
cannot send all at once, and a pseudo-terminal holds 4 kB."""
SETTLING_S = 5.0
FIRST = -10
"""Niceness of the feeder, where the system lets it."""
MEGABYTE = 1e6


def packets(device: DeviceFile, rate_hz: float, seconds: float, scenario: str = "bench") -> list[bytes]:
    """Return what a simulated unit sends in so long."""
    played = load_scenario(scenario).played(rate_hz, device.axes)
    unit = SimulatedUnit(played, 0, device.decoder().timing.tick_ns or MICROSECOND)
    samples = unit.samples(round(rate_hz * seconds))
    wrapped = {
        "packet_counter": samples["packet_counter"] % (1 << 16),
        "device_ticks": samples["device_ticks"] % (1 << 32),
    }
    return list(device.encoder().encode(samples.with_columns(wrapped)))


class Feeder:
    """Pseudo-terminals, each of which carries the same prepared bytes at its time: the cheapest device.

    Parameters
    ----------
    folder : Path
        Of the links to the ports.
    names : sequence of str
        Of the links.
    sent : sequence of bytes
        Packets of one length.
    rate_hz : float
        Packets per second.
    waits : bool
        Whether bytes that a port does not take are sent later: that a device's clock does not wait for a busy
        computer is left out.  Otherwise they are lost.
    """

    def __init__(
        self, folder: Path, names: Sequence[str], sent: Sequence[bytes], rate_hz: float, waits: bool = False
    ) -> None:
        self._waits = waits
        self.ports = {name: folder / name for name in names}
        self.stream = b"".join(sent)
        self._bytes_per_s = len(sent[0]) * rate_hz
        self._masters: dict[str, int] = {}
        self._at = dict.fromkeys(names, 0)
        self.lost = dict.fromkeys(names, 0)
        """Bytes that a port did not take: its buffer was full, as nobody had read it."""
        self.flooding: set[str] = set()
        """Ports that get junk, as much as they take, in place of packets."""
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None
        for name, link in self.ports.items():
            master, slave = os.openpty()
            tty.setraw(slave)
            link.symlink_to(os.ttyname(slave))
            os.close(slave)
            os.set_blocking(master, False)
            self._masters[name] = master

    def written(self, name: str) -> bytes:
        """Return what a port has taken; it has lost none."""
        assert not self.lost[name]
        return self.stream[: self._at[name]]

    def is_open(self, *names: str) -> bool:
        """Return whether somebody has these ports open, or all."""
        return not any(_hung_up(self._masters[name]) for name in names or self._masters)

    def run(self, seconds: float) -> None:
        """Send for so long, and until all that was due is sent, or until `end`."""
        began_s, size = time.monotonic(), self._bytes_per_s * ROUND_S
        junk = np.random.default_rng(0).bytes(4096)
        while not self._ending.wait(ROUND_S):
            due = min(int((time.monotonic() - began_s) * self._bytes_per_s), len(self.stream))
            for name, master in self._masters.items():
                at = self._at[name]
                until = min(due, at + round(CATCH_UP * size))
                data = junk if name in self.flooding else self.stream[at:until]
                taken = 0
                with suppress(BlockingIOError):
                    taken = os.write(master, data)
                if self._waits:
                    self._at[name] += 0 if name in self.flooding else taken
                elif name not in self.flooding:
                    self._at[name] += len(data)
                    self.lost[name] += len(data) - taken
            if time.monotonic() - began_s > seconds and min(self._at.values()) >= due:
                return

    def start(self) -> None:
        """Send in a thread, until `end`."""
        self._thread = threading.Thread(target=self.run, args=[math.inf], daemon=True)
        self._thread.start()

    def end(self) -> None:
        """End what was started."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join()

    def close(self) -> None:
        """End, and pull all cables."""
        self.end()
        for master in self._masters.values():
            os.close(master)


def recorded(sessions: Iterable[Path]) -> bytes:
    """Return all bytes of sessions, one after the other."""
    items = (item for path in sessions for item in WireReader(open_session(path).wire_path))
    return b"".join(item.data for item in items if isinstance(item, Bytes))


def write_rack(folder: Path, feeder: Feeder, device: str, names: Iterable[str] | None = None) -> Path:
    """Write the file of a rack that has these units, or all; return its path."""
    lines = [f"  {name}: {{port: {feeder.ports[name]}}}" for name in names or feeder.ports]
    head = ["format: imumon-rack/1", f"default: {{device: {device}}}", "units:"]
    path = folder / "rack.yaml"
    path.write_text("\n".join([*head, *lines, ""]))
    return path


def rack_command(path: Path, folder: Path, view: str) -> list[str]:
    """Return the command for a rack whose sessions go below a folder, with its answer as JSON."""
    options = ["--out", str(folder / "sessions"), "--view", view, "--json"]
    return [sys.executable, "-m", "imumon", "rack", str(path), *options]


def measure(folder: Path, units: int, rate_hz: float, minutes: float, view: str) -> Row:
    """Let units send at once for so long; no byte may be missing on disk."""
    device = folder / "fast.yaml"
    text = device_text("ax1")[0].replace("name: ax1", "name: fast")
    device.write_text(text.replace("baudrates: [115200", "baudrates: [921600"))
    sent = packets(load_device(str(device)), rate_hz, 60.0 * minutes)
    names = [f"unit-{number:02d}" for number in range(1, units + 1)]
    with closing(Feeder(folder, names, sent, rate_hz)) as feeder:
        rack = write_rack(folder, feeder, device.name)
        command = rack_command(rack, folder, view)
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as child:
            try:
                assert wait_until(feeder.is_open)
                time.sleep(SETTLING_S)
                load = os.getloadavg()[0]
                costs = Costs(child.pid)
                with suppress(PermissionError):  # the clock of a device does not wait for a busy computer
                    os.setpriority(os.PRIO_PROCESS, 0, FIRST)
                feeder.run(60.0 * minutes)
                shares = costs.shares()
                time.sleep(1.0)
                child.send_signal(signal.SIGINT)
                told = json.loads(child.communicate(timeout=120.0)[0])["units"]
            finally:
                child.kill()
        wrong, missing = 0, 0
        for name in names:
            on_disk = recorded(Path(session["session"]) for session in told[name]["sessions"])
            missing += len(feeder.stream) - len(on_disk)
            wrong += on_disk != feeder.stream
    cpu = [told[name]["cpu"] for name in names]
    memory = [told[name]["memory_mb"] for name in names]
    deaths = sum(len(told[name]["deaths"]) for name in names)
    beside = ", ".join(f"{name} {share:.0%} and {size:.0f} MB" for name, (share, size) in shares.items())
    return Row(
        f"{units} units at {rate_hz:g} Hz for {minutes:g} min, --view {view}",
        1,
        f"{missing:,} of {units * len(feeder.stream):,} bytes missing on disk, {wrong} recordings differ"
        f" from what was sent, {deaths} processes died; a unit takes"
        f" {np.mean(cpu):.1%} of a core ({min(cpu):.1%} to {max(cpu):.1%}) and {np.mean(memory):.0f} MB,"
        f" all {sum(cpu):.0%} and {sum(memory):.0f} MB; {beside}; load average of the machine {load:.1f}"
        f" before and {os.getloadavg()[0]:.1f} after, {os.cpu_count()} cores",
        held=not (missing or wrong or deaths),
    )


class Costs:
    """What the processes of a rack that are no units take, from now on.

    Parameters
    ----------
    pid : int
        Of the rack.
    """

    def __init__(self, pid: int) -> None:
        rack = psutil.Process(pid)
        self._processes = {"the rack": rack, "the feeder": psutil.Process()}
        for child in rack.children(recursive=True):
            command = " ".join(child.cmdline())
            if "imumon.fleet.rack.view" in command:
                self._processes["the view"] = child
            elif "rerun" in command:
                self._processes["the viewer"] = child
        self._before = {name: _cpu_s(process) for name, process in self._processes.items()}
        self._began_s = time.monotonic()

    def shares(self) -> dict[str, tuple[float, float]]:
        """Return the share of a core of each since then, and its memory, MB; not of one begun anew."""
        spent_s, found = time.monotonic() - self._began_s, dict[str, tuple[float, float]]()
        for name, process in self._processes.items():
            with suppress(psutil.NoSuchProcess):
                share = (_cpu_s(process) - self._before[name]) / spent_s
                found[name] = share, process.memory_full_info().pss / MEGABYTE
        return found


def _cpu_s(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _hung_up(master: int) -> bool:
    """Return whether nobody has the port open."""
    poll = select.poll()
    poll.register(master, 0)
    return any(events & select.POLLHUP for _, events in poll.poll(0))
