"""The next experiment: the shortest that answers what a diagnosis leaves open, tried on the fitted unit.

For each question every answer is simulated, with the noise that was found, and searched as a recording is.
The evidence is the difference of the gains, in BIC, between the effect that the unit has and each rival.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import Field

from imumon.blocks import SampleBlock
from imumon.config import StrictModel, load_yaml
from imumon.diagnosis.blocks import BLOCK_S, at_poses, make_blocks, survey, white_floor
from imumon.diagnosis.candidates import Pool
from imumon.diagnosis.channel import Channel, Declared, residual_rms
from imumon.diagnosis.earth import earth_rate, turned, without
from imumon.diagnosis.engine import search_block
from imumon.diagnosis.gains import CLOSE, CLOSE_SHARE, PROVEN
from imumon.diagnosis.likelihood import TAUS_S
from imumon.diagnosis.profiles import Profile, profiles
from imumon.diagnosis.questions import NOTHING
from imumon.diagnosis.runs import Run, collect, unit_of
from imumon.diagnosis.selection import Search, search
from imumon.effects.base import ACCEL
from imumon.effects.library import EFFECTS, AnyEffect, effects_for
from imumon.files import write_text
from imumon.geodesy import DEG_PER_H, MICRO_G
from imumon.models.model import UNITS
from imumon.simulation.unit import Scenario, SimulatedUnit
from imumon.simulation.unit.scenario import Unit
from imumon.simulation.unit.thermal import chamber_knots

RATE_HZ = 4.0
"""Enough for the scatter inside a second to tell the white noise."""
LATITUDE_DEG = 45.0
MARGIN = 1.5
"""The evidence that is planned for over what is needed: what is reached scatters."""
TRIALS, PROOFS = 2, 3
"""Units on which a profile is tried, and others on which the evidence of the chosen one is told."""
EVERY_SHAPE = 16
"""So many profiles are tried whatever they tell: by then each shape has been."""
DRIVEN = "something that the temperature drives"
LONG_S = 1e5
"""Correlation time of a process that stands for a random walk of an accelerometer."""

Progress = Callable[[str], None]


class _Slow(StrictModel, extra="ignore"):
    flicker_rms: float = 0.0
    random_walk_per_sqrt_s: float = 0.0


class _Rms(StrictModel, extra="ignore"):
    train_rms: float


class Model(StrictModel, extra="ignore"):
    """An answer: its name, whether it carries over, the declared polynomial of u, and effects."""

    name: str
    carries: bool
    declared: list[float]
    effects: list[AnyEffect]

    @property
    def times_s(self) -> list[float]:
        """Time constants and delays of its effects."""
        found = [getattr(one, key) for one in self.effects for key in one.nonlinear if key.endswith("_s")]
        return [float(value) for value in found]


class _Channel(StrictModel, extra="ignore"):
    noise_floor_rms: float
    slow_noise: _Slow
    before: _Rms
    questions: list[list[Model]]


class Report(StrictModel, extra="ignore"):
    """What is needed of a report.json."""

    format: Literal["imumon-diagnosis/1"]
    temperature_range_degc: Annotated[list[float], Field(min_length=2, max_length=2)]
    fastest_degc_per_min: float
    channels: dict[str, _Channel]


@dataclass(frozen=True, slots=True)
class Open:
    """A question, and the channel of those that have it in which the residual is the largest."""

    channel: str
    also: tuple[str, ...]
    answers: tuple[Model, ...]

    @property
    def name(self) -> str:
        """For people: which of these."""
        names = [answer.name for answer in self.answers]
        return " or ".join(names if len(names) > 1 else [*names, DRIVEN])


@dataclass(frozen=True, slots=True)
class Evidence:
    """How a profile does."""

    value: float
    needed: float
    """Difference of gains in BIC for the pair that is told apart worst, and what is needed for it."""
    truth: str
    rival: str
    """That pair."""

    @property
    def ratio(self) -> float:
        """Of what is needed."""
        return self.value / self.needed


@dataclass(frozen=True, slots=True)
class Plan:
    """The answer to what to do next about a question.

    `profile` is None where nothing that was tried tells, and `why_not` says why; else `reached` is the
    evidence on one more simulated unit, with all effects in question.
    """

    question: Open
    profile: Profile | None
    expected: Evidence | None
    reached: float = float("nan")
    why_not: str = ""


def load_report(path: Path) -> Report:
    """Read a report.json, or that of a folder; raises BAD_CONFIG with file and line when it is none."""
    return load_yaml(path / "report.json" if path.is_dir() else path, Report)


def open_questions(report: Report) -> list[Open]:
    """Return the questions of a report, each once for the channels of a sensor that share it."""
    found: dict[tuple[str, ...], list[tuple[float, str, list[Model]]]] = {}
    for name, channel in report.channels.items():
        # A unit is simulated, which has gyros and accelerometers.
        for answers in channel.questions if name in UNITS else ():
            key = (name[:-2], *sorted(answer.name for answer in answers))
            size = channel.before.train_rms / channel.noise_floor_rms
            found.setdefault(key, []).append((size, name, answers))
    opened = []
    for group in found.values():
        _, name, answers = max(group, key=lambda one: one[0])
        opened.append(Open(name, tuple(one for _, one, _ in group if one != name), tuple(answers)))
    return opened


def plan(report: Report, question: Open, most_s: float, progress: Progress | None = None) -> Plan:
    """Return the shortest experiment that answers a question, with the evidence to expect of it."""
    inputs = {name for answer in question.answers for effect in answer.effects for name in effect.inputs}
    if inputs - {ACCEL}:
        lacking = ", ".join(sorted(inputs - {ACCEL}))
        return Plan(
            question, None, None, why_not=f"{lacking} must vary apart from the rest: no chamber does that"
        )
    if not all(answer.carries for answer in question.answers):
        return Plan(question, None, None, why_not="what is another in each run is told by more sessions")
    bench = _Bench(report, question)
    low, high = report.temperature_range_degc
    slowest_s = max((time for answer in question.answers for time in answer.times_s), default=0.0)
    tried = profiles(low, high, report.fastest_degc_per_min, slowest_s, most_s, ACCEL in inputs)
    best: tuple[float, Profile] | None = None
    for at, profile in enumerate(tried):
        if best is not None and at >= EVERY_SHAPE and best[0] * most_s < best[1].duration_s:
            break  # evidence grows no faster than time
        if progress is not None:
            progress(f"{question.name}: {profile.duration_s / 3600:.1f} h, {profile.title}")
        ratio = bench.tried(profile, range(TRIALS)).ratio
        if best is None or ratio > best[0]:
            best = ratio, profile
        if ratio < MARGIN:
            continue
        # What was chosen for its evidence has had luck as well: others have to show it again.
        expected = bench.tried(profile, range(TRIALS, TRIALS + PROOFS))
        reached = bench.reached(profile, expected, TRIALS + PROOFS)
        if min(expected.value, reached) >= expected.needed:
            return Plan(question, profile, expected, reached)
    return Plan(question, None, None, why_not=bench.why_not(best[1]) if best else "no profile is so short")


class _Bench:
    """Simulated units with each of the answers."""

    def __init__(self, report: Report, question: Open) -> None:
        self._report, self._question = report, question
        effects = {effect.name for answer in question.answers for effect in answer.effects}
        self._kinds = [name for name in EFFECTS if name in effects]

    def tried(self, profile: Profile, seeds: Sequence[int]) -> Evidence:
        """Return the mean evidence for the pair of answers that is told apart worst."""
        found: dict[tuple[str, str], list[tuple[float, float]]] = {}
        for truth in self._question.answers:
            rivals = [one.name for one in self._question.answers if one is not truth] or [DRIVEN]
            if truth.name == NOTHING and rivals != [DRIVEN]:
                continue
            for seed in seeds:
                searched = self._search(profile, truth, seed, self._kinds)
                for rival in rivals:
                    pair = found.setdefault((truth.name, rival), [])
                    pair.append(told(searched, truth.name, rival))
        each = [
            Evidence(float(np.mean(values, axis=0)[0]), float(np.mean(values, axis=0)[1]), truth, rival)
            for (truth, rival), values in found.items()
        ]
        return min(each, key=lambda one: one.ratio)

    def reached(self, profile: Profile, expected: Evidence, seed: int) -> float:
        """Return the evidence on another unit for the same pair, with all effects in question."""
        truth = next(answer for answer in self._question.answers if answer.name == expected.truth)
        kinds = effects_for(self._question.channel)
        return told(self._search(profile, truth, seed, kinds), expected.truth, expected.rival)[0]

    def why_not(self, profile: Profile) -> str:
        """Say by how little the answers differ with the best profile that there is."""
        worst = self.tried(profile, range(TRIALS))
        truth = next(answer for answer in self._question.answers if answer.name == worst.truth)
        searched = self._search(profile, truth, 0, self._kinds)
        said = " and ".join(
            f"{_left(searched, worst, name):.2f} floors with {name}" for name in (worst.truth, worst.rival)
        )
        return (
            f"nothing that was tried tells; the best, {profile.duration_s / 3600:.1f} h"
            f" {profile.title}, gives {worst.value:.0f} of the {worst.needed:.0f} in BIC that are needed for"
            f" {worst.truth} against {worst.rival}: a unit that has {worst.truth} leaves {said}"
        )

    def scenario(self, profile: Profile, answer: Model) -> Scenario:
        """Return an experiment on a unit that has one of the answers."""
        return scenario(self._report, self._question.channel, profile, answer)

    def _search(self, profile: Profile, truth: Model, seed: int, kinds: Sequence[str]) -> Search:
        run = recorded(self.scenario(profile, truth), seed)
        return _searched(run, self._question.channel, len(truth.declared) - 1, kinds)


def told(searched: Search, truth: str, rival: str) -> tuple[float, float]:
    """Return by how much the gain of one effect exceeds another's, or nothing's, and what is needed of it."""
    if rival == DRIVEN:
        return searched.noise_gain(), PROVEN
    for finding in searched.findings:
        if finding.name in (truth, rival):
            gains = finding.rivals
            break
    else:
        gains = {} if searched.last is None else {k: v.gain for k, v in searched.last.leaders.items()}
    own = gains.get(truth, 0.0)
    if rival == NOTHING:
        return own, PROVEN
    return own - max(gains.get(rival, 0.0), 0.0), max(CLOSE, CLOSE_SHARE * max(gains.values(), default=0.0))


def _left(searched: Search, pair: Evidence, name: str) -> float:
    """Return how many floors are left with one effect of a pair beside whatever else was found."""
    leaders = {} if searched.first is None else searched.first.leaders
    model = [one for one in searched.found if one.family not in (pair.truth, pair.rival)]
    model += [leaders[name].scored.candidate] if name in leaders else []
    channel = searched.channel
    return residual_rms(channel.design(model), channel.values) / channel.floor.sd


def scenario(report: Report, channel: str, profile: Profile, answer: Model) -> Scenario:
    """Return a scenario of an experiment on a unit whose one channel has an answer's curve and effects."""
    low, high = report.temperature_range_degc
    sensor, axis = channel.split("_")
    # What an accelerometer has in its constant is gravity.
    constant = answer.declared[0] if sensor == "gyro" else 0.0
    curve = np.array([constant, *answer.declared[1:]]) / _UNITS[sensor]["bias"]
    line = {
        "kind": "polynomial",
        "coefficients": curve.tolist(),
        "at_degc": 0.5 * (low + high),
        "width_degc": max(0.5 * (high - low), 1e-3),
    }
    effects = [
        effect.with_coefficients(np.array(effect.coefficients) / _UNITS[sensor]["effect"]).model_dump()
        for effect in answer.effects
    ]
    unit = {
        f"{sensor}_noise": _noise(report.channels[channel], sensor),
        "gyro_bias_deg_per_s" if sensor == "gyro" else "accel_bias_mg": {axis: [line]},
        "gyro_effects_deg_per_h" if sensor == "gyro" else "accel_effects_ug": {axis: effects},
    }
    return Scenario(
        format="imumon-scenario/1",
        title=f"{profile.title}; {channel} has {answer.name}",
        unit=Unit.model_validate(unit),
        rate_hz=RATE_HZ,
        duration_s=profile.duration_s,
        latitude_deg=LATITUDE_DEG,
        chamber=profile.chamber,
        motion=list(profile.turns),
    )


_UNITS = {
    "gyro": {"bias": np.pi / 180.0, "effect": DEG_PER_H},
    "accel": {"bias": 1e3 * MICRO_G, "effect": MICRO_G},
}
"""SI units in those of a unit file."""


def _noise(channel: _Channel, sensor: str) -> dict[str, Any]:
    """Return white noise, flicker and walk of a channel, for all three axes, as a unit file has them."""
    slow = channel.slow_noise
    density = channel.noise_floor_rms * float(np.sqrt(BLOCK_S))
    each, walk = slow.flicker_rms / float(np.sqrt(len(TAUS_S))), slow.random_walk_per_sqrt_s
    if sensor == "gyro":
        return {
            "arw_deg_per_sqrt_h": np.degrees(density) * 60.0,
            "flicker": [{"sd_deg_per_h": each / DEG_PER_H, "tau_s": tau} for tau in TAUS_S.tolist()],
            "random_walk_deg_per_h_per_sqrt_s": walk / DEG_PER_H,
        }
    flicker = [{"sd_ug": each / MICRO_G, "tau_s": tau} for tau in TAUS_S.tolist()]
    slowest = {"sd_ug": walk * float(np.sqrt(0.5 * LONG_S)) / MICRO_G, "tau_s": LONG_S}
    return {"vrw_m_per_s_per_sqrt_s": density, "flicker": [*flicker, slowest]}


def recorded(plan: Scenario, seed: int) -> Run:
    """Return what a diagnosis reads of a simulated session."""
    unit = SimulatedUnit(plan, seed)
    sent, truth = unit.run(plan.samples)
    return collect([SampleBlock({**sent.columns, "at_rest": truth["at_rest"]})], plan.title)[0]


def _searched(run: Run, channel: str, degree: int, kinds: Sequence[str]) -> Search:
    """Return the search in one channel of a run, the earth rate and gravity taken care of."""
    sensor, temperature = channel[:-2], "temperature"
    group, magnetic = [f"{sensor}_{axis}" for axis in "xyz"], [f"mag_{axis}" for axis in "xyz"]
    blocks = [make_blocks(run, group, [temperature], magnetic)]
    search_s = search_block(blocks)
    parts = [make_blocks(run, group, [temperature], magnetic, search_s)]
    seen = survey(parts, temperature, degree, search_s)
    declared = Declared.over(
        blocks, temperature, degree if seen.thermal else 0, "pose" if sensor == "accel" else ""
    )
    if sensor == "accel":
        parts = at_poses(parts)
    elif turned(blocks) and (earth := earth_rate(blocks, group, dict.fromkeys(group, temperature), declared)):
        parts = without(parts, group, earth)
    floor = white_floor([run], channel, search_s).of_blocks(parts)
    one = Channel(channel, unit_of(channel), floor, declared, Pool(parts, temperature), [])
    return search([one], seen, kinds)[0]


def write_plan(report: Report, number: int, made: Plan, folder: Path) -> list[Path]:
    """Write an experiment: the chamber's course, and a scenario of it for each answer.

    Raises OSError when a file cannot be written.
    """
    if made.profile is None:
        return []
    rows = ["time_s,temperature_degc", *(f"{t:.0f},{c:.2f}" for t, c in _course(made.profile))]
    course = folder / f"{number}-chamber.csv"
    write_text(course, "\n".join(rows) + "\n")
    written = [course]
    for answer in made.question.answers:
        content = scenario(report, made.question.channel, made.profile, answer)
        name = "".join(letter if letter.isalnum() else "-" for letter in answer.name).strip("-")
        path = folder / f"{number}-{name}.yaml"
        data = content.model_dump(mode="json", exclude_unset=True)
        write_text(path, yaml.safe_dump(data, sort_keys=False, allow_unicode=True))
        written.append(path)
    return written


def _course(profile: Profile) -> list[tuple[float, float]]:
    """Return the corners of a profile, s and °C, to its end."""
    times, degrees = (values.tolist() for values in chamber_knots(profile.chamber))
    if times[-1] < profile.duration_s:
        times, degrees = [*times, profile.duration_s], [*degrees, degrees[-1]]
    return list(zip(times, degrees, strict=True))
