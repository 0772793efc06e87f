"""How well the parameters of a model are known: standard deviations with the noise that was found.

What is searched (time constants, widths) is where the likelihood is largest, what is linear is ordinary least
squares beside it.  Both are linear in the noise near the truth, so one covariance of the noise gives all of
their errors, those that the linear ones take over from the searched ones among them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.candidates import Candidate, Part
from imumon.diagnosis.channel import Channel, ordinary
from imumon.diagnosis.selection import Search

CHANGE = 0.01
"""Share by which a parameter is changed to see what hangs on it."""


@dataclass(frozen=True, slots=True, eq=False)
class PartSigma:
    """Standard deviations of a part of a model."""

    coefficients: FloatArray
    """One row where they are shared, (runs, k)."""
    searched: dict[str, float]
    """Of each nonlinear parameter, in its unit."""


@dataclass(frozen=True, slots=True, eq=False)
class Sigmas:
    """Of each candidate's parts; of the declared model the covariance, (degree + 1, degree + 1)."""

    declared: FloatArray
    parts: list[list[PartSigma]]


def sigmas(found: Search, model: Sequence[Candidate]) -> Sigmas:
    """Return the standard deviations of a model, over the blocks of its search."""
    channel, likelihood = found.channel, found.likelihood
    design = channel.design(model)
    coefficients = ordinary(design, channel.values)
    width = channel.base.shape[1]
    names = [
        (number, at, name)
        for number, one in enumerate(model)
        for at, part in enumerate(one.parts)
        for name in part.effect.nonlinear
        if getattr(part.effect, name) > 0.0
    ]
    slopes = np.column_stack(
        [np.empty((len(design), 0)), *(_slope(found, model, coefficients[width:], *one) for one in names)]
    )
    noise = likelihood.best(channel.values, design)[1]
    whiten = likelihood.white(np.eye(len(design)), noise)
    both = whiten @ np.column_stack([design, slopes])
    left = whiten @ channel.values
    searching = np.linalg.pinv(both, rcond=1e-10)
    variance = float(np.sum((left - both @ (searching @ left)) ** 2)) / max(len(left) - both.shape[1], 1)
    # The error of each parameter as weights on whitened noise.
    logarithms = searching[design.shape[1] :]
    least = np.linalg.pinv(design, rcond=1e-10)
    linear = np.linalg.solve(whiten.T, least.T).T - (least @ slopes) @ logarithms
    spread = np.sqrt(variance) * np.linalg.norm(linear, axis=1)
    share = np.sqrt(variance) * np.linalg.norm(logarithms, axis=1)
    searched = {one[:2]: dict[str, float]() for one in names}
    for (number, at, name), sd in zip(names, share.tolist(), strict=True):
        searched[number, at][name] = sd * getattr(model[number].parts[at].effect, name)
    declared = _of_curve(channel, model, linear, width)
    return Sigmas(variance * declared @ declared.T, _of_parts(found, model, spread[width:], searched))


def _of_curve(channel: Channel, model: Sequence[Candidate], linear: FloatArray, first: int) -> FloatArray:
    """Return the errors of the curve's coefficients, as weights, of those of all columns, (degree + 1, n)."""
    curve = linear[: channel.declared.degree + 1]
    for one in model:
        if one.whole:
            effect = one.parts[0].effect
            curve = np.pad(curve, ((0, max(0, effect.width + 1 - len(curve))), (0, 0)))
            for at, row in enumerate(np.eye(effect.width)):
                powers = channel.declared.powers(effect.with_coefficients(-row).curve())
                curve[: len(powers)] += np.outer(powers, linear[first + at])
        first += sum(map(len, channel.pool.terms(one)))
    return curve


def _of_parts(
    found: Search,
    model: Sequence[Candidate],
    spread: FloatArray,
    searched: dict[tuple[int, int], dict[str, float]],
) -> list[list[PartSigma]]:
    each, first = [], 0
    for number, one in enumerate(model):
        parts, at = [], first
        for index, part in enumerate(one.parts):
            size = part.effect.width * max(1, len(part.runs))
            rows = spread[at : at + size].reshape(-1, part.effect.width)
            parts.append(PartSigma(rows, searched.get((number, index), {})))
            at += size
        each.append(parts)
        first += sum(map(len, found.channel.pool.terms(one)))
    return each


def _slope(
    found: Search, model: Sequence[Candidate], coefficients: FloatArray, number: int, at: int, name: str
) -> FloatArray:
    """Return how the model changes with the logarithm of a parameter, (n,)."""
    one = model[number]
    first = sum(sum(map(len, found.channel.pool.terms(other))) for other in model[:number])
    ends = []
    for factor in (1.0 + CHANGE, 1.0 - CHANGE):
        part = one.parts[at]
        effect = part.effect.model_copy(update={name: getattr(part.effect, name) * factor})
        changed = replace(one, parts=(*one.parts[:at], Part(effect, part.runs), *one.parts[at + 1 :]))
        columns = found.channel.pool.design([changed])
        ends.append(columns @ coefficients[first : first + columns.shape[1]])
    return np.asarray((ends[0] - ends[1]) / (2.0 * CHANGE))
