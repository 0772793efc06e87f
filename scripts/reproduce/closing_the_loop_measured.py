"""The measured chamber cycle: trained on the first part in time, tested on the rest, before and after."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from study import Options, Study, Table

from imumon.blocks import FloatArray
from imumon.effects.vibration import SECOND_NS
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.fit import FittedPart
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.runs import Run, read_runs
from imumon.lab.diagnosis.verdict import ChannelVerdict

SHARES = (0.4, 0.45, 0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.9)
HEADS = (
    "train on", "axis", "floor", "train before", "after", "test before", "after", "covered", "verdict",
)  # fmt: skip


def tables(given: Options) -> Iterator[Table]:
    """Yield the parts trained on, and what the whole record proves, °/s."""
    run = chamber_run(given.data / "chamber-cycle")
    rows = []
    for share in SHARES[: 1 if given.quick else None]:
        diagnosis = diagnose(*split(run, share), sensors=("gyro",))
        content = report(diagnosis)["channels"]
        rows += [_row(share, verdict, content[verdict.name]) for verdict in diagnosis.verdicts]
    yield Table("", HEADS, rows, "" if given.quick else "\n".join(_trained_whole(run)))


def _trained_whole(run: Run) -> Iterator[str]:
    """Yield what the whole record proves; as its test it is taken once more, which proves nothing."""
    again = replace(run, name="the same course once more", start_ns=10**13)
    for verdict in diagnose([run], [again], sensors=("gyro",)).verdicts:
        claims = [] if verdict.by_test else verdict.claims
        names = " and ".join(_with_parameters(claim.parts) for claim in claims) or "nothing proven"
        before, after = verdict.before.train_rms, (verdict.after if claims else verdict.before).train_rms
        yield f"- {verdict.name[-1]}, whole record: {names}; {_deg(before)} -> {_deg(after)}"


def _with_parameters(parts: Sequence[FittedPart]) -> str:
    """Return the label of an effect with what is searched of it."""
    effect = parts[0].effect
    which = ", ".join(f"{getattr(effect, key):.3g}" for key in effect.nonlinear)
    start = " with a free start" if len(parts[0].start) else ""
    return f"{effect.label} ({which}){start}" if which else effect.label


def chamber_run(folder: Path) -> Run:
    """Return the record of the chamber."""
    return read_runs(folder / "cooling-heating.csv", folder / "map.yaml")[0]


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


def _row(share: float, verdict: ChannelVerdict, found: dict[str, Any]) -> list[str]:
    """Return the row of a channel; rms in °/s."""
    names = [" or ".join(claim.finding.names) for claim in verdict.claims]
    text = "; ".join(names) or "nothing named"
    text += ", chosen by the test" if verdict.by_test else ""
    if verdict.unexplained:
        text += ", remainder unexplained" if names else ", unexplained"
    text += "".join(f"; {item['name']} left out" for item in verdict.left_out)
    train = [found[when]["train_rms"] for when in ("before", "after")]
    numbers = [
        _deg(value)
        for value in (found["noise_floor_rms"], *train, verdict.test_before.rms, verdict.prediction.rms)
    ]
    return [f"{share:.0%}", verdict.name[-1], *numbers, f"{verdict.test_after.coverage:.0%}", text]


def _deg(value: float) -> str:
    return "-" if not np.isfinite(value) else f"{np.degrees(value):.4f}"


STUDY = Study(tables)
