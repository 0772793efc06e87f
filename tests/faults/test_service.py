from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from imumon.errors import EXIT_INTERRUPTED, EXIT_NEGATIVE, EXIT_OK, Reason
from imumon.protocols.device import load_device
from imumon.recordings.folder import open_session
from imumon.simulation.virtual_device import VirtualDevice
from tests.cli.command import answer
from tests.faults.service import Service, wait_for_sessions
from tests.waiting import LIMIT_S


@pytest.mark.long
@pytest.mark.usefixtures("no_leaks")
def test_a_recording_that_is_killed_is_begun_again_and_both_sessions_are_good(tmp_path: Path) -> None:
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        service = Service(tmp_path, ahrs.port.path, "ax1")
        try:
            wait_for_sessions(tmp_path, 1, 20_000)
            service.kill()
            first, second = wait_for_sessions(tmp_path, 2, 20_000)
        finally:
            code = service.stop()
    assert (code, service.starts) == (0, 2)
    assert [open_session(path).state for path in (first, second)] == ["interrupted", "closed"]
    for path in (first, second):
        told = answer("replay", path)
        assert told["packets"] > 50  # of 20 kB, with what the file needs of its own for each read
        assert not told["checksum_errors"]
        assert not told["recording"]["damage"]["places"]
    lines = [json.loads(line) for line in (second / "log.jsonl").read_text().splitlines()]
    assert [line["level"] for line in lines if "port opened" in line["text"]] == ["INFO"]


def test_every_exit_code_is_documented() -> None:
    docs = (Path(__file__).parents[2] / "docs" / "reliability.md").read_text(encoding="utf-8")
    table = docs.partition("| exit code |")[2]
    documented = {int(code) for code in re.findall(r"^\| (\d+) \|", table, re.MULTILINE)}
    assert documented == {EXIT_OK, EXIT_INTERRUPTED, *(r.exit_code for r in Reason), EXIT_NEGATIVE}


def test_a_wrong_device_is_not_tried_again(tmp_path: Path) -> None:
    service = Service(tmp_path, "/dev/null", "no-such-device")
    service.child.wait(LIMIT_S)
    service.stop()
    assert service.starts == 1
    assert service.child.returncode == int(service.section["RestartPreventExitStatus"])
