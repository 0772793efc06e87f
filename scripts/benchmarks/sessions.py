"""Whole commands: how long they take to start, and a replay with all estimators, stage by stage."""

import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

from study import Cells, Table

from benchmarks.decoding import samples
from benchmarks.measure import Bar, Result
from imumon.cli import commands as all_commands
from imumon.pipeline import Digest, Pipeline
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.recordings.source import open_source, run_over
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from imumon.simulation.recording import record_session
from imumon.simulation.unit import load_scenario

ROUNDS = 5
PACKETS = 1000
IMUMON = "from imumon.cli import main; main()"
SECONDS, RATES_HZ = 600.0, (100.0, 400.0)
LATITUDE_DEG = 40.93
LEAST_SPEED = 250.0
"""Bar of a replay at the highest rate, times real time."""
BAUDRATE = 921_600
"""Enough for the packets at the highest rate."""
CASES: tuple[tuple[str, str, float | None], ...] = (
    ("at rest", "self-heating", None),
    ("at rest, latitude known", "self-heating", LATITUDE_DEG),
    ("handled, rests of 10 s", "warm-up", None),
)
"""What it is called, the scenario, and the latitude that the pipeline knows."""


def start() -> Result:
    """Start each command several times, in turn, beside a bare Python and NumPy; the best CPU time counts."""
    with TemporaryDirectory() as folder:
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
    rows: list[Cells] = [[name, seconds, seconds / best["import numpy"]] for name, seconds in best.items()]
    heads, formats = ["command", "CPU s", "× import numpy"], ("", ".2f", ".1f")
    table = Table("## Start of a command, kernels compiled", heads, rows, formats=formats)
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


def replay() -> Result:
    """Record each scenario at each rate, and replay it as `imumon replay --speed max` does."""
    columns: dict[str, dict[str, float]] = {}
    bars = []
    with TemporaryDirectory() as folder:
        for name, scenario, latitude in CASES:
            for rate in RATES_HZ:
                cost = _measured(Path(folder) / f"{scenario}-{rate:g}", scenario, rate, latitude)
                speed = 1e3 / sum(cost.values())
                columns[f"{name}, {rate:g} Hz"] = {**cost, "x real time": speed}
                if rate == max(RATES_HZ):
                    bars.append(Bar(f"replay at {rate:g} Hz, {name}, x real time", LEAST_SPEED, speed))
    stages = dict.fromkeys(stage for column in columns.values() for stage in column)
    rows: list[Cells] = [[stage, *(of.get(stage, 0.0) for of in columns.values())] for stage in stages]
    title = "## Replay with all estimators: ms of processor time per s of data"
    note = f"{SECONDS:g} s of data, processor time of one process, compiled before."
    return [Table(title, ["stage", *columns], rows, note, ("", *[".3g"] * len(columns)))], bars


def _measured(session: Path, scenario: str, rate: float, latitude: float | None) -> dict[str, float]:
    """Return milliseconds per second of data, by stage."""
    if not session.exists():
        text, source = device_text("ax1")
        text = text.replace("baudrates: [", f"baudrates: [{BAUDRATE}, ")
        played = load_scenario(scenario).model_copy(update={"duration_s": SECONDS, "rate_hz": rate})
        record_session(played, parse_device(text, source), text, 1, session, lambda _: None)
    _replayed(session, latitude, lambda stage: stage)  # compiles
    seconds: defaultdict[str, float] = defaultdict(float)

    def watch(stage: Any) -> Any:
        process = stage.process

        def timed(*arguments: Any) -> Any:
            began = process_time()
            try:
                return process(*arguments)
            finally:
                seconds[type(stage).__name__] += process_time() - began

        stage.process = timed
        return stage

    began = process_time()
    _replayed(session, latitude, watch)
    parts = {"path": process_time() - began - sum(seconds.values()), **seconds}
    return {name: 1e3 * part / SECONDS for name, part in parts.items()}


def _replayed(session: Path, latitude: float | None, watch: Callable[[Any], Any]) -> None:
    source = open_source(session)
    stages = [watch(stage) for stage in estimators(source.device, Setup(latitude_deg=latitude))]
    pipeline, digest = Pipeline(source.device, stages), Digest()
    for block in run_over(source.items, pipeline):
        digest.update(block, pipeline.side)
