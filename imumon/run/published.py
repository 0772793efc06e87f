"""The published methods that a setup asks for, as stages that run beside the defaults."""

from __future__ import annotations

from collections.abc import Sequence

from imumon.pipeline import Estimator
from imumon.published import random_error
from imumon.published.local_level import LocalLevel, from_noise
from imumon.published.names import PublishedMethod
from imumon.run.setup import Setup


def published_stages(setup: Setup) -> list[Estimator]:
    """Return the stages of `setup.published`, and of ``random_error: {method: sr_rsukf}``; they run last."""
    stages: list[Estimator] = []
    if setup.random_error.method != "drift":
        methods = _random_error(setup, [setup.random_error.method])
        stages.append(random_error.InsteadOfDefault(methods))
    chosen = _chosen(setup, random_error.METHODS)
    if chosen:
        stages.append(_random_error(setup, chosen))
    return stages


def _chosen(setup: Setup, names: Sequence[str]) -> list[PublishedMethod]:
    return [name for name in setup.published if name in names]


def _random_error(setup: Setup, methods: Sequence[str]) -> random_error.RandomErrorMethods:
    given = setup.random_error_with_noise
    known: dict[str, LocalLevel] = {
        channel: from_noise(noise.angle_random_walk, noise.bias_instability, noise.rate_random_walk)
        for channel, noise in given.noise.items()
    }
    params = random_error.Params(
        methods=methods,
        noise=known,
        risk=given.risk,
        phi_limit=given.phi_limit,
        learn_s=given.learn_s,
        mean_s=given.mean_s,
        hold_s=given.hold_s,
        assume_rest=given.assume_rest,
    )
    return random_error.RandomErrorMethods(params, setup.bias_model)
