"""The rack: keeps a process for each unit, receives its state, and begins it anew when it dies or hangs."""

import math
import threading
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from imumon.lane import Level
from imumon.recordings.lines import SessionLog
from imumon.view.items import Instant, Log, State, ViewItem, ViewSetup

from .description import Plan
from .feed import OfUnit, Overview, Vitals
from .table import Row, markdown, row_of
from .unit import Update, run_unit

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.5, 10.0
"""A unit that dies is begun anew after the first, one that dies again after twice as long, up to the last."""
STEADY_S = 30.0
"""One that lived this long is begun anew after the first."""
OVERVIEW_S = 1.0
FIRST_WORD_S, HANGS_S, KILLED_S = 120.0, 5.0, 35.0
"""A process that is silent for so long hangs, and is killed.  Its first report may come later: after an
installation it compiles what its device needs, as all others do."""
END_S = 30.0
"""A unit that is requested to end has written everything after this time, or its disk does not answer."""
STOPPING_S = 0.05
"""How often it is checked whether it has."""


class Process:
    """One life of a unit: its process, and what that has reported.

    A thread receives it, as a process that stops in the middle of a message would stop who listens.
    """

    def __init__(self, plan: Plan, folder: Path) -> None:
        context = get_context("forkserver")
        context.set_forkserver_preload(["imumon.fleet.rack.preload"])
        self._ours, theirs = context.Pipe()
        self.received_s = time.monotonic() + FIRST_WORD_S
        """When its last message came; before the first one when that is due."""
        self._messages: SimpleQueue[Update] = SimpleQueue()
        self._process = context.Process(target=run_unit, args=(plan, folder, theirs), name=plan.name)
        self._process.start()
        self.pid, self.kill = self._process.pid or 0, self._process.kill
        theirs.close()
        self._listener = threading.Thread(target=self._listen, daemon=True)
        self._listener.start()

    def messages(self) -> list[Update]:
        """Return what it has reported since the last time."""
        messages = [self._messages.get_nowait() for _ in range(self._messages.qsize())]
        if messages:
            self.received_s = time.monotonic()
        return messages

    def ask_to_end(self) -> None:
        """Ask it to close its session; returns at once."""
        with suppress(OSError):  # it is gone
            self._ours.send(None)

    @property
    def exit_code(self) -> int | None:
        """How it ended, minus the number of the signal where it was one; None while it lives."""
        return None if self._process.is_alive() else self._process.exitcode

    def close(self) -> None:
        """Give back what a process that has ended holds; its last messages can be taken after it."""
        self._process.join()
        self._listener.join()
        self._ours.close()

    def _listen(self) -> None:
        with suppress(EOFError, OSError):
            while True:
                self._messages.put(self._ours.recv())


@dataclass
class Unit:
    """A unit as the rack sees it, over all lives of its process.

    `silent`: whether its process does not report how it is; `problem`: why its last session has no samples.
    A process is begun at `begin_s`, after a pause of `pause_s`, and killed at `end_by_s` if it has not ended;
    None while it was not requested to end.  `deaths` are exit codes of processes that ended without that, and
    `interrupted` their sessions.
    """

    plan: Plan
    process: Process | None = None
    vitals: Vitals = field(default_factory=Vitals)
    setup: ViewSetup | None = None
    silent: bool = False
    end_by_s: float | None = None
    deaths: list[int] = field(default_factory=list)
    interrupted: list[str] = field(default_factory=list)
    pause_s: float = FIRST_PAUSE_S
    begin_s: float = 0.0
    summaries: list[dict[str, object]] = field(default_factory=list)
    problem: str = ""

    @property
    def state(self) -> str:
        """How it is, in a word or two: the worst first."""
        lanes = self.vitals.lanes
        if self.process is None:
            return f"DEAD ({self.deaths[-1]})" if self.deaths and self.end_by_s is None else "ended"
        if self.silent:
            return "HANGS"
        port, data = lanes.get("port", "starting"), lanes.get("data", "")
        if port != "open":
            return port
        if data.startswith("bad"):
            return "no packets"
        return "losses" if data.startswith("warning") else lanes.get("motion", "open")

    def as_dict(self) -> dict[str, Any]:
        """Return what ``--json`` holds of it."""
        return {
            "state": self.state,
            "sessions": self.summaries,
            "problem": self.problem,
            "deaths": self.deaths,
            "interrupted": self.interrupted,
            "cpu": self.vitals.mean_cpu,
            "memory_mb": self.vitals.memory_mb,
        }


class Rack:
    """Many units, each in a process; nothing that one does delays another.

    Used by one thread; `look` is to be called several times a second.  Sessions and the rack's own log go to
    `folder`, log lines also to `log`, view items to `publish`.
    """

    def __init__(
        self, folder: Path, log: Callable[[str, str], None], publish: Callable[[ViewItem], None]
    ) -> None:
        self._folder, self._publish = folder, publish
        folder.mkdir(parents=True, exist_ok=True)
        self._log = SessionLog(folder / "rack.jsonl", log)
        self._present: dict[str, Unit] = {}
        self._leaving: list[Unit] = []
        self._overview_s = 0.0

    @property
    def units(self) -> list[Unit]:
        """Those that are here, in order, then those that are being ended."""
        return [*self._present.values(), *(unit for unit in self._leaving if unit.process is not None)]

    @property
    def rows(self) -> list[Row]:
        """The table."""
        return [row_of(one.plan.name, one.state, one.vitals, len(one.deaths)) for one in self.units]

    def change(self, plans: Mapping[str, Plan]) -> None:
        """Begin the units that are new, end those that are gone, and both where the plan is another one."""
        for name, unit in list(self._present.items()):
            if plans.get(name) != unit.plan:
                self._put(unit, "INFO", "begins anew: other settings" if name in plans else "leaves the rack")
                self._end(unit)
                self._leaving.append(self._present.pop(name))
        known = self._present
        self._present = {name: known.get(name) or Unit(plan) for name, plan in plans.items()}
        for name in plans.keys() - known.keys():
            self._put(self._present[name], "INFO", f"joins the rack, on {plans[name].settings}")

    def look(self) -> None:
        """Take what all units report, and do what is due; waits for none."""
        for unit in self.units:
            if unit.process is not None:
                self._receive(unit, unit.process)
                self._watch(unit, unit.process)
        ending = {unit.plan.name for unit in self._leaving if unit.process is not None}
        for name, unit in self._present.items():
            due = unit.process is None and unit.end_by_s is None and time.monotonic() >= unit.begin_s
            if due and name not in ending:  # its port may be the same
                self._begin(unit)
        if time.monotonic() - self._overview_s >= OVERVIEW_S:
            self._overview_s = time.monotonic()
            self._publish(Overview(_now(), markdown(self.rows), tuple(self._present)))
            with suppress(OSError):  # a disk that is full stops no recording
                self._log.write()

    def stop(self) -> None:
        """End all units in order, and kill those that take longer than `END_S`."""
        for unit in self.units:
            self._end(unit)
        while any(unit.process is not None for unit in self.units):
            self.look()
            time.sleep(STOPPING_S)
        self._overview_s = 0.0
        self.look()

    def as_dict(self) -> dict[str, dict[str, Any]]:
        """Return what ``--json`` holds of all units that were there; one that came back is there once."""
        found: dict[str, dict[str, Any]] = {}
        for unit in [*self._leaving, *self._present.values()]:
            now, before = unit.as_dict(), found.get(unit.plan.name)
            if before is not None:
                now |= {name: [*before[name], *now[name]] for name in ("sessions", "deaths", "interrupted")}
            found[unit.plan.name] = now
        return found

    def _begin(self, unit: Unit) -> None:
        try:
            unit.process = Process(unit.plan, self._folder)
        except (OSError, EOFError) as error:  # no memory, or no processes, for one more
            unit.begin_s = time.monotonic() + LONGEST_PAUSE_S
            self._put(unit, "ERROR", f"its process cannot be begun ({error}); again in {LONGEST_PAUSE_S:g} s")
            return
        unit.silent, unit.vitals = False, Vitals()

    def _end(self, unit: Unit) -> None:
        unit.end_by_s = time.monotonic() + END_S
        if unit.process is not None:
            unit.process.ask_to_end()

    def _receive(self, unit: Unit, process: Process) -> None:
        for message in process.messages():
            for _, level, text in message.lines:
                self._log.put(level, f"{unit.plan.name}: {text}")
            unit.problem = message.problem
            if message.summary is not None:
                unit.summaries.append(message.summary)
            is_back = unit.silent or (unit.deaths and not unit.vitals.session)
            unit.silent, unit.vitals = False, message.vitals
            unit.setup = message.setup or unit.setup
            if is_back:
                self._show(unit, State(_now(), "unit", "recording", Level.GOOD))
            self._show(unit, *message.items)

    def _watch(self, unit: Unit, process: Process) -> None:
        """Find out whether the process of a unit lives and reports."""
        code, now_s = process.exit_code, time.monotonic()
        silent_s = now_s - process.received_s
        if code is not None:
            process.close()
            self._receive(unit, process)
            unit.process = None
            self._note_end(unit, code)
        elif unit.end_by_s is not None:
            if now_s > unit.end_by_s:
                unit.end_by_s = math.inf
                self._put(unit, "ERROR", "did not end, and was killed: what had arrived is on disk")
                process.kill()
        elif silent_s > KILLED_S:
            self._put(unit, "ERROR", f"its process was ended after {silent_s:.0f} s without a report")
            process.kill()
            process.received_s = now_s
        elif silent_s > HANGS_S and not unit.silent:
            unit.silent = True
            self._put(unit, "ERROR", f"its process (pid {process.pid}) hangs: no report for {silent_s:.1f} s")
            self._show(unit, State(_now(), "unit", "HANGS", Level.BAD))

    def _note_end(self, unit: Unit, code: int) -> None:
        """Note that the process of a unit ended, maybe without a request."""
        died = unit.end_by_s is None
        if (died or code) and unit.vitals.session:
            unit.interrupted.append(unit.vitals.session)
        if died:
            unit.deaths.append(code)
            steady = time.monotonic() - unit.begin_s > STEADY_S
            unit.pause_s = FIRST_PAUSE_S if steady else min(2.0 * unit.pause_s, LONGEST_PAUSE_S)
            unit.begin_s = time.monotonic() + unit.pause_s
            how = f"signal {-code}" if code < 0 else f"exit code {code}"
            kept = f"; {unit.vitals.session} has what had arrived" if unit.vitals.session else ""
            self._put(unit, "ERROR", f"its process died ({how}){kept}; a new one in {unit.pause_s:g} s")
            self._show(unit, State(_now(), "unit", f"DEAD: {how}", Level.BAD))

    def _put(self, unit: Unit, level: str, text: str) -> None:
        self._log.put(level, f"{unit.plan.name}: {text}")
        self._show(unit, Log(_now(), text, level))

    def _show(self, unit: Unit, *items: ViewItem) -> None:
        if unit.setup is not None:
            for item in items:
                self._publish(OfUnit(unit.setup, item))


def _now() -> Instant:
    return Instant(None, None, time.time_ns())
