"""A batch: what a second worker is worth, and what a task costs beside its work."""

import shutil
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time
from typing import Any

from study import Cells, Table

from benchmarks.measure import Bar, Result
from imumon.fleet.batch.dataset import BatchOptions, Dataset, Row
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


def batch() -> Result:
    """Replay the same sessions with one and two workers, and decode many tiny ones."""
    with TemporaryDirectory() as name:
        folder = Path(name)
        jobs = _jobs(folder / "long", SESSIONS, SECONDS, "replay")
        one, two = (_run(jobs, number)[0] for number in (1, 2))
        tiny = _jobs(folder / "tiny", TINY, TINY_SECONDS, "decode")
        work(tiny[0])
        began = process_time()
        for job in tiny[:ALONE]:
            work(job)
        alone = (process_time() - began) / ALONE
        wall, rest, rows = _run(tiny, 2)
    title = f"## Batch: {SESSIONS} sessions of {SECONDS:g} s at 100 Hz replayed"
    table = Table(title, ["", "s"], [["one worker", one], ["two workers", two]], formats=("", ".1f"))
    costs: list[Cells] = [
        ["CPU without a scheduler", 1e3 * alone],
        ["CPU of scheduler, client and table", 1e3 * rest / TINY],
        ["on the clock, two workers", 1e3 * wall / TINY],
    ]
    found = len({row["session"] for row in rows})
    note = f"{found:,} sessions have rows; failed: {sum('reason' in row for row in rows)}"
    title = f"## Batch: {TINY:,} sessions of {TINY_SECONDS:g} s decoded"
    overhead = Table(title, ["", "ms a session"], costs, note, ("", ".2f"))
    return [table, overhead], [Bar("speed of two workers over one", BAR, one / two)]


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
    return [Job(str(folder / f"{at:06}"), BatchOptions(command=command), str(folder)) for at in range(number)]


def _run(jobs: Sequence[Job], number: int) -> tuple[float, float, list[Row]]:
    """Return seconds on the clock, processor seconds of this process, and the rows of a batch."""
    taken: list[Row] = []
    with TemporaryDirectory() as out, workers(None, number) as client:
        client.run(work, jobs[0])  # compiles
        began, own = perf_counter(), process_time()
        results = Dataset(Path(out), jobs[0].options)

        def take(rows: Sequence[Row]) -> None:
            taken.extend(rows)
            results.add(rows)

        run_jobs(client, jobs, take)
        results.close()
        return perf_counter() - began, process_time() - own, taken
