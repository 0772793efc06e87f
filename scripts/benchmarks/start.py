"""How long commands take to start, in CPU time, beside a bare Python and one that imports NumPy."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage

from benchmarks.measure import Bar, Table
from benchmarks.streams import samples
from imumon.cli import commands as all_commands
from imumon.protocols.device import load_device

ROUNDS = 5
PACKETS = 1000
IMUMON = "from imumon.cli import main; main()"


def run() -> tuple[list[Table], list[Bar]]:
    """Start each command several times, in turn; the best counts."""
    with tempfile.TemporaryDirectory() as folder:
        capture = Path(folder, "capture.bin")
        capture.write_bytes(b"".join(load_device("ax1").encoder().encode(samples(PACKETS))))
        decode = ["decode", str(capture), "--device", "ax1", "--out", str(Path(folder, "table.parquet"))]
        commands = {
            "python": ["-c", "pass"],
            "import numpy": ["-c", "import numpy"],
            "imumon --help": ["-c", IMUMON, "--help"],
            **{f"imumon {name} --help": ["-c", IMUMON, name, "--help"] for name in all_commands()},
            f"imumon decode, {PACKETS} packets": ["-c", IMUMON, *decode],
        }
        best = dict.fromkeys(commands, float("inf"))
        for _ in range(ROUNDS):
            for name, arguments in commands.items():
                best[name] = min(best[name], _cpu_seconds(arguments))
    table = Table("Start of a command, kernels compiled", ["command", "CPU s", "× import numpy"])
    table.rows = [[name, f"{s:.2f}", f"{s / best['import numpy']:.1f}"] for name, s in best.items()]
    helps = max(seconds for name, seconds in best.items() if name.endswith("--help"))
    return [table], [
        Bar("longest --help, CPU s", 0.3, helps, at_most=True),
        Bar("decode of a small file, CPU s", 1.0, best[f"imumon decode, {PACKETS} packets"], at_most=True),
    ]


def _cpu_seconds(arguments: list[str]) -> float:
    before = getrusage(RUSAGE_CHILDREN)
    subprocess.run([sys.executable, *arguments], capture_output=True, check=True)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
