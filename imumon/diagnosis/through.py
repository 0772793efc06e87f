"""Charts of what a model leaves of a session, with the effect that would fit drawn through it."""

from __future__ import annotations

from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.diagnosis.blocks import common_block_s
from imumon.diagnosis.glance import Better, residual
from imumon.diagnosis.known import temperature_of
from imumon.diagnosis.runs import Run
from imumon.geodesy import DEG_PER_H
from imumon.models.model import BiasModel

RESIDUAL = "Residual"
INK = (150, 155, 165)
"""Of the effect: it reads on both themes and is no axis' colour."""


def effect_charts(run: Run, present: BiasModel, better: BiasModel, one: Better) -> list[Chart]:
    """Return what is left of a channel over time and temperature, and what the better model would take.

    Means at rest, °/h, less their mean, which is the turn-on bias.  What is drawn through them is the
    difference of the two models.
    """
    block_s = common_block_s([run])
    left, after = (residual(run, model, [one.channel], block_s=block_s) for model in (present, better))
    values = left.mean[one.channel]
    points, line = ((part - part.mean()) / DEG_PER_H for part in (values, values - after.mean[one.channel]))
    axis = one.channel[-1]
    over = {
        "time": (left.time_s / 60.0, "time since power-on [min]"),
        "temperature": (left.temperature[temperature_of(one.channel, present, [run])], "temperature [°C]"),
    }
    return [
        Chart(
            f"model_lacks_over_{key}",
            RESIDUAL,
            f"Gyro {axis} less the model, means of {block_s:.0f} s, and {one.names[0]} through it",
            Axis(label),
            Axis("[°/h]"),
            (
                Curve(f"left, {axis}", x, points, AXIS_COLORS[axis], points=True, width=4.0),
                Curve(one.names[0], x, line, INK),
            ),
            headline=f"{one.before / DEG_PER_H:.3g} → {one.after / DEG_PER_H:.3g} °/h",
            notes=(f"{' or '.join(one.names)}, gain {one.gain:.0f}",),
        )
        for key, (x, label) in over.items()
    ]
