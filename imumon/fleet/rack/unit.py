"""The process of one unit: its own reader, recorder, pipeline and session, whatever becomes of the others.

It is forked from a process that has everything loaded (`imumon.fleet.rack.preload`), so that the memory of
what is loaded is there once.  Signals are for the rack, which ends its units in order; where the rack itself
is gone, the unit closes its session and ends.
"""

import gc
import os
import signal
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from imumon.errors import ImumonError
from imumon.fleet.rack.description import Plan
from imumon.fleet.rack.feed import Feed, Vitals
from imumon.heap import prepare_heap
from imumon.protocols.device import parse_device
from imumon.recordings.folder import default_path
from imumon.recordings.lines import Line, Lines
from imumon.run.live import LiveRun, nothing_decoded, warm_up
from imumon.run.narration import view_setup
from imumon.run.setup import Setup, parse_setup
from imumon.view.items import ViewItem, ViewSetup

PERIOD_S = 1.0
"""How often a unit reports; most of what the shared view costs does not depend on how much that is."""
BEFORE = -5
"""Where the system lets it (root, or a limit for niceness), a unit that records comes before all else."""
RETRY_S = 2.0
"""How often a port that cannot be opened is tried again."""


class Update(NamedTuple):
    """What a unit reports once a second; the last one has a problem, and a summary if a port was open."""

    lines: Sequence[Line]
    vitals: Vitals
    setup: ViewSetup | None = None
    """What the view must know of it, None before it records."""
    items: Sequence[ViewItem] = ()
    problem: str | None = None
    """Why the session has no samples; empty where it has."""
    summary: dict[str, object] | None = None
    """That of `imumon monitor --json`."""


def run_unit(plan: Plan, sessions: Path, pictures: bool, rack: Connection) -> None:
    """Record a unit, in a folder of `sessions`, until the rack requests the end or is gone.

    `pictures`: whether there is a view beside the numbers.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    prepare_heap()
    with suppress(PermissionError):
        os.nice(BEFORE)
    with suppress(BrokenPipeError):  # the rack was killed; the session is closed by then
        _run(plan, sessions, pictures, rack)


def _run(plan: Plan, sessions: Path, pictures: bool, rack: Connection) -> None:
    lines = Lines()
    setup = Setup() if plan.pipeline_yaml is None else parse_setup(plan.pipeline_yaml, plan.name)
    device = parse_device(plan.device_yaml, plan.name)
    # All is loaded before the port is open: a reader that waits for that comes too late for what is sent.
    warm_up(device, setup)
    from imumon.view.recorder import ViewRecorder  # here, as Rerun starts threads (see `preload`)

    gc.freeze()

    def new_run() -> LiveRun:
        folder = default_path(plan.name, time.time_ns(), sessions)
        return LiveRun(device, plan.device_yaml, plan.settings, setup, folder, lines.put, serial=plan.serial)

    run = _opened(new_run, lines, rack)
    if run is None:
        rack.send(Update(lines.take(), Vitals(), problem="its port was never opened"))
        return
    whole = view_setup(run.session, run.pipeline.units)
    # Of the unit, not of its session: a tab that is there goes on when a process was begun anew.
    own = ViewSetup(plan.name, plan.name, whole.units, whole.z_down)
    recorder = ViewRecorder(run.session.view_path, whole, on_error=run.report_view_error)
    feed = Feed(str(run.session.path), pictures=pictures)
    run.begin([recorder.publish, feed.publish])
    try:
        while not _ends_on_request(rack, PERIOD_S):
            vitals, items = feed.take(run.progress)
            rack.send(Update(lines.take(), vitals, own, items))
    finally:
        recorder.end()
        summary = run.stop([path.name for path in recorder.files if path.exists()])
        recorder.close()
    problem = run.failure or nothing_decoded(plan.settings, device, summary.counters)
    vitals, items = feed.take(run.progress)
    vitals.cpu = vitals.mean_cpu  # what its life has cost
    seen = "" if problem is None else problem.seen
    rack.send(Update(lines.take(), vitals, own, items, seen, summary.as_dict()))


def _opened(new_run: Callable[[], LiveRun], lines: Lines, rack: Connection) -> LiveRun | None:
    """Return a run whose port is open; wait until it can be opened, or return None when requested to end."""
    reported = ""
    while True:
        try:
            run = new_run()
            run.open()
            return run
        except ImumonError as error:
            if error.seen != reported:
                reported = error.seen
                lines.put("WARN", f"waits for its port: {error.seen}")
        rack.send(Update(lines.take(), Vitals(lanes={"port": "waiting"})))
        if _ends_on_request(rack, RETRY_S):
            return None


def _ends_on_request(rack: Connection, wait_s: float) -> bool:
    """Wait; return whether the rack has requested the end, or is gone."""
    with suppress(EOFError, OSError):
        if not rack.poll(wait_s):
            return False
        rack.recv()
    return True
