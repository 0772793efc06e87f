"""Measured recordings: train on the first part in time, test on the rest; per axis, before and after."""

from __future__ import annotations

import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from thermal_calibration_data import TWO_LEVELS_MAP

from imumon.blocks import FloatArray
from imumon.errors import ImumonError
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.lab.diagnosis.blocks import BLOCK_S
from imumon.lab.diagnosis.candidates import candidates
from imumon.lab.diagnosis.diagnose import Diagnosis, diagnose
from imumon.lab.diagnosis.fit import Fit, FittedPart, TestScore, fit, score
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.runs import SECOND_NS, Run, read_runs
from imumon.lab.diagnosis.verdict import ChannelVerdict
from imumon.recordings.reduced import AXES

SHARES = (0.5, 0.6, 0.65, 0.7)
DRAWN = 0.65
LEFT_OUT = (0.65, 0.7)
SHIFTS_S = range(3, 31, 3)
WALK_S = (8, 15, 30, 60, 120, 240, 480)
INSISTED = ("thermal_lag", "hysteresis", "warm_up", "drift", "periodic", "temperature_rate")


def measured(data: Path, figures: Path) -> int:
    """Print the tables, draw the figures."""
    run = chamber_run(data / "chamber-cycle")
    print("## chamber-cycle, rms in deg/s, cubic in temperature as declared\n")
    print("| train on | axis | floor | train before | after | test before | after | covered | verdict |")
    print("|---|---|---|---|---|---|---|---|---|")
    for share in SHARES:
        diagnosis = diagnose(*split(run, share), sensors=("gyro",))
        content = report(diagnosis)["channels"]
        for verdict in diagnosis.verdicts:
            _row(share, verdict, content[verdict.name])
        if share == DRAWN:
            drawn = diagnosis
    _trained_whole(run)
    print(f"\n## Had one insisted on one effect, fitted to the first {DRAWN:.0%}: rms in the test, deg/s\n")
    print("| axis | cubic | " + " | ".join(INSISTED) + " |")
    print("|---" * (len(INSISTED) + 2) + "|")
    for verdict in drawn.verdicts:
        cells = [_insisted(drawn, verdict, name) for name in INSISTED]
        assert verdict.test_before is not None
        print(f"| {verdict.name} | {_deg(verdict.test_before.rms)} | " + " | ".join(cells) + " |")
    _draw(drawn, figures)
    print(
        "\n## Random walk of what the cubic leaves, by the length of means, 1e-3 deg/s per root of a second\n"
    )
    print("| axis | " + " | ".join(f"{length} s" for length in WALK_S) + " |")
    print("|---" * (len(WALK_S) + 1) + "|")
    for axis in AXES:
        print(f"| {axis} | " + " | ".join(f"{1e3 * value:.1f}" for value in _walks(run, axis)) + " |")
    print("\n## The same with one block left out, or with blocks that begin later\n")
    for share in LEFT_OUT:
        _one_block_less(run, share)
    print("\n## two-levels\n")
    _two_levels(data / "two-levels")
    return 0


def _trained_whole(run: Run) -> None:
    """Print what the whole record proves; as its test it is taken once more, which proves nothing."""
    print("\n## Trained on the whole record, rms in training, deg/s\n")
    again = replace(run, name="the same course once more", start_ns=10**13)
    for verdict in diagnose([run], [again], sensors=("gyro",)).verdicts:
        claims = [] if verdict.by_test else verdict.claims
        names = " and ".join(_with_parameters(claim.parts) for claim in claims) or "nothing proven"
        before, after = verdict.before.train_rms, (verdict.after if claims else verdict.before).train_rms
        print(f"- {verdict.name[-1]}: {names}; {_deg(before)} -> {_deg(after)}")


def _with_parameters(parts: Sequence[FittedPart]) -> str:
    """Return the label of an effect with what is searched of it."""
    effect = parts[0].effect
    which = ", ".join(f"{getattr(effect, key):.3g}" for key in effect.nonlinear)
    start = " with a free start" if len(parts[0].start) else ""
    return f"{effect.label} ({which}){start}" if which else effect.label


def chamber_run(folder: Path) -> Run:
    """Return the record of the chamber."""
    return read_runs(folder / "cooling-heating.csv", folder / "map.yaml", lambda _: [RestDetector()])[0]


def split(run: Run, share: float) -> tuple[list[Run], list[Run]]:
    """Return a run's beginning, so much of it, as training, and the rest as its test."""
    at = int(share * len(run.time_s))
    return [_part(run, 0, at)], [_part(run, at, len(run.time_s))]


def _part(run: Run, start: int, stop: int) -> Run:
    def cut(parts: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: values[start:stop] for name, values in parts.items()}

    assert run.start_ns is not None
    return replace(
        run,
        name=f"{run.name}, {start / 60:.0f} to {stop / 60:.0f} min",
        time_s=run.time_s[: stop - start],
        count=cut(run.count),
        mean=cut(run.mean),
        variance=cut(run.variance),
        rest=run.rest[start:stop],
        start_ns=run.start_ns + start * SECOND_NS,
    )


def _one_block_less(run: Run, share: float) -> None:
    """Print how often which effects are named, and the range of the errors in the test, deg/s."""
    (train,), test = split(run, share)
    without, later = [], []
    for at in range(0, len(train.time_s), round(BLOCK_S)):
        rest = train.rest.copy()
        rest[at : at + round(BLOCK_S)] = 0.0
        without.append(diagnose([replace(train, rest=rest)], test, sensors=("gyro",)).verdicts)
    for shift in SHIFTS_S:
        first = _part(run, shift, len(train.time_s))
        later.append(diagnose([first], test, sensors=("gyro",)).verdicts)
    for what, found in (("a block left out", without), ("blocks begin later", later)):
        for axis, verdicts in zip(AXES, zip(*found, strict=True), strict=True):
            said = Counter(", ".join(claim.finding.name for claim in v.claims) or "nothing" for v in verdicts)
            after = [v.test_after.rms for v in verdicts if v.test_after is not None]
            names = "; ".join(f"{name} {count}" for name, count in said.most_common())
            print(f"{share:.0%}, {what}, {axis}: {names}; {_deg(min(after))} to {_deg(max(after))}")


def _row(share: float, verdict: ChannelVerdict, found: dict[str, dict[str, float]]) -> None:
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    names = [" or ".join(claim.finding.alike) or claim.finding.name for claim in verdict.claims]
    said = "; ".join(names) or "nothing named"
    said += ", proven by the test" if verdict.by_test else ""
    if verdict.unexplained:
        said += ", remainder unexplained" if names else ", unexplained"
    said += "".join(f"; {item['name']} left out" for item in verdict.left_out)
    values = [
        found["noise_floor_rms"],
        found["before"]["train_rms"],
        found["after"]["train_rms"],
        verdict.test_before.rms,
        verdict.test_after.rms,
    ]
    numbers = " | ".join(_deg(float(value)) for value in values)  # type: ignore[arg-type]  # a number of the report
    print(f"| {share:.0%} | {verdict.name[-1]} | {numbers} | {verdict.test_after.coverage:.0%} | {said} |")


def _deg(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{np.degrees(value):.4f}"


def _walks(run: Run, axis: str) -> list[float]:
    """Return K, deg/s per root of a second, from the Hadamard variance of the residual, K² tau / 6 of a walk
    (its white noise, from differences of seconds, taken off)."""
    known = np.isfinite(run.mean["temperature"]) & np.isfinite(run.mean[f"gyro_{axis}"])
    u = np.interp(run.time_s, run.time_s[known], run.mean["temperature"][known]) / 50.0
    rate = np.degrees(np.interp(run.time_s, run.time_s[known], run.mean[f"gyro_{axis}"][known]))
    left = rate - np.polyval(np.polyfit(u, rate, 3), u)
    white = float(np.median(np.diff(left, 2) ** 2)) / 0.4549 / 6.0
    found = []
    for length in WALK_S:
        starts = range(0, length, max(1, length // 4))
        parts = [left[at : at + (len(left) - at) // length * length].reshape(-1, length) for at in starts]
        hadamard = np.mean([np.mean(np.diff(part.mean(axis=1), 2) ** 2) for part in parts]) / 6.0
        found.append(float(np.sqrt(max(hadamard - white / length, 0.0) * 6.0 / length)))
    return found


def _insisted(diagnosis: Diagnosis, verdict: ChannelVerdict, family: str) -> str:
    """Return the rms in the test of the effect of a family that leaves least of the training, and which."""
    best: tuple[Fit, TestScore] | None = None
    for candidate in candidates(diagnosis.survey, [family]):
        if candidate.free_start or len(candidate.parts) > 1:
            continue
        found = fit(verdict.channel, [candidate])
        if best is None or found.train_rms < best[0].train_rms:
            best = found, score(verdict.channel, found)
    if best is None:
        return "-"
    effect = best[0].parts[0].effect
    which = [f"{getattr(effect, key):.3g}" for key in effect.nonlinear]
    return _deg(best[1].rms) + (f" ({', '.join(which)})" if which else "")


def _draw(diagnosis: Diagnosis, folder: Path) -> None:
    """Draw what is left before and after, in time and against temperature, per axis."""
    figure = Figure(figsize=(9, 7.5), layout="constrained")
    panes = figure.subplots(3, 2)
    for (left, right), verdict in zip(panes, diagnosis.verdicts, strict=True):
        for what, model, scored, color in (
            ("before", verdict.before, verdict.test_before, "tab:gray"),
            ("after", verdict.after, verdict.test_after, "tab:red"),
        ):
            assert scored is not None
            minutes, residual, temperature, where = _whole(diagnosis, verdict, model, scored)
            left.plot(minutes, residual, ".", ms=3, color=color, label=what)
            right.plot(temperature[~where], residual[~where], ".", ms=3, color=color)
            right.plot(temperature[where], residual[where], "x", ms=3, color=color)
        left.axvline(diagnosis.train[0].duration_s / 60, color="black", lw=0.8)
        left.set_ylabel(f"{verdict.name}, deg/s")
    panes[0][0].legend(fontsize=8)
    panes[0][0].set_title("left over; the test is right of the line", fontsize=9)
    panes[0][1].set_title("the same against temperature; crosses: test", fontsize=9)
    panes[-1][0].set_xlabel("min")
    panes[-1][1].set_xlabel("degC")
    folder.mkdir(parents=True, exist_ok=True)
    figure.savefig(folder / "chamber-cycle.png", dpi=70)


def _whole(
    diagnosis: Diagnosis, verdict: ChannelVerdict, model: Fit, scored: TestScore
) -> tuple[FloatArray, FloatArray, FloatArray, np.ndarray[tuple[int], np.dtype[np.bool_]]]:
    runs = [*diagnosis.train, *diagnosis.test]
    minutes = np.concatenate([run.time_s for run in runs]) / 60
    temperature = np.concatenate([run.temperature[verdict.channel.temperature] for run in runs])
    test = [np.where(use, left, np.nan) for left, use in zip(scored.residual, scored.counted, strict=True)]
    residual = np.degrees(np.concatenate([model.train, *test]))
    return minutes, residual, temperature, np.arange(len(minutes)) >= len(model.train)


def _two_levels(folder: Path) -> None:
    with tempfile.TemporaryDirectory() as name:
        table_map = Path(name) / "map.yaml"
        table_map.write_text(TWO_LEVELS_MAP, encoding="utf-8")
        runs = []
        for level in ("cold", "hot"):
            try:
                runs += read_runs(folder / f"{level}.csv", table_map, lambda _: [RestDetector()])
            except ImumonError as error:
                print(f"{level}: refused: {error.seen}; {error.hint}")
        print("\n".join(f"{run.name}: {run.duration_s / 60:.1f} min" for run in runs))
        _try([part for run in runs for part in split(run, 0.6)[0]], [split(run, 0.6)[1][0] for run in runs])


def _try(train: Sequence[Run], test: Sequence[Run]) -> None:
    try:
        diagnosis = diagnose(train, test, sensors=("gyro",))
    except ImumonError as error:
        print(f"refused: {error.seen}; {error.hint}")
        return
    print("\n".join([*diagnosis.caveats, *(f"{v.name}: {v.summary}" for v in diagnosis.verdicts)]))
