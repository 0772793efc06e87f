"""What is wrong with a picture of the view: an empty panel, a cut-off band."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import rerun.blueprint as rrb
from PIL import Image
from rerun.chunk import ChunkStore, RrdReader

from imumon.blocks import FloatArray
from imumon.view.panels import Panel
from imumon.view.window import RECENT_S, entity

LEGEND = 0.86
"""Where the legend of a view begins, as a share of its width."""
CONTRAST, LEAST_INK = 60, 60
"""A pixel so far from the background, or so colourful, is ink; with less of it a panel is empty."""
OUTSIDE = 0.02
"""Share of a band's latest samples that may be cut off: the axis follows once a second."""


def views_of(container: Any) -> Iterator[Any]:
    """Yield the views of a container of a blueprint, to the last."""
    for part in getattr(container, "contents", ()):
        if isinstance(part, rrb.View):
            yield part
        elif not isinstance(part, str):
            yield from views_of(part)


def is_empty(view: Any, picture: Path) -> bool:
    """Test whether the picture of a view shows nothing of its own: series have colours, texts are bright."""
    pixels = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    if isinstance(view, rrb.TimeSeriesView | rrb.StateTimelineView):
        pixels = pixels[:, : int(LEGEND * pixels.shape[1])]
        ink = pixels.max(axis=2) - pixels.min(axis=2) > CONTRAST
    else:
        ink = np.abs(pixels - np.median(pixels, axis=(0, 1))).max(axis=2) > CONTRAST
    return int(ink.sum()) < LEAST_INK


def axis_faults(recording: Path, panels: Iterable[Panel], window_s: float) -> list[str]:
    """Return what is wrong with the vertical axes of a live stream that shows the last `window_s`."""
    logged = stored(recording)
    ends = {panel: scalars(logged, entity(panel.drawn)) for panel in panels}
    shown = [panel for panel, found in ends.items() if len(found)]
    faults = []
    for panel in shown:
        known = ends[panel][ends[panel][:, 0] > ends[panel][-1, 0] - RECENT_S]
        low, high = known[:, 1].min(), known[:, 2].max()
        bands = measured(logged, f"{panel.drawn}/**")
        if len(bands):
            seen = bands[bands[:, 0] > bands[-1, 0] - window_s]
            low, high = min(low, seen[:, 1].min()), max(high, seen[:, 1].max())
            now = bands[bands[:, 0] > bands[-1, 0] - RECENT_S]
            half = np.sqrt(now[:, 2])
            outside = (now[:, 1] - half < low) | (now[:, 1] + half > high)
            if outside.mean() > OUTSIDE:
                faults.append(f"{panel.key}: {outside.mean():.0%} of its band outside {low:g} to {high:g}")
    return faults


def stored(recording: Path) -> ChunkStore:
    """Return what a recording holds, read once."""
    return RrdReader(str(recording)).stream().collect()


def scalars(logged: ChunkStore, path: str) -> FloatArray:
    """Return device time in s and the scalars of an entity, a row each."""
    return _columns(logged, path, ("Scalars:scalars",))


def measured(logged: ChunkStore, path: str) -> FloatArray:
    """Return device time in s, value and variance of all measurements below an entity, a row each."""
    return _columns(logged, path, ("Measurements:values", "Measurements:variances"))


def _columns(logged: ChunkStore, path: str, names: tuple[str, ...]) -> FloatArray:
    parts = []
    for chunk in logged.stream().filter(content=[path], has_timeline="device_time"):
        batch = chunk.to_record_batch()
        if all(name in batch.schema.names for name in names):
            time_s = 1e-9 * batch.column("device_time").cast("int64").to_numpy(zero_copy_only=False)
            values = [batch.column(name).flatten().to_numpy().reshape(len(time_s), -1) for name in names]
            parts.append(np.column_stack([time_s, *values]))
    if not parts:
        return np.empty((0, 3))
    found = np.concatenate(parts)
    return np.asarray(found[np.argsort(found[:, 0], kind="stable")])
