"""What else was recorded and may drive a bias: which columns, how they move, and how many they amount to."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BLOCK_S, RunBlocks
from imumon.diagnosis.runs import CHANNELS, Run
from imumon.effects.base import DrivenEffect, Scale, Survey
from imumon.effects.drift import Drift
from imumon.effects.library import EFFECTS
from imumon.effects.product import Product
from imumon.effects.thermal_lag import ThermalLag
from imumon.effects.warm_up import WarmUp
from imumon.errors import ImumonError, Reason

OPERATORS = sum(issubclass(kind, (DrivenEffect, Product)) for kind in EFFECTS.values())
"""What may be done with a driver."""
SHADOW = 0.02
"""A driver of whose variance less is left beside temperature and time is said to go with them."""
TIMES_S = (100.0, 300.0, 1000.0)
"""Time constants of lags and warm-ups that a driver is compared with."""


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


def with_drivers(seen: Survey, runs: Sequence[RunBlocks], temperature: str) -> Survey:
    """Return what training runs can show, with the drivers that there are beside a temperature."""
    means = _means(runs, temperature)
    scales = {}
    for name, values in means.items():
        low, high = float(values.min()), float(values.max())
        scales[name] = Scale(0.5 * (low + high), 0.5 * (high - low) or 1.0)
    choices = max(1.0, _independent(list(means.values()))) * OPERATORS
    return replace(seen, others=scales, choices=choices)


def _means(runs: Sequence[RunBlocks], temperature: str) -> dict[str, FloatArray]:
    names = runs[0].drives[temperature].others if temperature in runs[0].drives else {}
    return {
        name: np.concatenate(
            [run.average(run.drives[temperature].others[name][:, np.newaxis])[:, 0] for run in runs]
        )
        for name in names
    }


def _independent(columns: Sequence[FloatArray]) -> float:
    """Return how many columns are independent in effect: (sum of eigenvalues)² over that of their squares,
    of their correlation."""
    moving = [column for column in columns if column.std() > 0]
    if not moving:
        return 0.0
    values = np.linalg.eigvalsh(np.atleast_2d(np.corrcoef(moving)))
    return float(values.sum() ** 2 / (values**2).sum())


def shadows(runs: Sequence[RunBlocks], temperature: str, scale: Scale, degree: int) -> list[str]:
    """Return the drivers that go with temperature and time in these runs: nothing tells them apart."""
    columns = np.concatenate([_regressors(run, temperature, scale, degree) for run in runs])
    basis = np.linalg.qr(columns)[0]
    found = []
    for name, values in _means(runs, temperature).items():
        centred = values - values.mean()
        left = centred - basis @ (basis.T @ centred)
        if left @ left < SHADOW * (centred @ centred):
            found.append(name)
    return found


def _regressors(run: RunBlocks, temperature: str, scale: Scale, degree: int) -> FloatArray:
    drive = run.drives[temperature]
    lags = [
        ThermalLag(time_constant_s=tau, middle=scale.middle, half_span=scale.half_span) for tau in TIMES_S
    ]
    others = [Drift(), *(WarmUp(time_constant_s=tau) for tau in TIMES_S)]
    u = (run.temperature[temperature] - scale.middle) / scale.half_span
    parts = [run.average(effect.columns(drive)) for effect in (*lags, *others)]
    return np.column_stack([u[:, np.newaxis] ** np.arange(degree + 3), *parts])
