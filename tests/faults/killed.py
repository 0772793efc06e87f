"""A recording program that is killed: how old the newest byte is that is lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import termios
import threading
import time
import tty
from bisect import bisect_right
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from imumon.protocols.device import load_device
from imumon.recordings.source import open_source
from imumon.recordings.wire_reader import WireReader
from imumon.transport.reader import Bytes
from tests.faults.rack import packets
from tests.faults.rows import Row
from tests.waiting import LIMIT_S

PROMISED_S = 0.2
HELD_S = 0.12
"""Of processor time: so long at most a starting monitor keeps its interpreter at one piece of work (measured:
loading a compiled kernel, 0.12 s; Rerun, 0.09 s)."""
WAITS = 2
"""A byte waits for the reader and for the recorder, and either for whoever has the interpreter."""
PREPARED_S = 12.0
EXIT_S = 3.0
ARRIVAL_S = 0.3
OPENED = b'"kind": "opened"'


def wait_for_reader(child: subprocess.Popen[str] | subprocess.Popen[bytes], wire: Path) -> None:
    """Wait until the recording says that the port is open: what came before is thrown away as it opens."""
    while not (wire.exists() and OPENED in wire.read_bytes()) and child.poll() is None:
        time.sleep(0.02)


class Machine:
    """Notes how much longer than on an idle machine a program takes for `HELD_S` of work, at most.

    No promise of a time can hold on a machine that has too much else to do.
    """

    PROGRAM = f"""
import sys, threading, time
end, most_s = threading.Event(), 0.0
threading.Thread(target=lambda: (sys.stdin.read(), end.set()), daemon=True).start()
while not end.is_set():
    began, used = time.monotonic(), time.thread_time()
    while time.thread_time() - used < {HELD_S}: pass
    most_s = max(most_s, time.monotonic() - began - {HELD_S})
    time.sleep(4 * {HELD_S})
print(most_s)
"""

    def __enter__(self) -> Machine:
        """Begin to watch."""
        self._watch = subprocess.Popen(
            [sys.executable, "-c", self.PROGRAM], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.late_s = 0.0
        return self

    def __exit__(self, *_: object) -> None:
        """End, and note the longest wait."""
        self.late_s = float(self._watch.communicate(timeout=LIMIT_S)[0])


def allowed_s(late_s: float) -> float:
    """Return what is promised, with the waits that are the machine's."""
    return PROMISED_S + WAITS * late_s


class Line:
    """A pseudo-terminal into which packets are written at their rate, each noted with its time."""

    def __init__(self, rate_hz: float, prepared_s: float = PREPARED_S) -> None:
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._packets = packets(load_device("ax1"), rate_hz, prepared_s)
        self._rate_hz = rate_hz
        self.sent: list[int] = []
        """Bytes sent after each packet."""
        self.times: list[float] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def start(self) -> None:
        """Begin to send."""
        self._thread.start()

    def pause(self) -> None:
        """Send nothing more, and let what was sent arrive."""
        self._end.set()
        self._thread.join()
        time.sleep(ARRIVAL_S)

    def close(self) -> None:
        """Stop sending and close the line; what nobody has read is lost, or the last packet waits for it."""
        self._end.set()
        while self._thread.is_alive():
            termios.tcflush(self._slave, termios.TCIFLUSH)
            self._thread.join(0.05)
        os.close(self._master)
        os.close(self._slave)

    def _run(self) -> None:
        start, total = time.monotonic(), 0
        for number, packet in enumerate(self._packets):
            wait = start + number / self._rate_hz - time.monotonic()
            if wait > 0.001 and self._end.wait(wait):
                return
            now = time.monotonic()
            total += os.write(self._master, packet)
            self.sent.append(total)
            self.times.append(now)
            if self._end.is_set():
                return


def end_in_order(
    child: subprocess.Popen[str], line: Line, number: int, patience: float
) -> tuple[list[str], float]:
    """End a monitor with ``--json`` by a signal; return what was not in order, and how long it took.

    The line has paused.  It may take so many times as long as promised.
    """
    child.send_signal(number)
    began = time.monotonic()
    out, err = child.communicate(timeout=LIMIT_S)
    took_s = time.monotonic() - began
    told, wrong = json.loads(out), []
    if child.returncode or took_s > patience * EXIT_S:
        said = f": {err}" if child.returncode else ""
        wrong.append(f"exit code {child.returncode} after {took_s:.1f} s{said}")
    for name in ("bytes_received", "bytes_recorded"):
        if told[name] != line.sent[-1]:
            wrong.append(f"{told[name]} of {line.sent[-1]} {name.replace('_', ' ')}")
    if told["packets"] != len(line.sent):
        wrong.append(f"{told['packets']} of {len(line.sent)} packets")
    return wrong, took_s


def kill_one(folder: Path, rate_hz: float, after_s: float) -> tuple[float, float]:
    """Kill a monitor so long after its first bytes.

    Return the age (s) of the oldest byte that is lost, and how late the machine was (s).
    """
    line = Line(rate_hz)
    arguments = ["monitor", line.path, "--device", "ax1", "--view", "none", "--out", str(folder)]
    program = [sys.executable, "-c", "from imumon.cli import main; main()", *arguments]
    wire = folder / "wire.mcap"
    with Machine() as machine, subprocess.Popen(program, stderr=subprocess.DEVNULL) as child:
        try:
            wait_for_reader(child, wire)
            line.start()
            time.sleep(after_s)
            child.kill()
            killed = time.monotonic()
            child.wait()
        finally:
            child.kill()
            line.close()
    kept = sum(len(item.data) for item in WireReader(wire) if isinstance(item, Bytes))
    lost = bisect_right(line.sent, kept)
    age_s = killed - line.times[lost] if lost < len(line.times) and line.times[lost] < killed else 0.0
    return age_s, machine.late_s


def interrupt(folder: Path, number: int, stopped_s: float = 2.0, patience: float = 1.0) -> list[str]:
    """Stop a monitor for a while, let it go on, end it by a signal; return what was not in order."""
    line = Line(100.0)
    arguments = ["monitor", line.path, "--device", "ax1", "--view", "none", "--out", str(folder), "--json"]
    program = [sys.executable, "-c", "from imumon.cli import main; main()", *arguments]
    with subprocess.Popen(program, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as child:
        try:
            wait_for_reader(child, folder / "wire.mcap")
            assert child.stderr is not None
            child.stderr.readline()  # it is ready, and says that the port was opened
            line.start()
            time.sleep(0.5)
            for each in (signal.SIGSTOP, signal.SIGCONT):
                child.send_signal(each)
                time.sleep(stopped_s if each is signal.SIGSTOP else 1.0)
            line.pause()
            wrong, _ = end_in_order(child, line, number, patience)
        finally:
            child.kill()
            line.close()
    source = open_source(folder)
    assert source.session is not None
    if source.session.state != "closed" or source.session.metadata.results_digest is None:
        wrong.append("the session was not closed")
    return wrong


def interrupt_all(folder: Path, times: int) -> Iterator[Row]:
    """Stop a monitor and end it by each signal that ends it in order."""
    for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT):
        wrong = [text for n in range(times) for text in interrupt(folder / f"{number}-{n}", number)]
        said = f"every byte kept, closed with its digest, exit code 0 within {EXIT_S:g} s"
        yield Row(f"SIGSTOP for 2 s, then {number.name}", times, "; ".join(wrong) or said, held=not wrong)


def kill_many(folder: Path, rate_hz: float, times: int, seed: int) -> Row:
    """Kill a monitor at random moments of its first 8 s, in which it also saves its metadata."""
    rng = np.random.default_rng(seed)
    killed = [
        kill_one(folder / f"{rate_hz:g}-{n}", rate_hz, float(rng.uniform(0.5, 8.0))) for n in range(times)
    ]
    ages, late = np.array(killed).T
    within = int((ages <= PROMISED_S).sum())
    return Row(
        f"SIGKILL at {rate_hz:g} Hz",
        times,
        f"lost {np.median(ages):.3f} s (median), at most {ages.max():.3f} s; {within} of {times} within"
        f" {PROMISED_S:g} s; {HELD_S:g} s of work took {np.median(late):.3f} s longer (median), at most"
        f" {late.max():.3f} s",
        held=all(age_s <= allowed_s(late_s) for age_s, late_s in killed),
    )
