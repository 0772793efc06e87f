"""What else was recorded and may drive a bias: which columns, how they move, and what hides them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.base import DrivenEffect, Scale, Survey
from imumon.effects.library import EFFECTS
from imumon.effects.product import Product
from imumon.errors import ImumonError, Reason
from imumon.lab.diagnosis.blocks import BLOCK_S, RunBlocks
from imumon.lab.diagnosis.runs import CHANNELS, Run

OPERATORS = sum(issubclass(kind, (DrivenEffect, Product)) for kind in EFFECTS.values())
"""Number of effects that a driver may have."""
SHADOW = 0.02
"""A driver of whose variance less is left beside temperature and time is reported to go with them: the sigma
of its coefficient is seven times that of one by itself."""


def recorded(
    train: Sequence[Run],
    test: Sequence[Run],
    beside: Sequence[str],
    wanted: Sequence[str] | None,
    caveats: list[str],
) -> list[str]:
    """Return the drivers that vary in training and are in every run, of those wanted (None: of all).

    `beside` are the temperatures that the curves are over.

    Raises BAD_CONFIG when one that is wanted is not there.
    """
    there = dict.fromkeys(name for run in train for name in run.mean)
    possible = [name for name in there if name not in CHANNELS and name not in beside]
    if lacking := [name for name in wanted or () if name not in possible]:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"--drivers: {', '.join(lacking)} is not in the training data",
            f"there are {', '.join(possible) or 'none'}; a map names others with other: {{NAME: ...}}",
        )
    found = []
    for name in possible if wanted is None else wanted:
        values = np.concatenate([run.mean[name] for run in train if name in run.mean])
        if not np.nanmax(values) > np.nanmin(values):
            continue
        runs = [run.name for run in (*train, *test) if not _covers(run, name)]
        if runs:
            caveats.append(f"{name} is hardly recorded in {', '.join(runs)}: no effect of it is looked for")
        else:
            found.append(name)
    return found


def _covers(run: Run, name: str) -> bool:
    return name in run.mean and np.isfinite(run.mean[name]).sum() >= 0.5 * run.duration_s / BLOCK_S


def with_drivers(found: Survey, runs: Sequence[RunBlocks], temperature: str) -> Survey:
    """Return what training runs can show, with the drivers that there are beside a temperature."""
    scales = {}
    for name, values in _means(runs, temperature).items():
        low, high = float(values.min()), float(values.max())
        scales[name] = Scale(0.5 * (low + high), 0.5 * (high - low) or 1.0)
    return replace(found, others=scales, choices=max(1, len(scales)) * OPERATORS)


def _means(runs: Sequence[RunBlocks], temperature: str) -> dict[str, FloatArray]:
    """Return the block means of each driver over all runs, (n,) each."""
    drives = [(run, run.drives[temperature].others) for run in runs if temperature in run.drives]
    names = drives[0][1] if drives else {}
    return {
        name: np.concatenate([run.average(others[name][:, np.newaxis])[:, 0] for run, others in drives])
        for name in names
    }


def shadows(runs: Sequence[RunBlocks], temperature: str, scale: Scale, degree: int) -> list[str]:
    """Return the drivers that go with temperature and time in these runs: nothing separates them."""
    u = (np.concatenate([run.temperature[temperature] for run in runs]) - scale.middle) / scale.half_span
    time_s = np.concatenate([run.time_s for run in runs])
    basis = np.linalg.qr(np.column_stack([u[:, np.newaxis] ** np.arange(degree + 3), time_s]))[0]
    found = []
    for name, values in _means(runs, temperature).items():
        centred = values - values.mean()
        left = centred - basis @ (basis.T @ centred)
        if left @ left < SHADOW * (centred @ centred):
            found.append(name)
    return found
