"""What a session has learned: a better model, kept beside it, with the session as evidence."""

from __future__ import annotations

import shlex
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from imumon.models.model import TrainedOn
from imumon.pipeline import Pipeline
from imumon.recordings.folder import Session, fingerprint
from imumon.version import __version__

LEARNED_NAME = "learned-model.yaml"


@runtime_checkable
class Learning(Protocol):
    """A stage that looks for a better model than the present one."""

    offered: Any
    """What has the better `model`, once it has won; else None."""

    def evidence(self, session: str, sha256: str) -> TrainedOn:
        """Return what the model was learned from, a session of this name and fingerprint."""


def keep_learned(pipeline: Pipeline, session: Session) -> Path | None:
    """Write the better model that has won in a session into its folder; return its path, or None.

    The model that the session ran with stays where it is: who wants the new one names it.
    """
    stage = next((one for one in pipeline.estimators if isinstance(one, Learning)), None)
    if stage is None or stage.offered is None:
        return None
    path, model = session.path / LEARNED_NAME, stage.offered.model
    evidence = stage.evidence(session.path.name, fingerprint(session.truth_path))
    changes = {
        "made_by": f"imumon {__version__}",
        "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "trained_on": [*model.trained_on, evidence],
    }
    model.model_copy(update=changes).write(path)
    return path


def compared(session: Session, learned: Path) -> str:
    """Return the command that shows a session with the model that it ran with and with the learned one."""
    both = f"{shlex.quote(str(session.path))} {shlex.quote(str(learned))}"
    page = shlex.quote(str(session.path / "compared.html"))
    return f"imumon replay {shlex.quote(str(session.path))} --compare-models {both} --out {page}"
