"""Fixtures for every test."""

from __future__ import annotations

import gc
import importlib
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from xdist.scheduler import LoadScopeScheduling

from tests.waiting import LIMIT_S

# As in the command line; read when NumPy is imported, which no test has done yet.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A defect of a stage of imumon ends a live run here, so that no test passes without its columns.
os.environ["IMUMON_STRICT"] = "1"

# Every one of the parallel processes and of the programs that tests start would compile all sources anew.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# Where a failure blocks others, the same examples every time; at home, new ones.
settings.register_profile("ci", derandomize=True, deadline=None)
settings.register_profile("home", deadline=None)  # a machine with other work to do is no failure
settings.load_profile("ci" if os.environ.get("CI") == "true" else "home")

_TESTS = Path(__file__).parent
_COMPILE = _TESTS.parent / "scripts" / "support" / "compile_kernels.py"
_VIEWERS = "viewers"
_LONG = (
    "docs/test_tutorials.py", _VIEWERS, "fleet/batch/test_running.py", "lab/diagnosis/test_diagnose.py",
    "fleet/rack/test_rack.py", "lab/diagnosis/test_poses.py", "configure/test_configure_command.py",
    "estimation/rest/test_turn.py", "run/test_learning.py", "test_reproduce.py", "faults/test_line.py",
    "estimation/temperature_rate/test_method.py", "view/test_recorder.py", "lab/test_diagnose.py",
    "publishing/test_foxglove.py", "lab/test_calibrate.py", "transport/test_reader.py",
    "estimation/gyro_bias/test_consistency.py", "cli/test_align.py", "cli/test_commands.py",
    "transport/test_detect.py", "faults/test_readings.py", "faults/test_killed.py", "faults/test_viewer.py",
    "view/test_terminal.py", "run/test_live.py", "fleet/batch/test_cluster.py", "faults/test_service.py",
)  # fmt: skip
"""These take longest: begun last, they would leave one of the parallel processes alone with one of them.
Some compute and some wait for a device in real time, in turn, so that no core is without work."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add `--all`."""
    parser.addoption("--all", action="store_true", help="run the tests marked `long` too")


def pytest_configure(config: pytest.Config) -> None:
    """Compile what has changed before the first of parallel tests, so that none has to wait, and none twice.

    A few tests in one process compile what they need, and nothing else.
    """
    if config.getoption("numprocesses", None) and not hasattr(config, "workerinput"):
        config.option.loadscopereorder = False  # the groups begin in the order of the tests
        if _COMPILE.exists():
            subprocess.run([sys.executable, _COMPILE], check=True)
    else:
        paths = [str(_TESTS / "as_installed"), os.environ.get("PYTHONPATH", "")]
        os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, paths))


def pytest_collection(session: pytest.Session) -> None:
    """Let each of the parallel processes begin elsewhere: what one has compiled, the others find."""
    gc.disable()  # what is imported stays
    given = getattr(session.config, "workerinput", None)
    if given is not None and _is_whole(session.config):
        files = sorted(_TESTS.rglob("test_*.py"))
        share = -(-len(files) // given["workercount"])
        first = int(given["workerid"].removeprefix("gw")) * share
        for path in files[first : first + share]:
            with suppress(Exception, pytest.skip.Exception):  # the collection will say it
                importlib.import_module(".".join(path.relative_to(_TESTS.parent).with_suffix("").parts))


def _is_whole(config: pytest.Config) -> bool:
    """Return whether no file or test was named."""
    return bool(config.args == config.getini("testpaths"))


@pytest.hookimpl(tryfirst=True)  # xdist looks for the groups in the same hook
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out the long tests unless they or `--all` are named; begin with the groups that take longest."""
    if _is_whole(config) and not config.getoption("all"):
        long = [item for item in items if item.get_closest_marker("long")]
        config.hook.pytest_deselected(items=long)
        items[:] = [item for item in items if not item.get_closest_marker("long")]
    groups = [_group(item.nodeid) for item in items]
    place = {group: _LONG.index(group) if group in _LONG else len(_LONG) for group in groups}
    items.sort(key=lambda item: place[_group(item.nodeid)])


def _group(nodeid: str) -> str:
    """Return what a test belongs to, as its file shares fixtures: the file, or all that start viewers."""
    file = nodeid.partition("::")[0].removeprefix("tests/")
    return _VIEWERS if file in _viewer_files() else file


@cache
def _viewer_files() -> set[str]:
    files = _TESTS.rglob("test_*.py")
    return {file.relative_to(_TESTS).as_posix() for file in files if "mark.viewer" in file.read_text()}


class _ByGroup(LoadScopeScheduling):  # type: ignore[misc]  # xdist has no types
    """Gives each group to one of the parallel processes.

    The marks of `--dist loadgroup` do nothing: pytest 9.2 has other names of tests than xdist 3.8 writes to.
    """

    def _split_scope(self, nodeid: str) -> str:
        return _group(nodeid)


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> _ByGroup:
    """Return what gives the tests to the parallel processes."""
    return _ByGroup(config, log)


def pytest_collection_finish() -> None:
    """Spare the garbage collector what the collection made, which stays until the end."""
    _collect_and_freeze()  # before the collector does so by itself, and then once more here
    gc.enable()


def _collect_and_freeze() -> None:
    """Let the garbage collector look at what is there for the last time: that takes up to 0.3 s."""
    gc.collect()
    gc.freeze()


def pytest_unconfigure() -> None:
    """Let the collector, which pytest calls next, have everything again: else duckdb lists what is alive."""
    gc.unfreeze()


_FD = Path("/proc/self/fd")


def _descriptors() -> set[tuple[str, str]]:
    found = set()
    for entry in _FD.iterdir():
        try:
            found.add((entry.name, str(entry.readlink())))
        except FileNotFoundError:  # the descriptor of the listing itself
            continue
    return found


@pytest.fixture
def no_leaks() -> Iterator[None]:
    """Fail a test that leaves a file descriptor or a thread behind."""
    _collect_and_freeze()
    descriptors, threads = _descriptors(), set(threading.enumerate())
    yield
    end = time.monotonic() + LIMIT_S
    while True:
        gc.collect()
        leaked = sorted(_descriptors() - descriptors)
        running = [thread.name for thread in set(threading.enumerate()) - threads]
        if not leaked and not running:
            return
        if time.monotonic() > end:
            pytest.fail(f"left behind: descriptors {leaked}, threads {running}")
        time.sleep(0.02)
