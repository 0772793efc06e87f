"""Plug-ins as the command line has them: listed, left out, named when they are broken."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from imumon import plugins
from imumon.protocols.device import device_text
from tests.cli.command import answer, imumon

MODULE = """
from pathlib import Path

import numpy as np

from imumon import Column
from imumon.effects.since_power_on import Drift

DEVICES = Path(__file__).with_name("devices")


class Doubled:
    columns = (Column("doubled", "rad/s"),)

    def process(self, block):
        return {"doubled": 2.0 * block["gyro_x"]}

    def notices(self):
        return []


def broken():
    raise RuntimeError("no licence")
"""
ENTRIES = """
[imumon.stages]
doubled = their_module:Doubled
broken = their_module:broken
[imumon.devices]
theirs = their_module:DEVICES
[imumon.effects]
creep = their_module:Drift
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """An installed package with plug-ins, two of which do not load."""
    (tmp_path / "their_module.py").write_text(MODULE)
    (tmp_path / "devices").mkdir()
    text = device_text("ax1")[0].replace("name: ax1", "name: theirs")
    (tmp_path / "devices" / "theirs.yaml").write_text(text)
    said = tmp_path / "their_package-1.2.dist-info"
    said.mkdir()
    (said / "METADATA").write_text("Metadata-Version: 2.1\nName: their-package\nVersion: 1.2\n")
    (said / "entry_points.txt").write_text(ENTRIES)
    monkeypatch.syspath_prepend(tmp_path)
    plugins.plugins.cache_clear()
    yield
    plugins.plugins.cache_clear()


@pytest.mark.usefixtures("package")
def test_plugins_are_listed_with_package_and_problem() -> None:
    done = imumon("plugins", "--json")
    assert done.returncode == 1
    found = {plugin["name"]: plugin for plugin in json.loads(done.stdout)["plugins"]}
    assert {(plugin["package"], plugin["version"]) for plugin in found.values()} == {("their-package", "1.2")}
    assert found["doubled"]["brings"] == ["doubled"]
    assert found["theirs"]["brings"] == ["theirs"]
    assert "makes no stage: RuntimeError: no licence" in found["broken"]["problem"]
    assert "is no effect of that name" in found["creep"]["problem"]
    shown = imumon("plugins").stdout
    assert "doubled        imumon.stages of their-package 1.2" in shown
    assert "does NOT load: the plug-in broken of their-package" in shown


@pytest.mark.usefixtures("package")
def test_a_run_without_plugins_loads_none() -> None:
    assert "theirs" in answer("devices")
    plugins.plugins.cache_clear()
    assert imumon("--without-plugins", "devices", "theirs").returncode == 2
    assert imumon("--without-plugins", "plugins").stdout == "no plug-ins\n"
    assert plugins.WITHOUT not in os.environ
