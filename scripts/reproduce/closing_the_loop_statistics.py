"""Statistics of `imumon diagnose` on simulated cases: who is named, how often, how large, and what it costs.

Usage: closing_the_loop --part simulated [--repeat N] [--first SEED] [--minutes N] [--jobs N]
"""

from __future__ import annotations

import argparse
import math
import os
import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import closing_the_loop_drivers as drivers  # noqa: E402
import numpy as np  # noqa: E402 - the number of threads is read when it is imported
from closing_the_loop_cases import OUTSIDE, Setting, make_case  # noqa: E402

from imumon.lab.diagnosis.diagnose import diagnose  # noqa: E402

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
    left_out: tuple[str, ...] = ()
    remark: str = ""


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
    found += [
        Setting((), size, driver=name, label=f"{DRIVEN}{name}") for name in drivers.DRIVING for size in SIZES
    ]
    found += [Setting(("thermal_lag", "hysteresis"), 5.0, label="lag and loop")]
    # What goes with the temperature is rightly named as an effect of it.
    unseen = [name for name in drivers.DRIVING if name != "gradient"]
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
    case = drivers.make(setting, seed) if setting.driver else make_case(setting, seed)
    began = time.perf_counter()
    used: list[str] | None = [] if setting.label.startswith(HIDDEN) else None
    diagnosis = diagnose(case.runs[:2], case.runs[2:], sensors=("gyro",), drivers=used)
    seconds = time.perf_counter() - began
    found = []
    for channel, verdict in enumerate(diagnosis.verdicts):
        before, after = verdict.test_before, verdict.test_after
        assert before is not None
        assert after is not None
        found.append(
            Result(
                setting.label,
                setting.size,
                seed,
                channel,
                tuple(sorted(case.truth[channel])),
                tuple(claim.finding.name for claim in verdict.claims),
                tuple(tuple(claim.finding.alike) for claim in verdict.claims if claim.finding.alike),
                verdict.unexplained,
                before.rms / case.floor,
                after.rms / case.floor,
                after.estimated_rms / case.floor,
                seconds,
                tuple(item["name"] for item in verdict.left_out),
                verdict.remark,
            )
        )
    return found


def is_outside(label: str) -> bool:
    """Tell whether no effect of the library is right."""
    return label in OUTSIDE or label.startswith(HIDDEN)


def right(result: Result) -> bool:
    """Tell whether every effect of a channel is named, or is in a set of at most three, and no other is.

    Of an effect outside the library, or of what is not recorded: whether it is called unexplained and nothing
    is named.
    """
    if is_outside(result.label):
        return result.unexplained and not result.named
    allowed = [set(group) for group in result.sets]
    names = set(result.named)
    hit = all(name in names or any(name in group for group in allowed) for name in result.truth)
    stray = [
        name
        for name in names
        if name not in result.truth
        and not any(name in group and group & set(result.truth) for group in allowed)
    ]
    return hit and not stray


def false_drivers(result: Result) -> list[str]:
    """Return the drivers that are named beyond what is true and what is said not to be told apart from it."""
    sets = [set(group) for group in result.sets]
    return [
        name
        for name in result.named
        if "(" in name
        and name not in result.truth
        and not any(name in group and group & set(result.truth) for group in sets)
    ]


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


def jobs(repeat: int, only: str | None, first: int) -> Iterable[tuple[Setting, int]]:
    """Yield settings with their seeds; more of those with nothing missing."""
    for at, setting in enumerate(settings()):
        if only is not None and only not in setting.label:
            continue
        count = repeat * (5 if setting.label.startswith("nothing") else 1)
        for number in range(count):
            yield replace(setting), 1000 * at + first + number


def tables(results: Sequence[Result]) -> str:
    """Return the tables as Markdown."""
    with_columns = (COLUMNS, DRIVEN)
    plain = [r for r in results if not r.label.startswith(with_columns)]
    parts = [make(plain) for make in (_detection, _kinds, _nothing, _confusion, _errors) if plain]
    further = [r for r in results if r.label.startswith(with_columns)]
    parts += [_columns(further)] if further else []
    return "\n\n".join(parts) + "\n"


def _columns(results: Sequence[Result]) -> str:
    lines = [
        "### Ten further recorded columns",
        "",
        "Three random walks, a ramp, two swings, noise, a switched supply, and two that go with temperature."
        " In the lower table one of them, or another beside them, drives the bias.",
        "",
        "| case | channels | false drivers | names |",
        "|---|---|---|---|",
    ]
    beside = [r for r in results if r.label.startswith(COLUMNS)]
    for label in dict.fromkeys(r.label for r in beside):
        found = [r for r in beside if r.label == label]
        names = ", ".join(f"{name} {count}" for name, count in Counter(_verdict(r) for r in found).items())
        wrong = share(sum(bool(false_drivers(r)) for r in found), len(found))
        lines.append(f"| {label.removeprefix(COLUMNS + ', ')} | {len(found)} | {wrong} | {names} |")
    total = share(sum(bool(false_drivers(r)) for r in beside), len(beside))
    lines += [f"| all | {len(beside)} | {total} | |", ""]
    driven = [r for r in results if r.label.startswith(DRIVEN)]
    heads = " | ".join(f"right at {size:g}" for size in SIZES)
    lines += [f"| driven by | {heads} | within 1.3 in the test | worse |", "|---" * (len(SIZES) + 3) + "|"]
    for label in dict.fromkeys(r.label for r in driven):
        found = [r for r in driven if r.label == label]
        cells = [
            share(sum(map(right, sized)), len(sized))
            for size in SIZES
            for sized in [[r for r in found if r.size == size]]
        ]
        large = [r for r in found if r.size >= 3]
        within = share(sum(r.after <= 1.3 for r in large), len(large))
        worse = sum(r.after > r.before * (1 + 1e-9) for r in found)
        lines.append(f"| {label.removeprefix(DRIVEN)} | {' | '.join(cells)} | {within} | {worse} |")
    large = [r for r in driven if r.size >= 3]
    named = [name for r in driven for name in false_drivers(r)]
    lines += [
        "",
        f"Driven, at 3 floors and more: named right {share(sum(map(right, large)), len(large))};"
        f" another driver named in {sum(bool(false_drivers(r)) for r in driven)} of {len(driven)} channels"
        f"{' (' + ', '.join(sorted(set(named))) + ')' if named else ''}.",
    ]
    return "\n".join(lines)


def _detection(results: Sequence[Result]) -> str:
    lines = [
        "### Named right, by size in floors",
        "",
        "| effect | " + " | ".join(f"{s:g}" for s in SIZES) + " |",
    ]
    lines.append("|---" * (len(SIZES) + 1) + "|")
    for name in IN_LIBRARY:
        cells = []
        for size in SIZES:
            found = [r for r in results if r.label == name and r.size == size]
            cells.append(share(sum(map(right, found)), len(found)) if found else "")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    large = [r for r in results if r.label in IN_LIBRARY and r.size >= 3 and r.label != "hysteresis"]
    loops = [r for r in results if r.label == "hysteresis" and r.size >= 3]
    lines += [
        "",
        f"At 3 floors and more: {share(sum(map(right, large)), len(large))};"
        f" hysteresis {share(sum(map(right, loops)), len(loops))}.",
    ]
    return "\n".join(lines)


def _kinds(results: Sequence[Result]) -> str:
    lines = [
        "### Special cases and effects outside the library",
        "",
        "| case | floors | right | verdicts |",
        "|---|---|---|---|",
    ]
    groups: dict[tuple[str, float], list[Result]] = defaultdict(list)
    for result in results:
        if result.label not in IN_LIBRARY and not result.label.startswith("nothing"):
            groups[result.label, result.size].append(result)
    for (label, size), found in groups.items():
        good = sum(map(right, found))
        verdicts = Counter(_verdict(r) for r in found).most_common(4)
        text = ", ".join(f"{name} {count}" for name, count in verdicts)
        lines.append(f"| {label} | {size:g} | {share(good, len(found))} | {text} |")
    outside = [r for r in results if is_outside(r.label)]
    good = sum(r.unexplained for r in outside)
    bare = sum(r.unexplained and not r.named for r in outside)
    lines += [
        "",
        f"Outside the library: unexplained {share(good, len(outside))},"
        f" and nothing named {share(bare, len(outside))}.",
    ]
    return "\n".join(lines)


def _verdict(result: Result) -> str:
    names = "+".join(sorted({_named(result, name) for name in result.named}))
    if result.unexplained:
        names = f"{names}+unexplained" if names else "unexplained"
    return names or "nothing"


def _named(result: Result, name: str) -> str:
    group = next((group for group in result.sets if group[0] == name), ())
    return "{" + ",".join(group) + "}" if group else name


def _nothing(results: Sequence[Result]) -> str:
    lines = [
        "### Nothing missing",
        "",
        "| noise | false alarm per case | per channel | unexplained | names |",
        "|---|---|---|---|---|",
    ]
    labels = dict.fromkeys(r.label for r in results if r.label.startswith("nothing"))
    for label in labels:
        found = [r for r in results if r.label == label]
        cases: dict[int, bool] = defaultdict(bool)
        for result in found:
            cases[result.seed] |= bool(result.named)
        named = Counter(name for r in found for name in r.named)
        lines.append(
            f"| {label.removeprefix('nothing, ')} | {share(sum(cases.values()), len(cases))} |"
            f" {share(sum(bool(r.named) for r in found), len(found))} | {sum(r.unexplained for r in found)} |"
            f" {', '.join(f'{k} {v}' for k, v in named.items()) or 'none'} |"
        )
    return "\n".join(lines)


def _confusion(results: Sequence[Result]) -> str:
    rows = [r for r in results if r.label in (*IN_LIBRARY, *OUTSIDE) and r.size >= 3]
    kinds = list(dict.fromkeys(_verdict(r) for r in rows))
    heads = [kind for kind, _ in Counter(_verdict(r) for r in rows).most_common(16)]
    lines = [
        "### Confusion at 3 floors and more (channels)",
        "",
        "| truth | " + " | ".join(heads) + " | other |",
    ]
    lines.append("|---" * (len(heads) + 2) + "|")
    for name in dict.fromkeys(r.label for r in rows):
        found = Counter(_verdict(r) for r in rows if r.label == name)
        other = sum(found[kind] for kind in kinds if kind not in heads)
        lines.append(f"| {name} | " + " | ".join(str(found[k] or "") for k in heads) + f" | {other or ''} |")
    return "\n".join(lines)


def _errors(results: Sequence[Result]) -> str:
    lines = [
        "### Error in the test, in floors (all noise), at 3 floors and more",
        "",
        "The limit is 1.3 floors; 1.6 with a loop. Tracked: without 2 min after a jump or a turn-on offset.",
        "",
        "| effect | before, median | after, median | after, 90 % | within limit | tracked, 90 % "
        "| tracked within limit | worse than before |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(r.label for r in results):
        found = [r for r in results if r.label == name and (r.size >= 3 or r.size == 0)]
        after = np.array([r.after for r in found])
        tracked = np.array([r.tracked for r in found])
        if not len(found):
            continue
        limit = 1.6 if "hysteresis" in name else 1.3
        worse = sum(r.after > r.before * (1 + 1e-9) for r in found)
        within = [share(int(np.sum(values <= limit)), len(found)) for values in (after, tracked)]
        lines.append(
            f"| {name} | {np.nanmedian([r.before for r in found]):.2f} | {np.nanmedian(after):.2f} |"
            f" {np.nanquantile(after, 0.9):.2f} | {within[0]} |"
            f" {np.nanquantile(tracked, 0.9):.2f} | {within[1]} | {worse} |"
        )
    lines += ["", *_all_errors(results)]
    return "\n".join(lines)


def _all_errors(results: Sequence[Result]) -> list[str]:
    """Return lines on all channels with an effect that a prediction can carry over."""
    known = set(IN_LIBRARY) - {"step", "run_offset", "hysteresis"}
    carried = [r for r in results if r.truth and set(r.truth) <= known and r.size >= 3]
    carried = [r for r in carried if not r.label.startswith("unequal")]
    loops = [r for r in results if "hysteresis" in r.truth and "run_offset" not in r.truth and r.size >= 3]
    jumps = [r for r in results if r.truth == ("step",) and r.size >= 3]
    rows = (
        ("effects that carry over, predicted, within 1.3", carried, lambda r: r.after <= 1.3),
        ("hysteresis, alone or with another, predicted, within 1.6", loops, lambda r: r.after <= 1.6),
        ("step, tracked, within 1.3", jumps, lambda r: r.tracked <= 1.3),
        ("any, predicted no worse than before", results, lambda r: r.after <= r.before * (1 + 1e-9)),
    )
    return [f"- {text}: {share(sum(map(test, found)), len(found))}" for text, found, test in rows]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and write the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=4)
    parser.add_argument("--only")
    parser.add_argument(
        "--first", type=int, default=0, help="first seed of each kind: others are fresh cases"
    )
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--minutes", type=float, default=np.inf, help="begin no case after so long")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--list", action="store_true")
    given = parser.parse_args(arguments)
    work = list(jobs(given.repeat, given.only, given.first))
    began = time.perf_counter()
    results: list[Result] = []
    with ProcessPoolExecutor(given.jobs) as pool:
        for done, found in enumerate(pool.map(run_case, work), 1):
            results += found
            if given.list:
                for r in found:
                    mark = "ok " if right(r) else "BAD"
                    print(
                        f"{mark} {r.label} {r.size:g} #{r.seed}.{r.channel} truth={'+'.join(r.truth)}"
                        f" -> {_verdict(r)} test {r.before:.2f}->{r.after:.2f} tracked {r.tracked:.2f}"
                        f" {r.left_out} {r.remark}",
                        flush=True,
                    )
            elif sys.stderr.isatty() or done % 20 == 0:
                print(f"{done}/{len(work)} cases, {time.perf_counter() - began:.0f} s", file=sys.stderr)
            if time.perf_counter() - began > 60.0 * given.minutes:
                pool.shutdown(wait=False, cancel_futures=True)
                break
    cases = len({(r.label, r.seed) for r in results})
    seconds = sorted({(r.label, r.seed): r.seconds for r in results}.values())
    text = (
        "# Closing the loop: simulated cases\n\nMade by `scripts/reproduce/closing_the_loop --part simulated"
        f" --repeat {given.repeat} --first {given.first}`. Shares are of channels unless said, with Wilson's"
        f" 95 % interval.\n\n{cases} of its {len(work)} cases, {len(results)} channels; a diagnosis takes"
        f" {seconds[len(seconds) // 2]:.1f} s (median; the longest {seconds[-1]:.1f} s) on one core."
        f"\n\n{tables(results)}"
    )
    if given.out is not None:
        given.out.write_text(text, encoding="utf-8")
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
