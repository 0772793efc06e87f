"""The process of one unit: its own reader, recorder, pipeline and session, whatever becomes of the others.

It is forked from a process that has everything loaded (`imumon.fleet.rack.preload`), so that the memory of
what is loaded is there once.  Signals are for the rack, which ends its units in order; where the rack itself
is gone, the unit closes its session and ends.
"""

import gc
import os
import time
from collections.abc import Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import NamedTuple

from imumon.errors import ImumonError
from imumon.heap import prepare_heap
from imumon.protocols.device import DeviceFile, parse_device
from imumon.recordings.folder import default_path
from imumon.recordings.lines import Line, Lines
from imumon.run.live import LiveRun, nothing_decoded, warm_up
from imumon.run.narration import view_setup
from imumon.view.items import ViewItem, ViewSetup

from .description import Plan
from .feed import Feed, Vitals

PERIOD_S = 1.0
"""How often a unit reports; most of what the shared view costs does not depend on how much that is."""
BEFORE = -5
"""Where the system lets it (root, or a limit for niceness), a unit that records comes before all else."""
RETRY_S = 2.0
"""How often a port that cannot be opened is tried again."""


class Update(NamedTuple):
    """What a unit reports once a second; the view must know its `setup` from when it records.

    The last one has a problem, why the session has no samples, and if a port was open the summary, that of
    `imumon monitor --json`.
    """

    lines: Sequence[Line]
    vitals: Vitals
    setup: ViewSetup | None = None
    items: Sequence[ViewItem] = ()
    problem: str = ""
    summary: dict[str, object] | None = None


def run_unit(plan: Plan, sessions: Path, rack: Connection) -> None:
    """Record a unit, in a folder of `sessions`, until the rack requests the end or is gone."""
    prepare_heap()
    with suppress(PermissionError):
        os.nice(BEFORE)
    with suppress(BrokenPipeError):  # the rack was killed; the session is closed by then
        _run(plan, sessions, rack)


def _run(plan: Plan, sessions: Path, rack: Connection) -> None:
    lines = Lines()
    device = parse_device(plan.device_yaml, plan.name)
    # All is loaded before the port is open: a reader that waits for that comes too late for what is sent.
    warm_up(device, plan.setup)
    from imumon.view.recorder import ViewRecorder  # here, as Rerun starts threads (see `preload`)

    gc.freeze()

    run = _opened(plan, device, sessions, lines, rack)
    if run is None:
        rack.send(Update(lines.take(), Vitals(), problem="its port was never opened"))
        return
    whole = view_setup(run.session, run.pipeline.units)
    # Of the unit, not of its session: a tab that is there goes on when a process was begun anew.
    own = whole._replace(title=plan.name, recording_id=plan.name)
    recorder = ViewRecorder(run.session.view_path, whole, on_error=run.report_view_error)
    feed = Feed(str(run.session.path))
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
    rack.send(Update(lines.take(), vitals, own, items, problem.seen if problem else "", summary.as_dict()))


def _opened(plan: Plan, device: DeviceFile, sessions: Path, lines: Lines, rack: Connection) -> LiveRun | None:
    """Return a run whose port is open; wait until it can be opened, or return None when requested to end."""
    reported = ""
    while True:
        try:
            folder = default_path(plan.name, time.time_ns(), sessions)
            about = device, plan.device_yaml, plan.settings, plan.setup
            run = LiveRun(*about, folder, lines.put, serial=plan.serial)
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
