"""What else that was recorded drives the bias, beside the curve that a calibration found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.runs import Run, latest
from imumon.lab.diagnosis.verdict import ChannelVerdict
from imumon.models.model import BiasModel

DECLARED = "polynomial 3 + offset"
"""The model says the degree; each run has a turn-on offset, as in the calibration."""


@dataclass(frozen=True, slots=True)
class Driven:
    """A model with the drivers that were found, the verdicts on the channels that have one, and remarks."""

    model: BiasModel
    verdicts: list[ChannelVerdict]
    caveats: list[str]


def with_drivers(
    model: BiasModel,
    recordings: Sequence[Sequence[Run]],
    drivers: Sequence[str] | None,
    tell: Callable[[str], None],
) -> Driven:
    """Return a calibrated model with what is proven of recorded drivers; None: of all that vary.

    The search is that of `diagnose.diagnose`, the latest recording is its test.  A channel in
    which a driver is found gets all that was found in it, for the rest was fitted beside the driver; the
    others stay as they are.

    Raises BAD_DATA when the data is too short for it; BAD_CONFIG for a driver that is not there.
    """
    diagnosis = diagnose(*latest(recordings), DECLARED, tell, model=model, drivers=drivers)
    found = [verdict for verdict in diagnosis.verdicts if verdict.predicts and _has_driver(verdict)]
    extended = extended_model(diagnosis).channels
    channels = {**model.channels, **{verdict.name: extended[verdict.name] for verdict in found}}
    return Driven(model.model_copy(update={"channels": channels}), found, diagnosis.caveats)


def _has_driver(verdict: ChannelVerdict) -> bool:
    return any(claim.finding.candidate.choice > 0.0 for claim in verdict.claims)
