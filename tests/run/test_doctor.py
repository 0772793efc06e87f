"""What `imumon doctor` finds, and what it says to do."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace

import pytest

from imumon.errors import ImumonError, Reason
from imumon.run import doctor
from imumon.run.doctor import Finding, State
from imumon.transport.ports import PortInfo
from tests.cli.command import answer, imumon

PORT = PortInfo("/dev/ttyUSB0", "USB serial", 0x403, 0x6001, "A1", "ftdi_sio", None, 1, True, ())


def only(findings: Iterator[Finding]) -> Finding:
    (finding,) = findings
    return finding


def test_a_computer_that_runs_the_tests_has_no_fault(tmp_path: Path) -> None:
    said = answer("doctor", tmp_path / "not" / "yet")
    subjects = {finding["subject"] for finding in said["findings"]}
    assert {"Python", "packages", "compiled code", "disk", "viewer"} <= subjects
    packages = next(f for f in said["findings"] if f["subject"] == "packages")
    assert (packages["state"], packages["remedy"]) == ("good", "")
    for name in ("numpy", "pyserial", "rerun-sdk", "pyyaml"):
        assert f"{name} {metadata.version(name)}" in packages["seen"]
    assert not (tmp_path / "not").exists()


def test_a_missing_package_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def version(name: str) -> str:
        if name in ("scipy", "pyulog"):  # what an extra brings is named when it is needed
            raise metadata.PackageNotFoundError(name)
        return "1.0"

    monkeypatch.setattr(metadata, "version", version)
    (found,) = [finding for finding in doctor.packages() if finding.remedy]
    assert found.state == "fault"
    assert found.remedy == "pip install scipy"


def test_a_person_reads_a_line_per_finding(tmp_path: Path) -> None:
    said = imumon("doctor", tmp_path).stdout
    assert f"packages: imumon {metadata.version('imumon')}" in said
    assert f"free in {tmp_path}" in said


@pytest.mark.parametrize(
    ("port", "state", "remedy"),
    [
        (PORT, "good", ""),
        (replace(PORT, latency_timer_ms=16), "warning", "latency_timer"),
        (replace(PORT, latency_timer_ms=None), "good", ""),
        (replace(PORT, holders=("screen (pid 7)",)), "warning", "end the other"),
    ],
)
def test_a_port_is_evaluated(
    port: PortInfo, state: State, remedy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(doctor, "list_ports", lambda: [port])
    finding = only(doctor.serial_ports())
    assert (finding.subject, finding.state) == ("/dev/ttyUSB0", state)
    assert remedy in finding.remedy
    assert bool(finding.remedy) == (state != "good")


def test_a_port_that_this_user_may_not_open_gets_the_same_advice_as_when_it_is_opened(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "port").touch(0o600)
    monkeypatch.setattr(
        doctor, "list_ports", lambda: [replace(PORT, device=f"{tmp_path}/port", accessible=False)]
    )
    finding = only(doctor.serial_ports())
    assert finding.state == "fault"
    assert "Permission denied" in finding.seen
    assert "udev" in finding.remedy or "group" in finding.remedy


def test_no_port_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "list_ports", list)
    assert "imumon virtual" in only(doctor.serial_ports()).remedy


def test_a_full_disk_and_one_that_cannot_be_written_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=5_000_000))
    assert only(doctor.disk(tmp_path)).state == "warning"
    monkeypatch.setattr(os, "access", lambda *_: False)
    assert only(doctor.disk(tmp_path)).state == "fault"
    assert "NUMBA_CACHE_DIR" in only(doctor.compiled_code()).remedy


def test_a_viewer_that_is_missing_or_does_not_start(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> Path:
        raise ImumonError(Reason.NOT_FOUND, "the Rerun viewer is not installed", "install it")

    monkeypatch.setattr(doctor, "viewer_binary", missing)
    assert next(doctor.viewer()) == Finding(
        "viewer", "fault", "the Rerun viewer is not installed", "install it"
    )
    broken = tmp_path / "rerun"
    broken.write_text("#!/bin/sh\nexit 1\n")
    broken.chmod(0o755)
    monkeypatch.setattr(doctor, "viewer_binary", lambda: broken)
    assert next(doctor.viewer()).state == "fault"


def test_what_draws_the_window(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(doctor, "has_display", lambda: False)
    monkeypatch.setattr(doctor, "VULKAN_DRIVERS", (tmp_path,))
    display, graphics = doctor.graphics()
    assert "--view web" in display.remedy
    assert "no Vulkan driver" in graphics.seen
    (tmp_path / "lvp_icd.json").write_text("{}")
    monkeypatch.setattr(doctor, "has_display", lambda: True)
    assert only(doctor.graphics()).state == "good"
