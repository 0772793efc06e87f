"""Commands as a user runs them: in this process, or as the installed program where a process is the point."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from contextlib import chdir
from pathlib import Path
from typing import Any

from click.testing import CliRunner

from imumon.cli import run
from imumon.protocols.device import device_text

IMUMON = str(Path(sys.executable).with_name("imumon"))
MAP = """
time: {column: t, unit: s}
gyro: {columns: [gx, gy, gz], unit: rad/s}
temperature: {columns: [temp], unit: degC}
"""
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def imumon(*arguments: object, cwd: Path = Path()) -> subprocess.CompletedProcess[str]:
    """Run a command in this process, which saves its start; outputs and exit code are those of a real one."""
    given, handlers = [*map(str, arguments)], [signal.getsignal(number) for number in SIGNALS]
    with CliRunner().isolation() as (out, err, _), chdir(cwd):
        try:
            code = run(given)
        finally:
            for number, handler in zip(SIGNALS, handlers, strict=True):
                signal.signal(number, handler)
    return subprocess.CompletedProcess(given, code, out.getvalue().decode(), err.getvalue().decode())


def device(folder: Path, *changes: tuple[str, str]) -> Path:
    """Write the device file of the AX1 with changes."""
    text, _ = device_text("ax1")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "device.yaml").write_text(text, encoding="utf-8")
    return folder / "device.yaml"


def answer(*arguments: object) -> dict[str, Any]:
    """Return what ``--json`` prints; standard output holds nothing else."""
    done = imumon(*arguments, "--json")
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert isinstance(result, dict)
    return result
