"""Results as remarks, as JSON, and as the noise section of a pipeline."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from imumon.allan.analysis import Deviations, Result
from imumon.allan.covariance import CONFIDENCE
from imumon.allan.fit import AMBIGUOUS, DIGITS, NO_SUM, Estimate
from imumon.allan.parameters import TERMS_OF
from imumon.allan.recording import GROUPS, UNITS, group_of, rate_hz
from imumon.config import dump_yaml
from imumon.errors import ImumonError, Reason
from imumon.files import check_output, write_text


def check_outputs(plot: Path | None, *files: Path | None) -> None:
    """Refuse outputs that could not be written, or would replace what a person may have edited.

    Raises EXISTS for a file that is there (a picture is replaced); BAD_CONFIG for a picture that is not a
    PNG, and where there is no folder.
    """
    if plot is not None and plot.suffix.lower() != ".png":
        raise ImumonError(Reason.BAD_CONFIG, f"{plot}: the picture is a PNG", "name it NAME.png")
    for path in (plot, *files):
        if path is not None:
            check_output(path, replace=path is plot)


STUCK = "the reading never changes: the channel is stuck, or its resolution too coarse; no terms"
SHORT = "too short for a fit of the terms"
FILTERED = "shorter averaging times are not fitted: no sum of the terms describes them (a filter?)"
DIFFERS = "the curve differs so much from every sum of the terms; the standard deviations take that in"
DISTURBED = (
    "no sum of the terms describes longer averaging times (a vibration, a cycle, motion?): "
    "only the angle random walk is reported"
)
UNLIKE = "no sum of the terms describes the curve (a vibration, a cycle, motion?): no term is reported"
EITHER = (
    "correlated noise describes the curve as well as bias instability or a random walk: neither is "
    "reported; record for longer"
)
HIDDEN = "the steps of the readings hide the noise: no term is reported"
ROUGH = "the steps of the readings add to the noise"


def remarks(results: Mapping[str, Result]) -> list[str]:
    """Return why terms are less certain or missing, or from a part of the curve, with their channels."""
    channels: dict[str, list[str]] = {}
    for name, result in results.items():
        for sentence, detail in _remarks(result, UNITS[group_of(name)]):
            channels.setdefault(sentence, []).append(f"{name} {detail}".rstrip())
    return [f"{', '.join(names)}: {sentence}" for sentence, names in channels.items()]


def _remarks(result: Result, unit: str) -> Iterator[tuple[str, str]]:
    """Yield sentences about one channel, each with the number that goes with it."""
    fit, digits = result.fit, result.digits
    if fit is None:
        yield SHORT if result.allan.values.any() else STUCK, ""
        return
    if fit.first:
        yield FILTERED, f"{result.tau_s[fit.first]:.2g} s"
    if fit.model_error > NO_SUM and fit.withheld != DIGITS:
        yield UNLIKE, ""
    elif fit.model_error and fit.withheld != DIGITS:
        yield DIFFERS, f"{50.0 * fit.model_error:.2g} %"
    if fit.last < result.trusted - 1:
        yield DISTURBED, f"{result.tau_s[fit.last]:.2g} s"
    if fit.withheld == AMBIGUOUS:
        yield EITHER, ""
    if digits is not None:
        steps = f"{digits.step:.3g} {unit}, {1.0 / digits.ratio:.2g} times the noise"
        walk = fit.terms["angle_random_walk"]
        if fit.withheld == DIGITS:
            yield HIDDEN, steps
        elif walk is not None and 0.5 * digits.share * walk.value > walk.sd:
            yield ROUGH, f"{steps}, {digits.share:.0%} of the variance"


def as_json(results: Mapping[str, Result]) -> dict[str, Any]:
    """Return what ``--json`` prints, one entry per channel; a term that the data do not show is null."""
    return {name: _channel(name, result) for name, result in results.items()}


def _channel(name: str, result: Result) -> dict[str, Any]:
    style, fit, series = TERMS_OF[group_of(name)], result.fit, result.series
    terms = {name: _estimate(fit.terms[name] if fit else None, term.unit) for name, term in style.items()}
    return {
        "tau_s": result.tau_s.tolist(),
        "oadev": result.allan.values.tolist(),
        "unit": UNITS[group_of(name)],
        **terms,
        "longest_tau_s": result.longest_tau_s,
        "confidence": CONFIDENCE,
        "oadev_interval": _interval(result.allan),
        "mdev": result.modified.values.tolist(),
        "mdev_interval": _interval(result.modified),
        "ohdev": result.hadamard.values.tolist(),
        "ohdev_interval": _interval(result.hadamard),
        "noise": list(result.noise),
        "fit_tau_s": None if fit is None else result.tau_s[[fit.first, fit.last]].tolist(),
        "model_error": None if fit is None else fit.model_error,
        "withheld": None if fit is None else fit.withheld or None,
        "step": None if result.digits is None else result.digits.step,
        "noise_in_steps": None if result.digits is None else result.digits.ratio,
        "rate_hz": rate_hz(series),
        "samples": series.used,
        "samples_left_out": series.samples - series.used,
        "samples_missing": int(series.gap_lengths.sum()),
        "pieces": len(series.islands) - 1,
        "duration_s": series.duration_s,
    }


def _estimate(estimate: Estimate | None, unit: str) -> dict[str, object] | None:
    return None if estimate is None else {"value": estimate.value, "sd": estimate.sd, "unit": unit}


def _interval(deviations: Deviations) -> dict[str, list[float]]:
    return {"low": deviations.low.tolist(), "high": deviations.high.tolist()}


def noise_section(results: Mapping[str, Result]) -> dict[str, dict[str, list[float | None]]]:
    """Return the terms in SI units, per sensor, each a list for x, y, z; None for what is not shown."""
    section: dict[str, dict[str, list[float | None]]] = {}
    for group in GROUPS:
        axes = [results.get(f"{group}_{axis}") for axis in "xyz"]
        if any(axes):
            section[group] = {
                style.key: [value_of(result, term) for result in axes]
                for term, style in TERMS_OF[group].items()
            }
    return section


def value_of(result: Result | None, term: str) -> float | None:
    """Return a term in SI units, None where the data do not show it."""
    if result is None or result.fit is None:
        return None
    estimate = result.fit.terms[term]
    return None if estimate is None else float(f"{estimate.value:.6g}")


def write_noise(path: Path, results: Mapping[str, Result], source: Path) -> None:
    """Write the noise section of a pipeline YAML.

    Raises OSError when the file cannot be written; one that was there before is untouched.
    """
    head = [
        f"# Noise of {source.name}, by Allan deviation; x, y, z; null: the data do not show it.",
        "# SI units.  Bias instability B: the flat part of the Allan deviation is 0.664 B.",
    ]
    write_text(path, "\n".join(head) + "\n" + dump_yaml({"noise": noise_section(results)}, flow=None))
