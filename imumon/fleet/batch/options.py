"""What every task of a batch is told."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from imumon.config import StrictModel
from imumon.models.curves.polynomial import CUBIC

Command = Literal["decode", "replay", "calibrate", "allan", "diagnose"]


class BatchOptions(StrictModel):
    """A command and its options, the same for all sessions; kept in the folder of the results.

    Parameters
    ----------
    command : str
        One of `Command`.
    tables : bool
        Whether decode and replay write the samples of every session as well.
    pipeline_yaml : str or None
        For replay, instead of what a session was recorded with.
    latitude_deg, heading_deg : float or None
        For calibrate: with which the earth rate is removed.
    declared : str
        For diagnose: the bias model that is assumed.
    """

    format: Literal["imumon-batch/1"] = "imumon-batch/1"
    command: Command
    tables: bool = False
    pipeline_yaml: str | None = None
    latitude_deg: float | None = Field(default=None, ge=-90, le=90)
    heading_deg: float | None = Field(default=None, ge=-360, le=360)
    declared: str = CUBIC
