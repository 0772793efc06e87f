"""The published methods that a setup names, as stages beside the defaults; each is loaded when it runs."""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.pipeline import Estimator
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.run.setup import Setup

DEFAULT_STEP_DEGC = 0.05
"""Quantization step of the paper's sensors, where the device file states none."""


def published_stages(
    setup: Setup, temperature: TemperatureRateParameters | None, _: Sequence[Estimator]
) -> list[Estimator]:
    """Return the stages of the published methods of a setup; they run last.

    The alignment needs a latitude; without one it is left out, as the default is.
    """
    stages: list[Estimator] = []
    given = temperature or TemperatureRateParameters()
    if "fir" in setup.methods or given.method == "fir_exponential":
        from .fir import FirStage, Params

        step = given.step_degc or DEFAULT_STEP_DEGC
        stages.append(FirStage(Params(step, given.window_s, given.time_constant_s, given.buffer_size)))
    if chosen := _chosen(setup, "stf", "sr_ukf", "sr_rsukf"):
        from .random_error import RandomErrorMethods

        stages.append(RandomErrorMethods(chosen, setup.random_error_with_noise, setup.bias_model))
    for method in _chosen(setup, "dense_zupt", "dense_tczupt"):
        from .dense_zupt import SLOT_S, DenseSettings, DenseZupt

        zupt = setup.zupt_with_noise
        settings = DenseSettings(SLOT_S, latitude_deg=setup.latitude_deg, heading_deg=setup.heading_deg)
        if (white := zupt.angle_random_walk_rad_per_sqrt_s) is not None:  # the rest is the paper's
            settings = replace(settings, angle_random_walk=np.array(white))
        stages.append(DenseZupt(method, settings, setup.bias_model, zupt.assume_at_rest))
    chosen = _chosen(setup, "fixed_gain_loop", "total_average", "curve_fit")
    if chosen and setup.latitude_deg is not None:
        from .self_alignment import SelfAlignment

        stages.append(SelfAlignment(math.radians(setup.latitude_deg), chosen))
    return stages


def _chosen(setup: Setup, *names: str) -> list[str]:
    return [name for name in setup.methods if name in names]
