"""The systemd unit without systemd: its command is started again whenever it ends, as the unit says."""

from __future__ import annotations

import configparser
import os
import shlex
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

from tests.waiting import LIMIT_S

UNIT = Path(__file__).parents[2] / "configs" / "systemd" / "imumon@.service"


class Service:
    """Runs the command of the unit in a folder until it is stopped."""

    def __init__(self, folder: Path, port: str, device: str) -> None:
        parser = configparser.ConfigParser(interpolation=None)
        parser.optionxform = str  # type: ignore[assignment,method-assign]  # as configparser's manual says
        parser.read(UNIT, encoding="utf-8")
        self.section = parser["Service"]
        values = {"PORT": port, "DEVICE": device}
        self._command = [
            values.get(word.removeprefix("${").removesuffix("}"), word)
            for word in shlex.split(self.section["ExecStart"])
        ]
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        self._options = {"cwd": folder, "env": {**os.environ, "PATH": path}}
        self.starts = 0
        self._stopping = threading.Event()
        self.child: subprocess.Popen[bytes] = self._start()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _start(self) -> subprocess.Popen[bytes]:
        self.starts += 1
        return subprocess.Popen(self._command, stderr=subprocess.DEVNULL, **self._options)  # type: ignore[call-overload,no-any-return]

    def _run(self) -> None:
        while True:
            code = self.child.wait()
            if self._stopping.wait(float(self.section["RestartSec"])):
                return
            if str(code) in self.section["RestartPreventExitStatus"].split():
                return
            self.child = self._start()

    def kill(self) -> None:
        """Kill the program as a crash does."""
        self.child.send_signal(signal.SIGKILL)

    def stop(self) -> int:
        """End the program as systemd does; return its exit code."""
        self._stopping.set()
        self.child.terminate()
        code = self.child.wait(float(self.section["TimeoutStopSec"]))
        self._thread.join()
        return code


def wait_for_sessions(folder: Path, count: int, size: int) -> list[Path]:
    """Wait until there are so many sessions with so many bytes each; return them, oldest first."""
    end = time.monotonic() + LIMIT_S
    while time.monotonic() < end:
        made = sorted(path for path in folder.glob("sessions/*/wire.mcap") if path.stat().st_size >= size)
        if len(made) >= count:
            return [path.parent for path in made]
        time.sleep(0.05)
    raise TimeoutError(f"no {count} sessions in {folder}")
