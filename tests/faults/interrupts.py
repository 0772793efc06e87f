"""Ctrl-C at every moment of a command: an exit code that is documented, and never a traceback."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
import uuid
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import pyarrow.parquet as pq

from imumon.errors import EXIT_DATA, EXIT_INTERRUPTED, EXIT_OK, Reason
from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice
from tests.faults.rows import Row
from tests.waiting import LIMIT_S

PROGRAM = [sys.executable, "-m", "imumon"]
STEP_S, LAST_S = 0.05, 3.0
"""Of processor time, so that a machine with much else to do is at the same place of the program."""
TICK_S = 0.01
"""Processor time is counted in no finer steps."""
IDLE_S = 1.0
"""A command that takes no processor time for so long waits for something."""
RECORDED_S, RATE_HZ = 20, 100
TRACE = re.compile(r"Traceback|Exception ignored|KeyboardInterrupt|Fatal Python error")
BEFORE_US = re.compile(r"init_import_site|<frozen site>|site\.py|<frozen runpy>")
"""In a traceback: Python was still getting ready, or looked for the program it was to run."""


@dataclass(frozen=True, slots=True)
class Command:
    """A command, and what it writes.

    Parameters
    ----------
    arguments : sequence of str
        ``{port}`` stands for a device that sends, ``{session}`` for a recording, ``{out}`` for the output.
    records : bool
        Whether what it writes is kept when it is ended by Ctrl-C, with exit code 0.
    code : int
        What it ends with by itself.
    """

    arguments: Sequence[str]
    records: bool = False
    code: int = EXIT_OK


MONITOR = ("monitor", "{port}", "--device", "ax1", "--seconds", "300", "--out", "{out}", "--view")
COMMANDS = {
    "monitor": Command((*MONITOR, "none"), records=True),
    "monitor with the web view": Command((*MONITOR, "web"), records=True),
    "replay": Command(("replay", "{session}", "--out", "{out}.csv")),
    "replay in the web view": Command(("replay", "{session}", "--view", "web", "--speed", "max")),
    "view": Command(("view", "{session}", "--out", "{out}.rrd")),
    "view in the browser": Command(("view", "{session}", "--view", "web")),
    "decode": Command(("decode", "{session}", "--out", "{out}.parquet")),
    "allan": Command(("allan", "{session}", "--plot", "{out}.png")),
    # The recording is too short for these.
    "calibrate": Command(("calibrate", "{session}", "--out", "{out}.yaml"), code=EXIT_DATA),
    "diagnose": Command(("diagnose", "--train", "{session}", "--out", "{out}"), code=EXIT_DATA),
}


@dataclass(slots=True)
class Stage:
    """What the commands need: a device that sends, a recording, a folder to write to."""

    folder: Path
    port: str
    session: Path

    def started(self, command: Command, out: Path, mark: str) -> subprocess.Popen[str]:
        """Start a command as a terminal does: Ctrl-C reaches it and all that it starts."""
        words = {"port": self.port, "session": self.session, "out": out}
        # A signal that is ignored here, as in a job in the background, would be ignored there as well.
        before = signal.signal(signal.SIGINT, signal.default_int_handler)
        try:
            return subprocess.Popen(
                [*PROGRAM, *(argument.format(**words) for argument in command.arguments)],
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                start_new_session=True,
                env=os.environ | {"IMUMON_ATTACK": mark},
            )
        finally:
            signal.signal(signal.SIGINT, before)


def staged(folder: Path, port: str) -> Stage:
    """Make the recording."""
    session = folder / "session"
    made = ["simulate", "bench", "--duration", str(RECORDED_S), "--rate", str(RATE_HZ), "--out", str(session)]
    subprocess.run([*PROGRAM, *made], check=True, capture_output=True)
    return Stage(folder, port, session)


def _left(mark: str) -> list[str]:
    """Return what still runs of all that a command has started."""
    until = time.monotonic() + LIMIT_S
    while True:
        found = []
        for process in psutil.process_iter():
            try:
                if process.environ().get("IMUMON_ATTACK") == mark:
                    found.append(" ".join(process.cmdline())[:80])
            except psutil.Error:
                continue
        if not found or time.monotonic() > until:
            return found
        time.sleep(0.1)


@dataclass(frozen=True, slots=True)
class Ended:
    """How a command ended, and what was not in order."""

    code: int | None
    wrong: str
    before_us: bool = False
    """Python had not handed over yet."""
    by_itself: bool = False
    """It had ended before."""


def _reached(child: subprocess.Popen[str], after_s: float) -> bool:
    """Wait until a process has taken so much processor time, or takes none; False where it ends before."""
    process, used_s, since = psutil.Process(child.pid), 0.0, time.monotonic()
    while child.poll() is None:
        times = process.cpu_times()
        if times.user + times.system > used_s:
            used_s, since = times.user + times.system, time.monotonic()
        if used_s >= after_s or time.monotonic() - since > IDLE_S:
            return True
        time.sleep(TICK_S)
    return False


def interrupt(stage: Stage, name: str, after_s: float) -> Ended:
    """Start a command, press Ctrl-C after so much processor time, and see how it ends."""
    command, mark = COMMANDS[name], uuid.uuid4().hex
    folder = stage.folder / mark
    folder.mkdir()
    out = folder / "out"
    child = stage.started(command, out, mark)
    try:
        reached = _reached(child, after_s)
        if reached:
            os.killpg(child.pid, signal.SIGINT)
        try:
            said, _ = child.communicate(timeout=LIMIT_S)
        except subprocess.TimeoutExpired:
            return Ended(None, f"goes on {LIMIT_S:g} s after Ctrl-C")
        wrong = _judged(command, child.returncode, said, [*folder.iterdir()])
        if not wrong and (left := _left(mark)):
            wrong = f"left behind: {', '.join(left)}"
    finally:
        child.kill()
        child.communicate()
        shutil.rmtree(folder)
    if TRACE.search(said) and BEFORE_US.search(said) and "imumon/cli" not in said:
        return Ended(child.returncode, "", before_us=True)
    return Ended(child.returncode, wrong, by_itself=not reached)


def _is_whole(path: Path) -> bool:
    """Return whether a command had written all of its output, and was about to end, when Ctrl-C came."""
    match path.suffix:
        case ".parquet":
            return bool(pq.ParquetFile(path).metadata.num_rows == RECORDED_S * RATE_HZ)
        case ".csv":
            return path.read_bytes().count(b"\n") == 1 + RECORDED_S * RATE_HZ
        case ".png":
            return path.read_bytes().endswith(b"IEND\xaeB`\x82")
    return False


def _judged(command: Command, code: int, said: str, written: list[Path]) -> str:
    """Return what was not as documented."""
    if TRACE.search(said):
        return said
    if code == EXIT_INTERRUPTED:
        parts = [path.name for path in written if not _is_whole(path)]
        return f"exit code {code}, and a part of {parts} is there" if parts else ""
    silent = Reason.SILENT.exit_code if command.records else command.code  # ended before the first packet
    return "" if code in (command.code, silent) else f"exit code {code}: {said}"


def interrupt_all(folder: Path, moments_s: Sequence[float], names: Sequence[str] = ()) -> Iterator[Row]:
    """Press Ctrl-C at these moments of each command, until it has ended by itself."""
    with VirtualDevice(load_device("ax1"), folder / "ahrs", 100.0) as ahrs:
        stage = staged(folder, ahrs.port.path)
        for name in names or COMMANDS:
            ended: list[Ended] = []
            for after_s in moments_s:
                ended.append(interrupt(stage, name, after_s))
                if ended[-1].by_itself:
                    break
            yield _row(name, moments_s, ended)


def _row(name: str, moments_s: Sequence[float], ended: Sequence[Ended]) -> Row:
    wrong = {one.wrong: at for one, at in zip(ended, moments_s, strict=False) if one.wrong}
    codes = Counter(one.code for one in ended if not one.before_us)
    early = sum(one.before_us for one in ended)
    told = [f"exit code {code} {times} times" for code, times in sorted(codes.items(), key=str)]
    told += [f"Python's own words {early} times, before it had loaded the program"] if early else []
    failed = [f"after {at:.2f} s: {text.strip()[-300:]!r}" for text, at in wrong.items()]
    last_s = moments_s[len(ended) - 1]
    said = "; ".join([*failed, ", ".join(told)])
    return Row(f"Ctrl-C in {name}, up to {last_s:.2f} s", len(ended), said, held=not wrong)


def moments() -> list[float]:
    """Return the moments of the first seconds."""
    return [float(at) for at in np.arange(STEP_S, LAST_S + STEP_S / 2, STEP_S)]
