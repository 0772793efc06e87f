"""Replay of a recorded session with all estimators: times real time, and milliseconds a stage takes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import Any

from benchmarks.measure import Bar, Table
from imumon.pipeline import Digest, Pipeline
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.source import open_source, run_over
from imumon.run.setup import Setup
from imumon.run.stages import estimators
from imumon.simulation.recording import record_session
from imumon.simulation.unit import load_scenario

SECONDS = 600.0
RATES_HZ = (100.0, 400.0)
LATITUDE_DEG = 40.93
BAR = 250.0
BAUDRATE = 921_600
"""Enough for the packets at the highest rate."""
CASES: tuple[tuple[str, str, float | None], ...] = (
    ("at rest", "self-heating", None),
    ("at rest, latitude known", "self-heating", LATITUDE_DEG),
    ("handled, rests of 10 s", "warm-up", None),
)
"""What it is called, the scenario, and the latitude that the pipeline knows."""


@dataclass
class Clocked:
    """Processor seconds that each stage took."""

    seconds: dict[str, float] = field(default_factory=dict)

    def watch(self, stage: Any) -> Any:
        """Return the stage with its `process` timed."""
        name, process = type(stage).__name__, stage.process
        self.seconds[name] = 0.0

        def timed(*arguments: Any) -> Any:
            began = process_time()
            try:
                return process(*arguments)
            finally:
                self.seconds[name] += process_time() - began

        stage.process = timed
        return stage


def run() -> tuple[list[Table], list[Bar]]:
    """Record each scenario at each rate, and replay it as `imumon replay --speed max` does."""
    table = Table("Replay with all estimators: ms of processor time per s of data", ["stage"])
    columns: list[dict[str, float]] = []
    bars = []
    with TemporaryDirectory() as folder:
        for name, scenario, latitude in CASES:
            for rate in RATES_HZ:
                cost = _measured(Path(folder) / f"{scenario}-{rate:g}", scenario, rate, latitude)
                speed = 1e3 / sum(cost.values())
                table.headings.append(f"{name}, {rate:g} Hz")
                columns.append({**cost, "x real time": speed})
                if rate == max(RATES_HZ):
                    bars.append(Bar(f"replay at {rate:g} Hz, {name}, x real time", BAR, speed))
    for stage in dict.fromkeys(stage for column in columns for stage in column):
        table.rows.append(
            [stage, *(f"{column[stage]:.3g}" if stage in column else "-" for column in columns)]
        )
    table.notes.append(f"{SECONDS:g} s of data, processor time of one process, compiled before")
    return [table], bars


def _measured(session: Path, scenario: str, rate: float, latitude: float | None) -> dict[str, float]:
    """Return milliseconds per second of data, by stage."""
    if not session.exists():
        _record(session, scenario, rate)
    _replayed(session, latitude, lambda stage: stage)  # compiles
    clocked = Clocked()
    began = process_time()
    _replayed(session, latitude, clocked.watch)
    took = process_time() - began
    parts = {"path": took - sum(clocked.seconds.values()), **clocked.seconds}
    return {name: 1e3 * part / SECONDS for name, part in parts.items()}


def _record(session: Path, scenario: str, rate: float) -> None:
    text, source = device_text("ax1")
    text = text.replace("baudrates: [", f"baudrates: [{BAUDRATE}, ")
    played = load_scenario(scenario).model_copy(update={"duration_s": SECONDS, "rate_hz": rate})
    record_session(played, parse_device(text, source), text, 1, session, lambda _: None)


def _replayed(session: Path, latitude: float | None, watch: Callable[[Any], Any]) -> None:
    source = open_source(session)
    stages = [watch(stage) for stage in estimators(source.device, Setup(latitude_deg=latitude))]
    pipeline, digest = Pipeline(source.device, stages), Digest()
    for block in run_over(source.items, pipeline):
        digest.update(block, pipeline.side)
