"""The page in a browser that draws by software: how old what it says is, with and without other work."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from support.browser import Browser, browser, browser_binary

from benchmarks.live import DEVICE, STARTING_S, monitored
from benchmarks.measure import Bar, Table
from imumon.blocks import FloatArray
from imumon.protocols.device import load_device
from imumon.run.marks import ask_for_mark
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.reader import EventKind

RATE_HZ = 100.0
OTHERS = (0, 2)
"""Programs beside it that only compute."""
MARKS, EVERY_S, ASKED_S = 25, 3.0, 0.1
LATEST_S = 60.0
"""A mark that has not been seen by then has not come."""
OLDEST_S = 5.0
TEXT = "(document.getElementById('newest') || {}).textContent || ''"


def run() -> tuple[list[Table], list[Bar]]:
    """Mark a live recording again and again, and ask the page when it says so."""
    binary = browser_binary()
    if binary is None:
        sys.exit("no Chromium here: apt install chromium")
    table = Table(
        "Newest line of the page in a browser", ["programs beside it", "p50", "p90", "longest", "load"]
    )
    bars = []
    for others in OTHERS:
        ages = _ages_s(binary, others)
        middle, most = np.quantile(ages, (0.5, 0.9))
        longest = float(ages.max())
        figures = [f"{value:.2f} s" for value in (middle, most, longest)]
        table.rows.append([str(others), *figures, f"{os.getloadavg()[0]:.1f}"])
        bars.append(Bar(f"newest line beside {others} programs, s", OLDEST_S, longest, at_most=True))
    table.notes.append(
        f"from `imumon mark`, {MARKS} times, to the page of a monitor at {RATE_HZ:g} Hz; others: programs"
        " that only compute; Chromium without a window draws by software on the"
        f" {os.cpu_count()} cores that all have"
    )
    return [table], bars


def _ages_s(binary: str, others: int) -> FloatArray:
    with (
        TemporaryDirectory(prefix="imumon-") as name,
        VirtualDevice(load_device(DEVICE), Path(name) / "ahrs", RATE_HZ) as ahrs,
        monitored(ahrs.port.path, Path(name), "web"),
        browser(binary) as page,
    ):
        page.open(_address(Path(name) / "said"))
        _wait_for(page, "Port")
        with _computing(others):
            return np.array([_age_s(page, Path(name) / "session", f"mark-{k}-") for k in range(MARKS)])


def _address(said: Path) -> str:
    """Return where the page is, when the monitor has said so."""
    deadline = time.monotonic() + STARTING_S
    while not (found := re.search(r"http://127\.0\.0\.1:\d+", said.read_text(encoding="utf-8"))):
        if time.monotonic() > deadline:
            sys.exit("the monitor shows no page")
        time.sleep(ASKED_S)
    return found[0]


def _age_s(page: Browser, session: Path, text: str) -> float:
    """Mark the recording; return how long it took until the page said so."""
    began = time.monotonic()
    ask_for_mark(session, EventKind.MARK, text)
    took = _wait_for(page, text) - began
    time.sleep(max(EVERY_S - took, 0.0))
    return took


def _wait_for(page: Browser, text: str) -> float:
    """Return when the page has said a text."""
    deadline = time.monotonic() + LATEST_S
    while text not in page.call("Runtime.evaluate", expression=TEXT)["result"].get("value", ""):
        if time.monotonic() > deadline:
            sys.exit(f"the page has not said {text!r} for {LATEST_S:g} s")
        time.sleep(ASKED_S)
    return time.monotonic()


@contextmanager
def _computing(count: int) -> Iterator[None]:
    programs = [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(count)]
    try:
        yield
    finally:
        for program in programs:
            program.kill()
            program.wait()
