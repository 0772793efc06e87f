"""The panel with the body: a box that turns as the device says."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from imumon.blocks import FloatArray
from imumon.charts import AXIS_COLORS, GREY
from imumon.geodesy import quaternions
from imumon.view.items import ViewSetup
from imumon.view.layout import SCENE
from imumon.view.rows import Rows
from imumon.view.window import Window

STEP_NS = 20_000_000
"""The body is redrawn at the most 50 times a second."""
DEVICE = "/attitude"
"""Entity of the reference frame of the device."""


@dataclass(frozen=True, slots=True)
class Attitude:
    """A panel that turns a solid body by a quaternion w, x, y, z, or by roll, pitch and yaw."""

    key: str
    columns: tuple[str, ...]
    root: str = DEVICE
    """Entity of the reference frame that the body is drawn in."""
    title: str = "Attitude: body in the device's reference frame"
    axes: tuple[str, str, str] = ("X", "Y", "Z")
    """Names of the reference axes."""
    up: float | None = None
    """Which way the third axis points, 1 or -1; None: as the axes of the device do."""
    place: str = SCENE

    def has_values(self, rows: Rows) -> bool:
        """Return whether each column has a value."""
        return bool(np.isfinite(rows.matrix(self.columns)).any(axis=0).all())

    def declare(self, rec: rr.RecordingStream) -> None:
        """Log the housing with its connector and axes, and the reference axes."""
        housing = rr.Boxes3D(
            centers=[[0.0, 0.0, 0.0], [-0.62, 0.0, 0.0], [0.42, 0.0, 0.0]],
            half_sizes=[[0.5, 0.34, 0.13], [0.12, 0.12, 0.07], [0.05, 0.3, 0.135]],
            colors=[[95, 105, 125], [200, 165, 70], [230, 230, 235]],
            fill_mode="solid",
        )
        rec.log(f"{self.drawn}/housing", housing, static=True)
        axes, colors = np.eye(3), [list(color) for color in AXIS_COLORS.values()]
        body_axes = rr.Arrows3D(
            origins=0.1 * axes, vectors=0.95 * axes, colors=colors, labels=["x", "y", "z"], radii=0.022
        )
        rec.log(f"{self.drawn}/axes", body_axes, static=True)
        if self.up is not None:
            rec.log(self.root, rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        labels = list(self.axes)
        reference = rr.Arrows3D(
            vectors=1.5 * axes, colors=[list(GREY)], labels=labels, radii=0.008, show_labels=True
        )
        rec.log(f"{self.root}/reference", reference, static=True)

    def log(self, rec: rr.RecordingStream, rows: Rows) -> None:
        """Turn the body."""
        values = rows.matrix(self.columns)
        keep: Any = np.isfinite(values).all(axis=1) & rows.thinned(STEP_NS)
        if keep.any():
            turned = rr.Transform3D.columns(quaternion=xyzw(values[keep]))
            rec.send_columns(self.drawn, indexes=rows.kept(keep).indexes, columns=turned)

    @property
    def drawn(self) -> str:
        """Entity of the body."""
        return f"{self.root}/body"

    def ends(self, _: Rows) -> None:
        """Return nothing: a body has no axis."""

    def readings(self, _: ViewSetup) -> tuple[()]:
        """Return nothing: angles are in panels of their own."""
        return ()

    def view(self, setup: ViewSetup, _: Window) -> Any:
        """Return the 3-D view, seen from above and ahead whichever way the reference frame has z."""
        up = self.up or (-1.0 if setup.z_down else 1.0)
        return rrb.Spatial3DView(
            origin=self.root,
            name=self.title,
            line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, color=[*GREY, 60]),
            eye_controls=rrb.EyeControls3D(
                position=[1.8, up * 1.7, up * 1.2], look_target=[0, 0, 0.08 * up], eye_up=[0, 0, up]
            ),
        )


def xyzw(values: FloatArray) -> FloatArray:
    """Return quaternions x, y, z, w, (n, 4), from w, x, y, z, or from roll, pitch, yaw in rad."""
    known = values if values.shape[1] == 4 else quaternions(values).T
    return np.ascontiguousarray(known[:, [1, 2, 3, 0]])
