"""The installed command, and the map of a table, for the tests that run it as a user does."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

IMUMON = str(Path(sys.executable).with_name("imumon"))
MAP = """
time: {column: t, unit: s}
gyro: {columns: [gx, gy, gz], unit: rad/s}
temperature: {columns: [temp], unit: degC}
"""


def imumon(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [IMUMON, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=170, check=False)
