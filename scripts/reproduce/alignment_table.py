"""The alignment of Lee et al.: closed forms beside the loop of imumon, and figures 5 to 9."""

from __future__ import annotations

from collections.abc import Iterator

from alignment_figures import draw
from alignment_loop import Loop, comparisons
from study import Options, Study, Table

LOOPS = {
    "200 Hz": Loop(),
    "2000 Hz": Loop(rate_hz=2000.0),
    "2000 Hz, and 0.01 °/h of gyro bias": Loop(rate_hz=2000.0, gyro_deg_per_h=0.01),
}


def tables(given: Options) -> Iterator[Table]:
    """Yield the closed forms beside the loop of imumon."""
    names = list(LOOPS)[: 1 if given.quick else None]
    found = [comparisons(LOOPS[name]) for name in names]
    rows = [
        [parts[0][0], *(f"{100 * value:.3f} %" for _, value in parts)] for parts in zip(*found, strict=True)
    ]
    title = "Largest difference between closed form and simulation, of the largest (30 µg, 300 s)"
    yield Table(title, ["equation", *names], rows)


STUDY = Study(tables, draw=draw)
