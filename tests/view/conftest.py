from __future__ import annotations

import os
import socket
import subprocess
from collections.abc import Callable, Iterator

import pytest

from imumon.view.viewer import probe, start_viewer
from tests.needs import need_vulkan
from tests.waiting import wait_until


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
def vulkan() -> None:
    """Skip the test where no viewer can draw."""
    need_vulkan()


@pytest.fixture
def headless() -> Iterator[StartViewer]:
    """Start real viewers without a window; skip the test where none can draw."""
    need_vulkan()
    started: list[subprocess.Popen[bytes]] = []

    def start(port: int) -> subprocess.Popen[bytes]:
        viewer = start_viewer(port, "--headless")
        started.append(viewer)
        assert wait_until(lambda: viewer.poll() is not None or probe(port) is True)
        assert viewer.poll() is None, f"the viewer ended with exit code {viewer.returncode}"
        return viewer

    yield start
    for viewer in started:
        viewer.kill()
        viewer.wait()
