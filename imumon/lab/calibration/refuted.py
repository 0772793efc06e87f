"""Whether a session that was left out refutes the curves, before an autopilot flies with them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from imumon.errors import ImumonError, Reason
from imumon.lab.calibration.calibration import calibrate
from imumon.lab.calibration.cells import channel_of, group, levels
from imumon.lab.calibration.record import Record

LEAST_LEVELS = 4
"""Of fewer means a line with its standard deviation says nothing."""
SURE = 2.0
"""Standard deviations."""
HALF = 0.5
"""Where less of a curve than this is there, no curve errs less than it does."""


def check_last(records: Sequence[Record], latitude_deg: float | None, heading_deg: float | None) -> list[str]:
    """Compare curves made without the last record with that one; return what is to be said.

    Raises BAD_DATA when some curve errs more in it than no curve does.
    """
    if len(records) < 2:
        return []
    try:
        found = followed(records, latitude_deg, heading_deg)
    except ImumonError as error:
        return [f"that the model holds in another session is not shown: without the last one, {error.seen}"]
    wrong = {name: (share, sd) for name, (share, sd) in found.items() if share + SURE * sd < HALF}
    if wrong:
        shares = ", ".join(f"{name} {share:.2f} ± {sd:.2f}" for name, (share, sd) in wrong.items())
        raise ImumonError(
            Reason.BAD_DATA,
            f"the last session refutes curves made of the others: of these it has {shares}; below {HALF:g} no"
            " curve errs less",
            "let imumon diagnose say what is missing, and leave out what was recorded otherwise",
        )
    return []


def followed(
    records: Sequence[Record], latitude_deg: float | None, heading_deg: float | None
) -> dict[str, tuple[float, float]]:
    """Return how much of the curves made without the last record that one has, by the means of its levels.

    By channel the share, 1 of the whole curve and 0 of nothing, and its standard deviation.  Raises
    ImumonError as `calibrate`, of the records without the last.
    """
    model = calibrate(records[:-1], latitude_deg, heading_deg).model
    last = records[-1:]
    cells = group(last, latitude_deg, heading_deg)
    found = {}
    for name, known in model.channels.items():
        channel = channel_of(last, cells, name, levels(cells))
        if channel is None:
            continue
        points = channel.points()
        low, high = known.temperature_range_degc
        points = points.only((points.temperature >= low) & (points.temperature <= high))
        _, level = np.unique(points.level, return_inverse=True)
        weight = np.bincount(level, points.weight)  # what drifts slowly within a level is not many means
        curve = np.bincount(level, points.weight * known.value(points.temperature)) / weight
        value = np.bincount(level, points.weight * points.value) / weight
        if len(weight) >= LEAST_LEVELS and np.ptp(curve) > 0.0:
            (share, _), covariance = np.polyfit(curve, value, 1, cov=True)
            found[name] = float(share), float(np.sqrt(covariance[0, 0]))
    return found
