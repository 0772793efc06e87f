"""Parameters of the test of the bias filter, in a module of their own that loads quickly."""

from __future__ import annotations

from pydantic import Field

from imumon.config import StrictModel


class WatchParameters(StrictModel):
    """How rare false alarms are.

    Parameters
    ----------
    false_alarm_hours : float
        Least mean time at rest, h, until a false alarm, while the filter is right.
    learn : bool
        Whether a better model, where one is found, runs beside the present one, and replaces it once its
        predictions are better.
    """

    false_alarm_hours: float = Field(default=24.0, ge=0.1, le=1e5)
    learn: bool = False
