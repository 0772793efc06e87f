"""What is told apart where it is hard: weak loops of relays, a lag from a dead time, and what a model had
inside when it was calibrated.

Usage: closing_the_loop --part paired [--repeat N] [--first SEED]
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace

import closing_the_loop_cases as cases
import numpy as np
from closing_the_loop_cases import BLOCK, Case, Generator, Physics, Setting, Thermal, make_case, relays
from closing_the_loop_live import blocks_of, plain_model
from closing_the_loop_statistics import IN_LIBRARY

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.live import LiveDiagnosis
from imumon.lab.diagnosis.runs import Run
from imumon.lab.diagnosis.verdict import ChannelVerdict
from imumon.models.model import BiasModel

SIZES = (1.0, 2.0, 5.0)
INSIDE = tuple(name for name in IN_LIBRARY if name not in ("step", "run_offset"))
"""Effects that a calibration has inside."""
STRONG = 10.0
LIMIT = 1.3
QUIET_H = (0, 4, 22)
"""Hours at one temperature before two hours that show an effect: means are then of 30, 48 and 96 s."""


def loops(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return loops of relays."""
    seed = int(rng.integers(2**31))
    return [relays(np.random.default_rng(seed), run.board) for run in runs]


def layers(count: int) -> Physics:
    """Return heat through so many layers one after another: a lag of one, nearly a dead time of twenty."""

    def late(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
        total, found = rng.uniform(60, 300), []
        for run in runs:
            value = run.board
            for _ in range(count):
                value = cases._behind(value, total / count)
            found.append(run.board - value)
        return found

    return late


def delay(rng: Generator, runs: list[Thermal], _: int) -> list[FloatArray]:
    """Return what follows the temperature a fixed time later."""
    behind = rng.uniform(40, 300)
    return [run.board - np.interp(run.time_s - behind, run.time_s, run.board) for run in runs]


KINDS: dict[str, tuple[str, Physics]] = {
    "loop of relays": ("hysteresis", loops),
    "lag of one node": ("thermal_lag", layers(1)),
    "lag of two nodes": ("thermal_lag", cases.PHYSICS["thermal_lag"]),
    "twenty layers": ("dead_time", layers(20)),
    "delay": ("dead_time", delay),
}


def paired(repeat: int, first: int, *, quick: bool) -> int:
    """Print the tables."""
    print("| effect | floors | alone | in a set | wrong alone | wrong otherwise | nothing |")
    print("|---|---|---|---|---|---|---|")
    for kind, (name, physics) in list(KINDS.items())[: 1 if quick else None]:
        cases.PHYSICS[name] = physics
        for size in SIZES[: 1 if quick else None]:
            setting = Setting((name,), size, label=kind)
            said = Counter(_said(one, name) for _, one in _verdicts(setting, repeat, first, _nothing_given))
            cells = (said[key] for key in ("alone", "set", "wrong alone", "wrong", "nothing"))
            print(f"| {kind} | {size:g} | {' | '.join(map(str, cells))} |", flush=True)
    print(f"\n| calibrated with it, {STRONG:g} floors | named | after, each axis | above {LIMIT} |")
    print("|---|---|---|---|")
    for at, name in enumerate(INSIDE[: 1 if quick else None]):
        setting = Setting((name,), STRONG, poses=name == "g_sensitivity", label=name)
        found = list(_verdicts(setting, repeat, first + 1000 * at, plain_model))
        right = sum(_said(one, name) in ("alone", "set") for _, one in found)
        after = [one.test_after.rms / floor for floor, one in found if one.test_after is not None]
        above, each = sum(value > LIMIT for value in after), ", ".join(f"{value:.2f}" for value in after)
        print(f"| {name} | {right}/{len(found)} | {each} | {above} |", flush=True)
    print("\n| effect, 5 floors | " + " | ".join(f"after {hours} h" for hours in QUIET_H) + " |")
    print("|---" * (len(QUIET_H) + 1) + "|")
    for name in INSIDE[2 : 3 if quick else 4]:
        late = [_late(name, hours, repeat, first) for hours in QUIET_H[: 1 if quick else None]]
        print(f"| {name} | {' | '.join(late)} |", flush=True)
    return 0


def _late(name: str, hours: int, repeat: int, first: int) -> str:
    """Return in how many sessions an effect is among what is said live at their end."""
    found = 0
    for seed in range(first, first + repeat):
        case = make_case(Setting((name,), 5.0, label=name), seed)
        stage = LiveDiagnosis(plain_model(case))
        for block in blocks_of(_begun_still(case.runs[2], 3600 * hours, seed)):
            stage.process(block)
        found += name in stage.state
    return f"{found}/{repeat}"


def _begun_still(run: Run, seconds: int, seed: int) -> Run:
    """Return a run after so many seconds at the temperature that it begins with, the bias as it is then."""
    rng, mean = np.random.default_rng([seed, 7]), {}
    for key, values in run.mean.items():
        level = values[:BLOCK].mean()
        sd = values[:BLOCK].std() if key != "temperature" else 0.0
        mean[key] = np.concatenate([level + sd * rng.standard_normal(seconds), values])
    n = len(mean["temperature"])
    return replace(run, mean=mean, time_s=np.arange(n, dtype=np.float64) + 0.5, rest=np.ones(n))


def _nothing_given(_: Case) -> None:
    return None


def _verdicts(
    setting: Setting, repeat: int, first: int, given: Callable[[Case], BiasModel | None]
) -> Iterator[tuple[float, ChannelVerdict]]:
    """Yield the noise of all kinds, and the verdict, of each channel."""
    for seed in range(first, first + repeat):
        case = make_case(setting, seed)
        found = diagnose(case.runs[:2], case.runs[2:], sensors=("gyro",), model=given(case))
        for verdict in found.verdicts:
            yield case.floor, verdict


def _said(verdict: ChannelVerdict, name: str) -> str:
    """Return whether an effect is named alone, in a set, not at all, or others in its place."""
    sets = [set(claim.finding.alike or [claim.finding.name]) for claim in verdict.claims]
    if not sets:
        return "nothing"
    if all(name in group for group in sets):
        return "alone" if sets == [{name}] else "set"
    return "wrong alone" if len(sets) == 1 and len(sets[0]) == 1 else "wrong"
