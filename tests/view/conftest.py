from __future__ import annotations

import os
import socket
import subprocess
import time
from collections.abc import Callable, Iterator

import pytest

from imumon.view.viewer import Answer, probe, start_viewer

STARTED_S = 10.0


@pytest.fixture(autouse=True, scope="session")
def _strict_rerun() -> Iterator[None]:
    """Rerun raises instead of warning, in the view processes too."""
    before = os.environ.get("RERUN_STRICT")
    os.environ["RERUN_STRICT"] = "1"
    yield
    if before is None:
        del os.environ["RERUN_STRICT"]
    else:
        os.environ["RERUN_STRICT"] = before


@pytest.fixture
def port() -> int:
    """A port that nobody listens on."""
    with socket.socket() as trial:
        trial.bind(("127.0.0.1", 0))
        return int(trial.getsockname()[1])


StartViewer = Callable[[int], subprocess.Popen[bytes]]


@pytest.fixture
def headless() -> Iterator[StartViewer]:
    """Start real viewers without a window; skip where the machine cannot."""
    started: list[subprocess.Popen[bytes]] = []

    def start(port: int) -> subprocess.Popen[bytes]:
        viewer = start_viewer(port, "--headless")
        started.append(viewer)
        deadline = time.monotonic() + STARTED_S
        while probe(port) is not Answer.RERUN:
            if viewer.poll() is not None or time.monotonic() > deadline:
                pytest.skip(f"the viewer does not start here (exit code {viewer.poll()}): no Vulkan driver?")
            time.sleep(0.05)
        return viewer

    yield start
    for viewer in started:
        viewer.kill()
        viewer.wait()
