"""The published methods that a setup asks for, as stages that run beside the defaults."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from imumon.papers import dense_zupt, random_error, self_alignment
from imumon.papers.fir import FirRate, FirStage
from imumon.papers.fir import Params as FirParams
from imumon.pipeline import Estimator
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.run.paper_names import PublishedMethod
from imumon.run.setup import Setup

DEFAULT_STEP_DEGC = 0.05
"""Quantization step of the paper's sensors, where the device file says none."""


def published_stages(setup: Setup, temperature: TemperatureRateParameters | None = None) -> list[Estimator]:
    """Return the stages of `setup.published`, and of ``random_error: {method: sr_rsukf}``; they run last.

    The alignment needs a latitude; without one it is left out, as the default is.
    """
    stages: list[Estimator] = []
    if setup.random_error.method != "drift":
        methods = _random_error(setup, [setup.random_error.method])
        stages.append(random_error.InsteadOfDefault(methods))
    if "fir" in setup.published:
        stages.append(FirStage(_fir(temperature or TemperatureRateParameters())))
    if chosen := _chosen(setup, random_error.METHODS):
        stages.append(_random_error(setup, chosen))
    stages += [_dense_zupt(setup, method) for method in _chosen(setup, dense_zupt.METHODS)]
    chosen = _chosen(setup, self_alignment.METHODS)
    if chosen and setup.latitude_deg is not None:
        given = setup.alignment
        latitude = math.radians(setup.latitude_deg)
        params = self_alignment.Params(latitude, given.coarse_s, given.corner_hz, given.damping)
        stages.append(self_alignment.SelfAlignment(params, chosen))
    return stages


def fir_method(given: TemperatureRateParameters) -> Callable[[], FirRate]:
    """Return what makes the FIR exponential regression with the parameters of the device file."""
    return partial(FirRate, _fir(given))


def _fir(given: TemperatureRateParameters) -> FirParams:
    step = DEFAULT_STEP_DEGC if given.step_degc is None else given.step_degc
    return FirParams(step, given.window_s, given.time_constant_s, given.buffer_size)


def _chosen(setup: Setup, names: Sequence[str]) -> list[PublishedMethod]:
    return [name for name in setup.published if name in names]


def _random_error(setup: Setup, methods: Sequence[str]) -> random_error.RandomErrorMethods:
    return random_error.RandomErrorMethods(methods, setup.random_error_with_noise, setup.bias_model)


def _dense_zupt(setup: Setup, method: str) -> dense_zupt.DenseZupt:
    """Return ZUPT or TCZUPT with the noise that is known; the bias instability stays the paper's."""
    given = setup.zupt_with_noise
    settings = dense_zupt.DenseSettings(
        dense_zupt.SLOT_S, latitude_deg=setup.latitude_deg, heading_deg=setup.heading_deg
    )
    white = given.angle_random_walk_rad_per_sqrt_s
    if white is not None:
        settings = replace(settings, angle_random_walk=np.array(white))
    return dense_zupt.DenseZupt(method, settings, setup.bias_model, given.assume_at_rest)
