"""What the core requires of the lab; the diagnosis, which takes time to load, is loaded when it is needed."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from imumon.pipeline import Estimator
from imumon.run.setup import Setup


def better_model(setup: Setup, _: object, others: Sequence[Estimator]) -> list[Estimator]:
    """Return the stage that looks for a better model than the present one, where there is one.

    `others`: the stages before it.
    """
    if not setup.bias_model:
        return []
    from .diagnosis.live import LiveDiagnosis

    def made() -> set[str]:
        return {column.name for stage in others for column in stage.columns}

    return [LiveDiagnosis(setup.bias_model, setup.watch.learn, made)]


def compare_models(
    session: Path, given: tuple[Path, Path], out: Path
) -> tuple[Mapping[str, Any], Mapping[str, str]]:
    """Write the page of what two models leave of a session; return it as data and as lines for a person."""
    from imumon.models.model import UNITS

    from .diagnosis.page import compare, shown, write_comparison
    from .diagnosis.runs import read_runs
    from .diagnosis_commands import model_of

    first, second = (model_of(path) for path in given)
    compared = compare(read_runs(session), (first, second))
    write_comparison(compared, (str(given[0]), str(given[1])), str(session), out)
    rows = {}
    for one in compared:
        factor, unit = shown(UNITS[one.channel])
        before, after = (factor * rms for rms in one.rms)
        rows[f"{one.run} {one.channel}"] = f"{before:.3g} become {after:.3g} {unit} rms"
    return {"out": out, "rms": {f"{one.run} {one.channel}": one.rms for one in compared}}, rows
