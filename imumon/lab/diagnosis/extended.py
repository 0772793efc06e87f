"""The extended model: what was declared, with the effects that are claimed, as a model file."""

from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial

from imumon.effects.base import Effect
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.models.curves.polynomial import HIGHEST_ORDER, PolynomialCurve
from imumon.models.model import UNITS, BiasModel, ChannelModel, TrainedOn
from imumon.version import __version__

from .blocks import RunInBlocks
from .candidates import Channel
from .diagnose import Diagnosis
from .fit import Fit
from .verdict import ChannelVerdict

# Range of a curve over the one that it was fitted on, so that an end is not in and out by turns.  Assumed.
WIDENED = 1.01


def extended_model(diagnosis: Diagnosis) -> BiasModel:
    """Return the declared model with what carries over of the claims, for every channel, and the channels of
    the present model that were not diagnosed."""
    # A jump, a turn-on offset and an amplitude that is another in each run are in the report alone.
    present, recorded = diagnosis.model, [run for run in diagnosis.train if run.in_slots.origin]
    diagnosed = {verdict.name: _channel(verdict, present) for verdict in with_model(diagnosis)}
    channels = (present.channels if present else {}) | diagnosed
    trained = [*map(trained_on, recorded)]
    earlier = present.trained_on if present and len(channels) > len(diagnosed) else []
    update: dict[str, Any] = {
        "made_by": f"imumon {__version__}",
        "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
        "block_s": diagnosis.train[0].block_s,
        "trained_on": [*(one for one in earlier if one not in trained), *trained],
        "channels": channels,
    }
    if present:
        return present.model_copy(update=update)
    for name in ("device", "serial"):
        distinct = {getattr(run.in_slots.origin, name) for run in recorded}
        update |= {name: distinct.pop()} if len(distinct) == 1 else {}
    return BiasModel(**update)


def with_model(diagnosis: Diagnosis) -> list[ChannelVerdict]:
    """Return the verdicts on channels that a model file may have: gyros and accelerometers."""
    return [verdict for verdict in diagnosis.verdicts if verdict.name in UNITS]


def _channel(verdict: ChannelVerdict, model: BiasModel | None) -> ChannelModel:
    """Return the model of a channel: the present one, or none at all, with what was fitted."""
    fitted = verdict.after if verdict.predicts else verdict.before
    score = verdict.test_after if verdict.predicts else verdict.test_before
    rms = score.rms if np.isfinite(score.rms) else fitted.train_rms
    channel = verdict.channel
    middle, half = channel.scale
    residual = float(np.sqrt(max(rms**2 - channel.floor.sd**2, 0.0)))
    new = {
        "unit": UNITS[verdict.name],
        "temperature_column": channel.training.temperature_name,
        "temperature_range_degc": [middle - WIDENED * half, middle + WIDENED * half],
        "residual_sd": residual,
        "curve": PolynomialCurve(center_degc=middle, half_width_degc=half, coefficients=[0.0]),
    }
    present = model.channels[verdict.name] if model else ChannelModel.model_validate(new)
    return refitted(present, channel, without_unknown_constant(fitted, verdict.name, model), residual)


def without_unknown_constant(fitted: Fit, name: str, model: BiasModel | None) -> Fit:
    """Return a fit whose constant, where it holds gravity, or an earth rate that the present model has not,
    is zero: at the middle the present bias stays."""
    if name.startswith("accel") or (model and model.earth_rate == "removed"):
        return fitted._replace(declared=np.append(0.0, fitted.declared[1:]))
    return fitted


def refitted(present: ChannelModel, channel: Channel, fitted: Fit, residual_sd: float) -> ChannelModel:
    """Return the present model with the fitted polynomial more in its curve, and what carries over beside
    it."""
    # To a curve that is no polynomial itself it is added as an effect.  The curve holds where it was fitted.
    curve = present.curve
    middle, half = channel.scale
    low, high = middle - half, middle + half
    total = Polynomial(fitted.declared, domain=[low, high])
    others = list[Effect]()
    lasting = [part.effect.with_start(part.start) for part in fitted.parts if part.carries_over]
    update: dict[str, Any] = {"residual_sd": residual_sd, "held_out_rms": {}}
    if total.degree() > 0 or any(effect.polynomial() is not None for effect in lasting):
        margin, (lowest, highest) = (WIDENED - 1.0) * half, present.temperature_range_degc
        update["temperature_range_degc"] = [max(low - margin, lowest), min(high + margin, highest)]
    for effect in (*(effect for effect in present.effects if effect.polynomial() is not None), *lasting):
        shape = effect.polynomial()
        if shape is None or shape.degree() > HIGHEST_ORDER:
            others.append(effect)
        else:
            total = total + shape.convert(domain=total.domain, window=total.window)
    if isinstance(curve, PolynomialCurve):  # whose coefficients are those of a Chebyshev series
        ends = curve.center_degc - curve.half_width_degc, curve.center_degc + curve.half_width_degc
        own_curve = Chebyshev(curve.coefficients, ends).convert(total.domain)
        coefficients = (total.convert(total.domain, Chebyshev) + own_curve).coef.tolist()
        curve = PolynomialCurve(center_degc=middle, half_width_degc=half, coefficients=coefficients)
    else:
        constant, *powers = total.coef.tolist()
        curve = curve.minus(-constant)  # a curve can only be lowered
        if any(powers):
            more_powers = TemperatureCurve(middle=middle, half_span=half, first_power=1, powers=len(powers))
            others.append(more_powers.with_coefficients(powers))
    return present.model_copy(update=update | {"curve": curve, "effects": others})


def trained_on(run: RunInBlocks) -> TrainedOn:
    """Return what a model states of a run that it was fitted to."""
    origin, temperature = run.in_slots.origin, np.concatenate(list(run.temperature.values()))
    assert origin
    return TrainedOn(
        session=origin.session,
        run=origin.index,
        sha256=origin.sha256,
        rest_s=float(run.weight.sum()) * run.block_s / run.slots_per_block,
        blocks=len(run),
        temperature_range_degc=[float(temperature.min()), float(temperature.max())],
    )
