from __future__ import annotations

import os
import socket
import subprocess
import threading
from pathlib import Path

import pytest

from imumon.view.viewer import (
    free_port,
    has_display,
    probe,
    quiet_environment,
    viewer_binary,
)
from tests.waiting import LIMIT_S


def test_binary_is_the_program_itself_not_the_script() -> None:
    with viewer_binary().open("rb") as file:
        assert file.read(2) != b"#!"


def test_nothing_listens(port: int) -> None:
    assert probe(port) is None


def test_a_program_that_accepts_and_sends_nothing_is_silent(port: int) -> None:
    with socket.create_server(("127.0.0.1", port)):
        assert probe(port, timeout_s=0.1) is False


@pytest.mark.parametrize("reply", [b"HTTP/1.1 200 OK\r\nContent-Length: 0\r\n\r\n", b"220 mail ready\r\n"])
def test_another_program_is_distinguished(port: int, reply: bytes) -> None:
    with socket.create_server(("127.0.0.1", port)) as server:

        def answer() -> None:
            connection, _ = server.accept()
            with connection:
                connection.recv(4096)
                connection.sendall(reply)

        thread = threading.Thread(target=answer)
        thread.start()
        assert probe(port, LIMIT_S) is False
        thread.join()


def test_a_port_in_use_is_passed_over(port: int) -> None:
    with socket.create_server(("127.0.0.1", free_port(port))) as server:
        assert server.getsockname()[1] < free_port(port)


def test_a_display_is_found_by_its_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    assert has_display()
    monkeypatch.delenv("DISPLAY")
    assert not has_display()


def test_rerun_writes_no_analytics_with_our_environment(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, port: int
) -> None:
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    environment = {**quiet_environment(), "HOME": str(tmp_path)}
    for name in ("XDG_CONFIG_HOME", "XDG_DATA_HOME"):
        environment.pop(name, None)
    command = [str(viewer_binary()), "--serve-grpc", f"--port={port}", "--bind=127.0.0.1"]
    server = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while not probe(port):
            assert server.poll() is None
    finally:
        server.kill()
        server.wait()
    assert [path for path in tmp_path.rglob("*") if "rerun" in path.name or "analytics" in path.name] == []


def test_environment_leaves_ours_alone() -> None:
    before = dict(os.environ)
    quiet_environment()["NEW"] = "1"
    assert dict(os.environ) == before
