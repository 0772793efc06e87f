"""What no effect of the library is: how often a formula is offered, how well it predicts, how often falsely.

Usage: closing_the_loop --part formulas [--repeat N] [--first SEED]
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from closing_the_loop_cases import GRAVITY, OUTSIDE, Case, Setting, make_case
from closing_the_loop_drivers import add, behind, make
from closing_the_loop_statistics import share

from imumon.blocks import FloatArray
from imumon.diagnosis.engine import diagnose
from imumon.diagnosis.recording import Run

Generator = np.random.Generator
SIZE = 8.0
"""What the declared model leaves of the effect, in floors."""


def rate_of_either_sign(rng: Generator, run: Run, _: int) -> FloatArray:
    """Return a package that is strained by any gradient: |dT/dt|, of a node behind the thermometer's."""
    return np.abs(np.gradient(behind(run.mean["temperature"], rng.uniform(20, 60))))


def warm_and_loaded(rng: Generator, run: Run, axis: int) -> FloatArray:
    """Return a mount that creeps under its load, the faster the warmer: T g² through a leaky integral."""
    load = (run.mean["temperature"] - 25.0) / 15.0 * (run.mean[f"accel_{'xyz'[axis]}"] / GRAVITY) ** 2
    return behind(np.concatenate([[0.0], load]), rng.uniform(200, 600))[1:]


def rate_by_supply(_: Generator, run: Run, __: int) -> FloatArray:
    """Return a heater's gradient times a supply."""
    return np.gradient(behind(run.mean["temperature"], 20.0)) * run.mean["supply_voltage"]


def joule(rng: Generator, run: Run, _: int) -> FloatArray:
    """Return the heat of a load, its square, behind two nodes."""
    return behind(behind(run.mean["supply_voltage"] ** 2, rng.uniform(150, 400)), 30.0)


def two_drivers(_: Generator, run: Run, __: int) -> FloatArray:
    """Return the product of two drivers."""
    return run.mean["supply_voltage"] * run.mean["swing_1"]


@dataclass(frozen=True, slots=True)
class Kind:
    """A kind of case: what makes the bias, and the names that a formula of it has."""

    made: Callable[[Generator, Run, int], FloatArray]
    names: tuple[str, ...]
    poses: bool = False


KINDS = {
    "|dT/dt|": Kind(rate_of_either_sign, ("|rate(temperature",)),
    "leaky integral of T g²": Kind(warm_and_loaded, ("leak(", "temperature", "accel"), poses=True),
    "dT/dt times supply": Kind(rate_by_supply, ("rate(temperature", "supply_voltage")),
    "supply² behind a lag": Kind(joule, ("supply_voltage^2",)),
    "product of two drivers": Kind(two_drivers, ("supply_voltage", "swing_1")),
}


@dataclass(frozen=True, slots=True)
class Row:
    """What became of a channel; rms of the test in floors."""

    label: str
    unexplained: bool
    named: bool
    text: str
    before: float
    after: float


def driven_case(kind: Kind, seed: int) -> Case:
    """Return a case with ten further columns whose bias is of a kind."""
    setting = Setting((), SIZE, poses=kind.poses, driver="none")
    case = make(setting, seed)
    added = [
        [kind.made(np.random.default_rng([seed, axis]), run, axis) for axis in range(3)] for run in case.runs
    ]
    add(case, case.runs, added, setting)
    return case


def rows(label: str, case: Case) -> list[Row]:
    """Return what becomes of the channels of a case."""
    found = []
    for verdict in diagnose(case.runs[:2], case.runs[2:], sensors=("gyro",)).verdicts:
        assert verdict.test_before is not None
        assert verdict.test_after is not None
        one = verdict.formula
        text = "" if one is None else " + ".join(str(node) for node, _ in one.terms)
        after = verdict.test_after.rms if one is None else one.test_rms
        found.append(
            Row(
                label,
                verdict.unexplained,
                bool(verdict.claims),
                text,
                verdict.test_before.rms / case.floor,
                after / case.floor,
            )
        )
    return found


def formulas(repeat: int, first: int, *, quick: bool) -> int:
    """Print how often a formula is found where there is one, and where there is none."""
    seeds = range(first, first + (1 if quick else repeat))
    kinds = dict([*KINDS.items()][:1]) if quick else KINDS
    positive = [
        row for name, kind in kinds.items() for s in seeds for row in rows(name, driven_case(kind, s))
    ]
    print("\n| driven by | right terms | any formula | test before | after, median | within 1.6 |")
    print("|---|---|---|---|---|---|")
    for name, kind in kinds.items():
        of = [row for row in positive if row.label == name]
        right = [row for row in of if row.text and all(part in row.text for part in kind.names)]
        print(
            f"| {name} | {share(len(right), len(of))} | {share(sum(bool(row.text) for row in of), len(of))} |"
            f" {np.median([row.before for row in of]):.1f} | {np.median([row.after for row in of]):.2f} |"
            f" {share(sum(row.after <= 1.6 for row in of), len(of))} |"
        )
    print("\n| nothing that a formula has | channels | unexplained | formula offered |\n|---|---|---|---|")
    negative = _cases(("",), seeds, 0.0)
    if not quick:
        negative += [*_cases(OUTSIDE, seeds, 5.0), *_cases(LIBRARY, seeds, 5.0)]
    for label in dict.fromkeys(row.label for row in negative):
        of = [row for row in negative if row.label == label]
        offered = [row.text for row in of if row.text]
        print(
            f"| {label} | {len(of)} | {sum(row.unexplained for row in of)} |"
            f" {share(len(offered), len(of))} {'; '.join(offered)} |"
        )
    total = sum(bool(row.text) for row in negative)
    print(f"\nOffered where there is none: {share(total, len(negative))}.")
    return 0


LIBRARY = ("hysteresis", "thermal_lag", "stress_relaxation", "step")


def _cases(names: Sequence[str], seeds: Sequence[int], size: float) -> list[Row]:
    """Return the rows of cases of the library, of what is outside, or (no name) of each kind of noise."""
    found = []
    for seed in seeds:
        for name in names:
            for noise in ("flicker",) if name else ("white", "flicker", "walk"):
                setting = Setting((name,) if name else (), size, noise=noise, driver="none")
                case = make(setting, seed) if seed % 2 else make_case(setting, seed)
                found += rows(name or f"noise, {noise}", case)
    return found
