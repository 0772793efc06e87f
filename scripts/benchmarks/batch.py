"""A batch: what a second worker is worth, what a killed one costs, and what a task costs beside its work."""

from __future__ import annotations

import os
import shutil
import signal
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

import psutil

from benchmarks.measure import Bar, Result, Table
from imumon.fleet.batch.dataset import Dataset, Row
from imumon.fleet.batch.options import BatchOptions
from imumon.fleet.batch.running import run_jobs, workers
from imumon.fleet.batch.tasks import Job, work
from imumon.protocols.device import device_text, parse_device
from imumon.simulation.recording import record_session
from imumon.simulation.unit import load_scenario

SESSIONS, SECONDS = 24, 300.0
"""Sessions that are replayed, and the length of each."""
TINY, TINY_SECONDS = 10_000, 0.5
ALONE = 300
"""Tiny sessions that are done without a scheduler, for comparison."""
BAR = 1.7


@dataclass
class Run:
    """A batch that was run: seconds on the clock, processor seconds of workers and of the rest."""

    wall: float
    workers: float
    rest: float
    rows: list[Row]


def batch() -> Result:
    """Replay the same sessions with one and two workers, kill one of two, and decode many tiny ones."""
    load = os.getloadavg()[0]
    with TemporaryDirectory() as name:
        folder = Path(name)
        jobs = _jobs(folder / "long", SESSIONS, SECONDS, "replay")
        one, two = _run(jobs, 1), _run(jobs, 2)
        killed = _run(jobs, 2, kill_after=SESSIONS // 4)
        tiny = _jobs(folder / "tiny", TINY, TINY_SECONDS, "decode")
        work(tiny[0])
        began = process_time()
        for job in tiny[:ALONE]:
            work(job)
        alone = (process_time() - began) / ALONE
        many = _run(tiny, 2)
    table = Table(
        f"Batch: {SESSIONS} sessions of {SECONDS:g} s at 100 Hz replayed", ["", "s", "workers' CPU s"]
    )
    for what, done in (("one worker", one), ("two workers", two), ("two, one killed", killed)):
        table.rows.append([what, f"{done.wall:.1f}", f"{done.workers:.1f}"])
    same = all(_counted(done) == _counted(one) for done in (two, killed))
    table.notes = [
        f"load before: {load:.1f}; the rows of the three runs are {'the same' if same else 'NOT the same'}"
    ]
    overhead = Table(f"Batch: {TINY:,} sessions of {TINY_SECONDS:g} s decoded", ["", "ms a session"])
    overhead.rows = [
        ["CPU without a scheduler", f"{1e3 * alone:.2f}"],
        ["CPU of two workers", f"{1e3 * many.workers / TINY:.2f}"],
        ["CPU of scheduler, client and table", f"{1e3 * many.rest / TINY:.2f}"],
        ["on the clock", f"{1e3 * many.wall / TINY:.2f}"],
    ]
    found = len({row["session"] for row in many.rows})
    overhead.notes = [f"{found:,} sessions have rows; failed: {sum('reason' in row for row in many.rows)}"]
    return [table, overhead], [
        Bar("speed of two workers over one", BAR, one.wall / two.wall),
        Bar("processor time of two workers over one", 2 / BAR, two.workers / one.workers, at_most=True),
        Bar("rows lost or doubled", 0, 0 if same and found == TINY else 1, at_most=True, required=True),
    ]


def _jobs(folder: Path, number: int, seconds: float, command: Any) -> list[Job]:
    """Make one session and its copies."""
    text, source = device_text("ax1")
    device = parse_device(text, source)
    plan = load_scenario("bench").model_copy(update={"duration_s": seconds})
    first = folder / "000000"
    record_session(plan.played(plan.rate_hz, device.axes), device, text, 0, first, lambda _: None)
    for path in (folder / f"{at:06}" for at in range(1, number)):
        path.mkdir()
        for name in ("session.yaml", "wire.mcap"):
            shutil.copyfile(first / name, path / name)
    options = BatchOptions(command=command)
    return [Job(str(folder / f"{at:06}"), options, str(folder)) for at in range(number)]


def _run(jobs: Sequence[Job], number: int, kill_after: int = 0) -> Run:
    """Run a batch, with all imported and compiled before."""
    taken: list[Row] = []
    ended = 0
    with TemporaryDirectory() as out, workers(None, number) as client:
        client.run(work, jobs[0])
        processes = [psutil.Process(pid) for pid in client.run(os.getpid).values()]
        before, own, began = [_cpu(process) for process in processes], process_time(), perf_counter()
        results = Dataset(Path(out), jobs[0].options)

        def take(rows: Sequence[Row]) -> None:
            nonlocal ended
            ended += 1
            taken.extend(rows)
            results.add(rows)
            if ended == kill_after:
                processes[0].send_signal(signal.SIGKILL)

        run_jobs(client, jobs, take)
        results.close()
        wall, rest = perf_counter() - began, process_time() - own
        if kill_after:
            processes = [psutil.Process(pid) for pid in client.run(os.getpid).values()]
            before = [0.0] * len(processes)
        used = sum(_cpu(process) - start for process, start in zip(processes, before, strict=True))
    return Run(wall, used, rest, taken)


def _cpu(process: psutil.Process) -> float:
    times = process.cpu_times()
    return float(times.user + times.system)


def _counted(done: Run) -> Counter[tuple[str, str]]:
    return Counter((row["session"], repr(sorted(row.items()))) for row in done.rows)
