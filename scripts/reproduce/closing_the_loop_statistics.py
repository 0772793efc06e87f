"""Statistics of `imumon diagnose` on simulated cases: what is named, how often, and what is left."""

import math
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import groupby

import numpy as np
from closing_the_loop_cases import Setting, make_case
from closing_the_loop_physics import DRIVING, OUTSIDE
from study import Cell, Cells, Options, Study, Table, spread

from imumon.lab.diagnosis.diagnose import diagnose

IN_LIBRARY = (
    "temperature_curve",
    "temperature_rate",
    "thermal_lag",
    "hysteresis",
    "warm_up",
    "drift",
    "step",
    "run_offset",
    "periodic",
    "g_sensitivity",
    "stress_relaxation",
    "dead_time",
)
COLUMNS = "ten columns"
"""Label of the cases with further columns that have nothing to do with the bias."""
DRIVEN = "driven: "
HIDDEN = "not recorded: "
"""Label of the cases that are driven by what is kept from the diagnosis."""
BESIDE = ("thermal_lag", "hysteresis", "warm_up", "drift", "temperature_rate", "telegraph", "slow wander")
FIRST = 10
"""Those of the library when the cases were numbered: others come last, so that no seed changes."""
SIZES = (0.5, 1.0, 2.0, 5.0, 10.0)
LIMIT, LOOP_LIMIT = 1.3, 1.6
"""Errors of a good prediction, in floors of all noise; of a loop, whose shape no operator has exactly."""
QUICK = "ten columns, white"


@dataclass(frozen=True, slots=True)
class Result:
    """What became of one channel of a case; rms in standard deviations of all noise."""

    label: str
    size: float
    seed: int
    channel: int
    truth: tuple[str, ...]
    named: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    unexplained: bool
    before: float
    after: float
    tracked: float
    seconds: float


def settings() -> list[Setting]:
    """Return the kinds of cases, a label for each."""
    found = [
        Setting((name,), size, poses=name == "g_sensitivity", label=name)
        for name in IN_LIBRARY[:FIRST]
        for size in SIZES
    ]
    found += [Setting((name,), size, label=name) for name in OUTSIDE for size in (3.0, 5.0, 10.0)]
    found += [
        Setting((), 0.0, noise=noise, label=f"nothing, {noise}") for noise in ("white", "flicker", "walk")
    ]
    found += [Setting((name,), 5.0, axes=(1,), label=f"{name}, one axis") for name in IN_LIBRARY[:9]]
    found += [
        Setting(("thermal_lag", "drift"), 5.0, label="lag and drift"),
        Setting(("hysteresis", "warm_up"), 5.0, label="hysteresis and warm-up"),
        Setting(("temperature_rate", "periodic"), 5.0, label="rate and period"),
        Setting(("step", "warm_up"), 5.0, label="step and warm-up"),
        Setting(("thermal_lag",), 5.0, turn_on_dph=8.0, label="lag, turn-on offsets"),
        Setting(("hysteresis",), 5.0, turn_on_dph=8.0, label="hysteresis, turn-on offsets"),
        Setting(("warm_up",), 5.0, unequal=True, label="unequal warm-up"),
        Setting(("drift",), 5.0, unequal=True, label="unequal drift"),
        Setting(("thermal_lag",), 5.0, start_off_degc=8.0, label="lag, start out of equilibrium"),
        Setting(("hysteresis",), 5.0, start_off_degc=8.0, label="hysteresis, start out of equilibrium"),
        Setting(("thermal_lag",), 5.0, poses=True, latitude_deg=50.0, label="lag, poses, earth rate"),
        Setting(("g_sensitivity",), 5.0, poses=True, latitude_deg=50.0, label="g sensitivity, earth rate"),
    ]
    found += [Setting((name,), size, label=name) for name in IN_LIBRARY[FIRST:] for size in SIZES]
    found += [Setting((name,), 5.0, axes=(1,), label=f"{name}, one axis") for name in IN_LIBRARY[FIRST:]]
    found += [
        Setting((), 0.0, noise=noise, driver="none", label=f"{COLUMNS}, {noise}")
        for noise in ("white", "flicker", "walk")
    ]
    found += [Setting((name,), 5.0, driver="none", label=f"{COLUMNS}, {name}") for name in BESIDE]
    found += [Setting((), size, driver=name, label=f"{DRIVEN}{name}") for name in DRIVING for size in SIZES]
    found += [Setting(("thermal_lag", "hysteresis"), 5.0, label="lag and loop")]
    # What goes with the temperature is rightly named as an effect of it.
    unseen = [name for name in DRIVING if name != "gradient"]
    found += [
        Setting((), size, driver=name, label=f"{HIDDEN}{name}")
        for name in unseen
        for size in (3.0, 8.0, 15.0)
    ]
    found += [Setting(("bent",), size, late=True, label="bent curve, late") for size in (5.0, 10.0)]
    return found


def run_case(job: tuple[Setting, int]) -> list[Result]:
    """Return the results of the three channels of a case."""
    setting, seed = job
    case = make_case(setting, seed)
    began = time.perf_counter()
    used: list[str] | None = [] if setting.label.startswith(HIDDEN) else None
    diagnosis = diagnose(case.runs[:2], case.runs[2:], sensors=("gyro",), drivers=used)
    seconds, found = time.perf_counter() - began, list[Result]()
    for channel, verdict in enumerate(diagnosis.verdicts):
        findings = [claim.finding for claim in verdict.claims]
        names = tuple(sorted(case.truth[channel])), tuple(one.name for one in findings)
        sets = tuple(tuple(one.names) for one in findings if one.alternatives)
        before, after, estimated = verdict.test_before, verdict.prediction, verdict.test_after
        errors = before.rms / case.floor, after.rms / case.floor, estimated.estimated_rms / case.floor
        of_case = setting.label, setting.size, seed, channel
        found.append(Result(*of_case, *names, sets, verdict.unexplained, *errors, seconds))
    return found


def is_outside(label: str) -> bool:
    """Return whether no effect of the library is right."""
    return label in OUTSIDE or label.startswith(HIDDEN)


def stray(result: Result) -> list[str]:
    """Return the names that are not true, and in no set with one that is."""
    truth = set(result.truth)
    together = {name for group in result.sets if truth & {*group} for name in group}
    return [name for name in result.named if name not in truth | together]


def right(result: Result) -> bool:
    """Return whether every effect of a channel is named, or is in a set of at most three, and no other is.

    Of an effect outside the library, or of what is not recorded: whether it is called unexplained and nothing
    is named.
    """
    if is_outside(result.label):
        return result.unexplained and not result.named
    named = {*result.named, *(name for group in result.sets for name in group)}
    return set(result.truth) <= named and not stray(result)


def false_drivers(result: Result) -> list[str]:
    """Return the drivers that are named beyond what is true and what fits as well."""
    return [name for name in stray(result) if "(" in name]


def interval(hits: int, count: int) -> tuple[float, float]:
    """Return the 95 % interval of Wilson for a share."""
    if not count:
        return 0.0, 1.0
    share, z = hits / count, 1.96
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count)) / (1 + z * z / count)
    return max(0.0, middle - half), min(1.0, middle + half)


def share(hits: int, count: int) -> str:
    """Return a share with its interval, as text."""
    low, high = interval(hits, count)
    return f"{hits}/{count} ({low:.0%}-{high:.0%})"


def jobs(repeat: int, only: str, first: int) -> Iterable[tuple[Setting, int]]:
    """Yield settings with their seeds; more of those with nothing missing."""
    for at, setting in enumerate(settings()):
        if only not in setting.label:
            continue
        count = repeat * (5 if setting.label.startswith("nothing") else 1)
        for number in range(count):
            yield replace(setting), 1000 * at + first + number


def verdict(result: Result) -> str:
    """Return what is named in a channel, sets in braces."""
    groups = {group[0]: "{" + ",".join(group) + "}" for group in result.sets}
    names = "+".join(sorted({groups.get(name, name) for name in result.named}))
    if result.unexplained:
        names = f"{names}+unexplained" if names else "unexplained"
    return names or "nothing"


def limit(result: Result) -> float:
    """Return what the error of a prediction may be, in floors."""
    return LOOP_LIMIT if "hysteresis" in result.truth or "loop" in result.label else LIMIT


def case_row(found: Sequence[Result]) -> Cells:
    """Return the row of one kind of cases and one size; errors in the test are in floors."""
    first, after = found[0], np.array([one.after for one in found])
    names = ", ".join(f"{name} {count}" for name, count in Counter(map(verdict, found)).most_common(4))
    before = float(np.nanmedian([one.before for one in found]))
    cells: list[Cell] = [first.label, first.size, share(sum(map(right, found)), len(found)), names, before]
    within = f"{sum(one.after <= limit(one) for one in found)}/{len(found)}"
    return [*cells, float(np.nanmedian(after)), float(np.nanmax(after)), within, sum(map(is_worse, found))]


def is_worse(result: Result) -> bool:
    """Return whether the prediction is worse than that of the curve alone."""
    return result.after > result.before * (1 + 1e-9)


def is_large(result: Result) -> bool:
    """Return whether an effect is of 3 floors and more."""
    return bool(result.truth) and result.size >= 3


def carries_over(result: Result) -> bool:
    """Return whether all effects of a channel can be predicted from other runs."""
    known = set(IN_LIBRARY) - {"step", "run_offset", "hysteresis"}
    carried = is_large(result) and set(result.truth) <= known
    return carried and not result.label.startswith(("unequal", DRIVEN, COLUMNS))


Test = Callable[[Result], bool]
SUMMARY: tuple[tuple[str, Test, Test], ...] = (
    ("effects of the library, 3 floors and more: named right",
     lambda r: r.label in IN_LIBRARY and is_large(r) and r.label != "hysteresis", right),
    ("hysteresis, 3 floors and more: named right",
     lambda r: r.label == "hysteresis" and is_large(r), right),
    ("outside the library: unexplained", lambda r: is_outside(r.label), lambda r: r.unexplained),
    ("outside the library: unexplained and nothing named", lambda r: is_outside(r.label), right),
    ("nothing missing: nothing named", lambda r: r.label.startswith("nothing"), lambda r: not r.named),
    ("ten further columns: no false driver",
     lambda r: r.label.startswith(COLUMNS), lambda r: not false_drivers(r)),
    ("driven, 3 floors and more: named right",
     lambda r: r.label.startswith(DRIVEN) and is_large(r), right),
    ("driven: no other driver", lambda r: r.label.startswith(DRIVEN), lambda r: not false_drivers(r)),
    ("effects that carry over: within 1.3 floors", carries_over, lambda r: r.after <= LIMIT),
    ("hysteresis, alone or with another: within 1.6 floors",
     lambda r: "hysteresis" in r.truth and "run_offset" not in r.truth and is_large(r),
     lambda r: r.after <= LOOP_LIMIT),
    ("step, tracked: within 1.3 floors",
     lambda r: r.truth == ("step",) and is_large(r), lambda r: r.tracked <= LIMIT),
    ("any: predicted no worse than before", lambda _: True, lambda r: not is_worse(r)),
)  # fmt: skip
"""What is claimed, of which channels, and the test of it."""
HEADS = (
    "case", "floors", "right", "verdicts", "before, median", "after, median", "largest", "within limit",
    "worse",
)  # fmt: skip


FORMATS = ("", "g", "", "", ".2f", ".2f", ".2f")


def tables(given: Options) -> Iterator[Table]:
    """Yield the claims, and each kind of cases."""
    work = list(jobs(len(given.seeds), QUICK if given.quick else given.only, given.seeds[0]))
    results = [one for found in spread(run_case, work, given.jobs) for one in found]
    rows = []
    for text, concerns, holds in SUMMARY:
        concerned = [one for one in results if concerns(one)]
        if concerned:
            rows.append([text, share(sum(map(holds, concerned)), len(concerned))])
    seconds = sorted({(one.label, one.size, one.seed): one.seconds for one in results}.values())
    note = (
        f"{len(seconds)} of its {len(work)} cases, {len(results)} channels, first seed {given.seeds[0]}; a"
        f" diagnosis takes {np.median(seconds):.1f} s (median; the longest {seconds[-1]:.1f} s) on one core."
    )
    yield Table("", ["claim", "channels"], rows, note)
    groups = groupby(results, key=lambda one: (one.label, one.size))
    yield Table("", HEADS, [case_row(list(found)) for _, found in groups], formats=FORMATS)


STUDY = Study(tables, seeds=4, page="appendix/closing-the-loop-results.md")
