"""A recording shown again: in a browser until Ctrl-C, and what is said where no window can open."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import urllib.request
from pathlib import Path

import pytest

from tests.cli.command import IMUMON, imumon
from tests.waiting import LIMIT_S


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replayed") / "session"
    assert imumon("simulate", "bench", "--out", folder, "--duration", 3).returncode == 0
    return folder


@pytest.mark.long
@pytest.mark.parametrize(
    ("command", "told"), [(["replay", "--speed", "max"], '"rows": 300'), (["view"], '"samples": 300')]
)
def test_a_session_in_the_browser_is_served_until_it_is_interrupted_and_its_readers_are_reported(
    session: Path, command: list[str], told: str
) -> None:
    process = subprocess.Popen(
        [IMUMON, *command, str(session), "--view", "web", "--bind", "0.0.0.0", "--json"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    assert process.stderr is not None
    said = ""
    for line in process.stderr:
        said += line
        if "until Ctrl-C" in line:
            break
    port = re.search(r"http://\S+:(\d+)/", said)
    assert port, said
    assert "every computer that reaches this one can read" in said
    with urllib.request.urlopen(f"http://127.0.0.1:{port[1]}/", timeout=LIMIT_S) as page:
        assert page.status == 200
    process.send_signal(signal.SIGINT)
    out, rest = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 0, rest
    assert told in out


@pytest.mark.long
def test_without_a_display_a_native_view_reports_it(session: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [name for name in os.environ if "DISPLAY" in name]:
        monkeypatch.delenv(name)
    done = imumon("replay", session, "--view", "native", "--speed", "max")
    assert "there is no display here" in done.stderr
    assert "300" in done.stderr


@pytest.mark.parametrize("address", ["999.1.1.1", "192.0.2.1", "::1"])
def test_an_address_that_is_none_of_this_computer_is_refused(session: Path, address: str) -> None:
    done = imumon("replay", session, "--view", "web", "--bind", address)
    assert done.returncode == 2
    assert f"--bind {address}: is no IPv4 address of this computer" in done.stderr
