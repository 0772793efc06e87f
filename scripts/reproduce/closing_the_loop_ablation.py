"""What each mechanism of the diagnosis is worth: simulated cases and the measured chamber without it."""

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from ablations import PAGE, Change, changed
from closing_the_loop_measured import chamber_run, split
from closing_the_loop_statistics import Result, is_outside, jobs, right, run_case
from study import Options, Study, Table, spread

from imumon.lab.diagnosis import candidates, claims, likelihood, search
from imumon.lab.diagnosis import diagnose as engine
from imumon.lab.diagnosis.candidates import Candidate
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.search import PROVEN_GAIN

SHARES = (0.5, 0.55, 0.6, 0.65, 0.7, 0.75)
"""Of the chamber's record that is trained on."""
TITLE = (
    "Diagnosis without one mechanism. Right: channels of simulated cases whose effects are named, or that are"
    " rightly called unexplained or empty. False: names where nothing is missing or nothing of the library is"
    " right. Left: what is left of the tests over that of the whole diagnosis, geometric mean and worst case."
    " Chamber: °/s that x and z are left with, rms over trainings on 50 to 75 % of the record, and x by the"
    " whole record on its own course once more."
)
SIZES = (0.0, 5.0)
"""White floors of the effects in the cases that are run, none of which has other drivers than temperature."""
_candidates, _add_families = candidates.candidates, search._add_families
_refine_each = search.AxisSearch._refine_each


def _untried(unwanted: Callable[[Candidate], bool]) -> Change:
    """Return the change by which such candidates are not tried."""

    def fewer(*given: Any) -> list[Candidate]:
        return [one for one in _candidates(*given) if not unwanted(one)]

    return [(search, "candidates", fewer)]


def _family(name: str) -> Change:
    return _untried(lambda one: one.parts[0].effect.name == name)


def _without_noise(number: int) -> Change:
    return [(likelihood, "NOISE_GRID", [noise for noise in likelihood.NOISE_GRID if not noise[number]])]


def _each_alone(active: Sequence[search.AxisSearch], bar: float) -> None:  # noqa: ARG001 - as what it replaces
    for one in active:
        _add_families([one], PROVEN_GAIN)


def _without_exchange(axis: search.AxisSearch, exchange: bool) -> None:  # noqa: ARG001 - as what it replaces
    _refine_each(axis, exchange=False)


MECHANISMS: Mapping[str, Change] = {
    "choice over all axes": [(search, "_add_families", _each_alone)],
    "pairs of effects at once": [(search.AxisSearch, "_beside_partner", lambda _self, _scored, _best: {})],
    "exchange at the end": [(search.AxisSearch, "_refine_each", _without_exchange)],
    "least share of the largest effect": [(search, "SECOND_SHARE", 0.0)],
    "shorter blocks for short runs": [(engine, "BLOCK_DIVISORS", (1,))],
    "refinement of parameters": [(search, "REFINEMENTS", 0)],
    "flicker in the noise": _without_noise(0),
    "walk in the noise": _without_noise(1),
    "rejected by the test": [(claims, "_not_refuted", lambda _channel, findings: (list(findings), []))],
    "chosen by the test": [(claims, "_proven_by_test", lambda *_given: None)],
    "eight floors of what the test chooses": [(claims, "FLOORS_BY_TEST", 0.0)],
    "free state at power-on": _untried(lambda one: one.free_start),
    "coefficients of each run": _untried(lambda one: one.scope == "either" and not one.shared),
    "a curve that is late as a whole": _untried(lambda one: len(one.parts) > 1),
    "followers of the third order": _untried(lambda one: getattr(one.parts[0].effect, "order", 1) > 1),
    "smooth loops": _untried(
        lambda one: any(getattr(part.effect, "shape", "") == "smooth" for part in one.parts)
    ),
    **{name: _family(name) for name in ("stress_relaxation", "dead_time", "drift")},
}
"""What is left out, one by one."""


def _case(job: tuple[str, Any]) -> list[Result]:
    with changed(MECHANISMS.get(job[0], ())):
        return run_case(job[1])


def _chamber(name: str, folder: Path) -> list[float]:
    """Return what x and z are left with, °/s, and x by the whole record on the same course once more."""
    run = chamber_run(folder)
    with changed(MECHANISMS.get(name, ())):
        found = [diagnose(*split(run, share), sensors=("gyro",)).verdicts for share in SHARES]
        again = replace(run, name="the same course once more", start_ns=10**13)
        whole = diagnose([run], [again], sensors=("gyro",)).verdicts[0]
    left = [[v.prediction.rms for v in verdicts] for verdicts in found]
    x, _, z = np.degrees(np.sqrt(np.mean(np.square(left), axis=0))).tolist()
    return [x, z, float(np.degrees(whole.prediction.rms))]


def _row(name: str, found: Sequence[Result], base: Sequence[Result], chamber: Sequence[float]) -> list[str]:
    empty = [one for one in found if not one.truth or is_outside(one.label)]
    false = sum(bool(one.named) for one in empty)
    ratios = np.array([one.after / other.after for one, other in zip(found, base, strict=True)])
    ratios = np.where(np.isfinite(ratios), ratios, 1.0)
    at = int(np.argmax(np.abs(np.log(ratios))))
    worst = f"{ratios[at]:.2f} ({found[at].label}, {found[at].size:g})"
    mean = float(np.exp(np.mean(np.log(ratios))))
    cells = [name, f"{sum(map(right, found))}/{len(found)}", f"{false}/{len(empty)}", f"{mean:.3f}", worst]
    return [*cells, *(f"{value:.3f}" for value in chamber)]


HEADS = ("without", "right", "false", "left, ×", "worst, ×", "chamber x", "z", "whole x")


def tables(given: Options) -> Iterator[Table]:
    """Yield the table."""
    cases = [
        case
        for case in jobs(len(given.seeds), "lag and" if given.quick else "", given.seeds[0])
        if case[0].size in SIZES and not case[0].driver and "one axis" not in case[0].label
    ]
    rows: list[list[str]] = []
    base: list[Result] = []
    for name in ["none", *MECHANISMS][: 2 if given.quick else None]:
        each = spread(_case, [(name, case) for case in cases], given.jobs)
        found = [result for results in each for result in results]
        base = base or found
        rows.append(_row(name, found, base, _chamber(name, given.data / "chamber-cycle")))
        print(*rows[-1], sep=" | ", file=sys.stderr, flush=True)
    title = f"{TITLE}  {len(cases)} cases, first seed {given.seeds[0]}."
    yield Table(title, HEADS, rows)


STUDY = Study(tables, seeds=4, first=900, page=PAGE)
