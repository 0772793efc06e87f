"""Fixtures for every test."""

from __future__ import annotations

import gc
import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import settings

# Where a failure blocks others, the same examples every time; at home, new ones.
settings.register_profile("ci", derandomize=True)
if os.environ.get("CI") == "true":
    settings.load_profile("ci")

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
    gc.collect()
    descriptors, threads = _descriptors(), set(threading.enumerate())
    yield
    end = time.monotonic() + 2.0
    while True:
        gc.collect()
        leaked = sorted(_descriptors() - descriptors)
        running = [thread.name for thread in set(threading.enumerate()) - threads]
        if not leaked and not running:
            return
        if time.monotonic() > end:
            pytest.fail(f"left behind: descriptors {leaked}, threads {running}")
        time.sleep(0.02)
