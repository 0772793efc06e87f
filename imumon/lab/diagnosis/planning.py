"""The next experiment: the shortest that answers what a diagnosis leaves open, tried on the fitted unit.

For each question every answer is simulated, with the noise that was found, and searched as a recording is.
The evidence is the difference of the gains, in BIC, between the effect that the unit has and each rival.
"""

import math
import time
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import yaml
from pydantic import Field

from imumon.config import StrictModel
from imumon.effects.base import ACCEL as ACCEL_DRIVER
from imumon.effects.base import LEAST_SPAN_DEGC, Positive
from imumon.effects.library import EFFECTS, AnyEffect, effects_for
from imumon.files import write_text
from imumon.geodesy import DEG_PER_H, MICRO_G
from imumon.models.model import UNITS
from imumon.simulation.unit import Scenario, SimulatedUnit
from imumon.simulation.unit.motion import Turn
from imumon.simulation.unit.scenario import Chamber, Step, Unit
from imumon.simulation.unit.thermal import chamber_knots

from .blocks import BLOCK_S, make_blocks, survey
from .diagnose import Prepared, likeliest, search_block_s, search_sensor
from .likelihood import TAUS_S
from .report import NOTHING
from .runs import Names, Run, collect
from .search import NEAR_GAIN, NEAR_SHARE, PROVEN_GAIN, AxisSearch, Progress

MARGIN = 1.4  # the evidence that is planned for over what is needed: what is reached scatters (assumed)
# Units on which a profile is tried, and others on which the evidence of the chosen one is stated.  Assumed.
TRIALS, PROOFS = 2, 3
# By this computer's clock: no further profile is tried for a question; the last takes half a minute more.
TIME_UP_S = 150.0
LONG_S = 1e5  # correlation time of a process that stands for a random walk of an accelerometer
# Units of a bias and of an effect in a unit file, in SI: °/s and °/h, mg and µg.
IN_SI = {"gyro": (np.pi / 180.0, DEG_PER_H), "accel": (1e3 * MICRO_G, MICRO_G)}
# Of what is tried: least length, soaks at both ends, repetitions, and times at one temperature.  Assumed.
SHORTEST_S = 1800.0
SOAKS_S = (300.0, 1800.0)
LONGEST_SOAK_S = 3600.0  # where effects are slow
REPEATS = (1, 2, 4, 8)
HELD_S = (3600.0, 7200.0, 14400.0, 28800.0)
# Turns from level to each side, upside down, and to both ends.
POSES = (*({"roll_deg": 90.0},) * 3, {"roll_deg": 90.0, "pitch_deg": 90.0}, {"pitch_deg": -180.0})


class Profile(NamedTuple):
    """One experiment; those of one `shape` differ in how often that is repeated."""

    shape: str
    chamber: Chamber
    duration_s: float
    times: int = 1
    in_poses: bool = False

    @property
    def title(self) -> str:
        """The experiment in words."""
        repeated = f", {self.times} times" if self.times > 1 else ""
        return f"{self.shape}{repeated}{', in six poses' if self.in_poses else ''}"


def profiles(low: float, high: float, rate: float, tau_s: float, most_s: float, poses: bool) -> list[Profile]:
    """Return the experiments that last at most `most_s`, the shortest first.

    The unit was trained from `low` to `high`, °C, and reached the rate `rate`, °C/min; `tau_s` is the
    longest time constant of the effects in question (0 without one); with `poses` it has to be turned.
    """
    middle = 0.5 * (low + high)
    held = f"switched on in equilibrium at {middle:.0f} °C and held"
    every = [Profile(held, Chamber(start_degc=middle, steps=[Step(hold_s=s)]), s, 1, poses) for s in HELD_S]
    # In five time constants a lag has decayed, or a warm-up.
    soaks = sorted({*SOAKS_S, min(max(5.0 * tau_s, SOAKS_S[0]), LONGEST_SOAK_S)})
    shapes: dict[str, list[Step]] = {}
    if high - low >= LEAST_SPAN_DEGC and rate > 0.0:
        for soak_s in soaks:
            shapes |= _thermal(low, high, rate, soak_s)
    for title, steps in shapes.items():
        for times in REPEATS:
            chamber = Chamber(start_degc=low, steps=steps * times)
            duration_s = max(float(chamber_knots(chamber)[0][-1]), SHORTEST_S)
            every.append(Profile(f"from {low:.0f} °C {title}", chamber, duration_s, times, poses))
    return sorted((one for one in every if one.duration_s <= most_s), key=lambda profile: profile.duration_s)


def _thermal(low: float, high: float, rate: float, soak_s: float) -> dict[str, list[Step]]:
    """Return courses of temperature from the low end, by what is done."""

    def to(target: float, how_fast: float = rate, soak: float = soak_s) -> Step:
        return Step(to_degc=target, rate_degc_per_min=how_fast, hold_s=soak)

    quarter, slow = 0.25 * (high - low), rate / 4.0  # between rates so far apart a lag shows well
    soaks = f"soaks of {soak_s / 60:.0f} min"
    fast, slowly = [to(high), to(low)], [to(high, slow), to(low, slow)]
    stairs = [to(low + n * quarter) for n in (1, 2, 3, 4, 3, 2, 1, 0)]
    return {
        f"warmed and cooled at {rate:.2g} °C/min with {soaks}": fast,
        f"warmed and cooled at {rate:.2g} and {slow:.2g} °C/min with {soaks}": [*fast, *slowly],
        f"in stairs of a quarter of the span with {soaks}": stairs,
        "turned round inside the span": [to(low + n * quarter, soak=0.0) for n in (4, 2, 4, 0, 2, 0)],
    }


class Answer(StrictModel, extra="ignore"):
    """An answer: its name, whether it carries over, the declared polynomial of u, and effects."""

    name: str
    carries: bool
    declared: list[float]
    effects: list[AnyEffect]


class _Channel(StrictModel, extra="ignore"):
    noise_floor_rms: Positive
    slow_noise: dict[str, float]
    before: dict[str, float | None]
    questions: list[list[Answer]]


class Report(StrictModel, extra="ignore"):
    """What is needed of a report.json."""

    format: Literal["imumon-diagnosis/1"]
    block_s: float = BLOCK_S
    temperature_range_degc: Annotated[list[float], Field(min_length=2, max_length=2)]
    fastest_degc_per_min: float
    channels: dict[str, _Channel]


class Question(NamedTuple):
    """A question, and the channel of those that have it in which the residual is the largest."""

    channel: str
    also: tuple[str, ...]
    answers: tuple[Answer, ...]

    @property
    def name(self) -> str:
        """The question in words: which of its answers."""
        return " or ".join(answer.name for answer in self.answers)


class Evidence(NamedTuple):
    """What a profile shows of the pair of answers that it separates worst, in BIC."""

    profile: Profile
    value: float  # mean difference of their gains over simulated units
    least: float  # least difference
    needed: float  # difference that is needed to separate them
    truth: str  # the answer that the units have
    rival: str

    @property
    def ratio(self) -> float:
        """The evidence over what is needed."""
        return self.value / self.needed


class Plan(NamedTuple):
    """The evidence to expect of the next experiment for a question; `why_not` is why there is none."""

    question: Question
    expected: Evidence | None = None
    why_not: str = ""


def open_questions(report: Report) -> list[Question]:
    """Return the questions of a report, each once for the channels of a sensor that share it."""
    # A unit is simulated, which has gyros and accelerometers.
    channels = {name: channel for name, channel in report.channels.items() if name in UNITS}
    floors = {name: (one.before["train_rms"] or 0.0) / one.noise_floor_rms for name, one in channels.items()}
    groups: dict[tuple[str, ...], list[Question]] = {}
    for name in sorted(channels, key=lambda name: -floors[name]):
        for answers in channels[name].questions:
            key = (name[:-2], *sorted(answer.name for answer in answers))
            groups.setdefault(key, []).append(Question(name, (), tuple(answers)))
    return [first._replace(also=tuple(one.channel for one in others)) for first, *others in groups.values()]


def plan(report: Report, question: Question, most_s: float, progress: Progress = lambda _: None) -> Plan:
    """Return the shortest experiment that answers a question, with the evidence to expect of it."""
    # A shape is repeated only where that can decide, as evidence grows no faster than time.
    effects = [effect for answer in question.answers for effect in answer.effects]
    inputs = {name for effect in effects for name in effect.inputs}
    if why_not := _impossible(question, inputs - {ACCEL_DRIVER}):
        return Plan(question, why_not=why_not)
    # The trials search among these alone, which takes less time; the proof among all, as `diagnose` does.
    kinds = [name for name in EFFECTS if any(effect.name == name for effect in effects)]
    times = [getattr(effect, key) for effect in effects for key in effect.nonlinear if key.endswith("_s")]
    tau_s = max(times, default=0.0)
    low, high = report.temperature_range_degc
    tried: dict[str, Evidence] = {}
    began_s, late = time.monotonic(), ""
    for profile in profiles(low, high, report.fastest_degc_per_min, tau_s, most_s, ACCEL_DRIVER in inputs):
        if profile.times > 1:
            once = tried[profile.shape]
            # Even if its evidence grew with the time, it would stay below what is needed.
            if once.ratio * profile.duration_s < once.profile.duration_s:
                continue
        if tried and time.monotonic() - began_s > TIME_UP_S:
            late = f"; after {TIME_UP_S:.0f} s no further one was tried"
            break
        progress(f"{question.name}: {profile.duration_s / 3600:.1f} h, {profile.title}")
        shown = evidence(report, question, profile, range(TRIALS), kinds)
        tried[profile.shape] = shown
        if shown.ratio >= MARGIN:
            # What was chosen for its evidence has had luck as well: other units have to show it again.
            others = range(TRIALS, TRIALS + PROOFS)
            proof = evidence(report, question, profile, others, effects_for(question.channel))
            if proof.least >= proof.needed:
                return Plan(question, proof)
    if not tried:
        return Plan(question, why_not="no profile is so short")
    best = max(tried.values(), key=lambda shown: shown.ratio)
    why_not = (
        f"no experiment that was tried decides it; the best, {best.profile.duration_s / 3600:.1f} h"
        f" {best.profile.title}, gives {best.value:.0f} of the {best.needed:.0f} in BIC that are needed"
        f" for {best.truth} against {best.rival}{late}"
    )
    return Plan(question, why_not=why_not)


def _impossible(question: Question, others: set[str]) -> str:
    """Return why no experiment answers a question; `others` are the drivers that no chamber has."""
    if others:
        return f"{', '.join(sorted(others))} must vary apart from the rest: no chamber does that"
    if not all(answer.carries for answer in question.answers):
        return "an effect that differs between runs needs more sessions"
    if len(question.answers) < 2:
        return "no effect makes these recordings likelier: record at constant temperature"
    return ""


def simulated_run(experiment: Scenario, seed: int) -> Run:
    """Return what a diagnosis reads of a simulated session."""
    sent, truth = SimulatedUnit(experiment, seed).run(experiment.samples)
    return collect([sent.with_columns({"at_rest": truth["at_rest"]})], experiment.title)[0]


def evidence(report: Report, question: Question, profile: Profile, seeds: range, kinds: Names) -> Evidence:
    """Return what the search finds on simulated units with each of the answers, among these kinds."""
    pairs = []
    for truth in question.answers:
        if truth.name == NOTHING:
            continue  # that nothing is there shows in that an effect would show
        experiment = scenario(report, question.channel, profile, truth)
        searches = list[AxisSearch]()
        for seed in seeds:  # as `diagnose` does, for as many effects as the unit has
            in_blocks = make_blocks(simulated_run(experiment, seed), [question.channel], ["temperature"])
            degree = len(truth.declared) - 1 if survey([in_blocks], ["temperature"], 0).thermal else 0
            shorter = in_blocks.in_blocks_of(search_block_s([in_blocks]))
            data = Prepared([shorter], {question.channel: "temperature"}, degree)
            searches += likeliest(search_sensor(data, [question.channel], kinds, max(1, len(truth.effects))))
        for rival in question.answers:
            if rival is not truth:
                of_units = [_difference(searched, truth.name, rival.name) for searched in searches]
                value, needed = np.mean(of_units, axis=0).tolist()
                least, _ = min(of_units)
                pairs.append(Evidence(profile, value, least, needed, truth.name, rival.name))
    return min(pairs, key=lambda shown: shown.ratio)


def _difference(searched: AxisSearch, truth: str, rival: str) -> tuple[float, float]:
    """Return by how much the gain of one effect exceeds another's, or nothing's, and what is needed of it."""
    stages = [finding.family_gains for finding in searched.findings if finding.name in (truth, rival)]
    stages += [{name: scored.gain for name, scored in table.items()} for table in searched.tables[-1:]]
    gains = stages[0] if stages else {}
    of_truth, of_rival = gains.get(truth, 0.0), max(gains.get(rival, 0.0), 0.0)
    if rival == NOTHING:
        return of_truth, PROVEN_GAIN
    return of_truth - of_rival, max(NEAR_GAIN, NEAR_SHARE * max(gains.values(), default=0.0))


def scenario(report: Report, channel: str, profile: Profile, answer: Answer) -> Scenario:
    """Return a scenario of an experiment on a unit whose one channel has an answer's curve and effects."""
    low, high = report.temperature_range_degc
    sensor, axis = channel.split("_")
    of_bias, of_effect = IN_SI[sensor]
    # What an accelerometer has in its constant is gravity.
    constant = answer.declared[0] if sensor == "gyro" else 0.0
    curve = {
        "kind": "polynomial",
        "coefficients": (np.array([constant, *answer.declared[1:]]) / of_bias).tolist(),
        "at_degc": 0.5 * (low + high),
        "width_degc": max(0.5 * (high - low), 1e-3),
    }
    effects = [
        effect.with_coefficients(np.array(effect.coefficients) / of_effect).model_dump()
        for effect in answer.effects
    ]
    pose_s = profile.duration_s / (len(POSES) + 1)
    turns = [Turn(kind="turn", at_s=n * pose_s, duration_s=10.0, **pose) for n, pose in enumerate(POSES, 1)]
    unit = {
        f"{sensor}_noise": _noise(report, channel),
        "gyro_bias_deg_per_s" if sensor == "gyro" else "accel_bias_mg": {axis: [curve]},
        "gyro_effects_deg_per_h" if sensor == "gyro" else "accel_effects_ug": {axis: effects},
    }
    return Scenario(
        format="imumon-scenario/1",
        title=f"{profile.title}; {channel} has {answer.name}",
        unit=Unit.model_validate(unit),
        rate_hz=4.0,  # enough for the scatter inside a second to give the white noise
        duration_s=profile.duration_s,
        latitude_deg=45.0,  # assumed
        chamber=profile.chamber,
        motion=[*turns] if profile.in_poses else [],
    )


def _noise(report: Report, name: str) -> dict[str, Any]:
    """Return white noise, flicker and walk of a channel, for all three axes, as a unit file has them."""
    channel = report.channels[name]
    density = channel.noise_floor_rms * math.sqrt(report.block_s)
    each = channel.slow_noise.get("flicker_rms", 0.0) / math.sqrt(len(TAUS_S))  # all have the same variance
    walk = channel.slow_noise.get("random_walk_per_sqrt_s", 0.0)
    if name.startswith("gyro"):
        return {
            "arw_deg_per_sqrt_h": np.degrees(density) * 60.0,
            "flicker": [{"sd_deg_per_h": each / DEG_PER_H, "tau_s": tau} for tau in TAUS_S.tolist()],
            "random_walk_deg_per_h_per_sqrt_s": walk / DEG_PER_H,
        }
    flicker = [{"sd_ug": each / MICRO_G, "tau_s": tau} for tau in TAUS_S.tolist()]
    # Of the same growth at first: a Gauss-Markov process has the variance q tau / 2.
    slowest = {"sd_ug": walk * math.sqrt(0.5 * LONG_S) / MICRO_G, "tau_s": LONG_S}
    return {"vrw_m_per_s_per_sqrt_s": density, "flicker": [*flicker, slowest]}


def write_plan(report: Report, number: int, planned: Plan, folder: Path) -> list[Path]:
    """Write the chamber's course, and a scenario for each answer; raises OSError when that fails."""
    if not planned.expected:
        return []
    profile = planned.expected.profile
    times, degrees = (values.tolist() for values in chamber_knots(profile.chamber))
    if times[-1] < profile.duration_s:
        times, degrees = [*times, profile.duration_s], [*degrees, degrees[-1]]
    rows = [f"{t:.0f},{degc:.2f}\n" for t, degc in zip(times, degrees, strict=True)]
    files = {f"{number}-chamber.csv": "".join(["time_s,temperature_degc\n", *rows])}
    for answer in planned.question.answers:
        name = "".join(letter if letter.isalnum() else "-" for letter in answer.name).strip("-")
        data = scenario(report, planned.question.channel, profile, answer).model_dump(
            mode="json", exclude_unset=True
        )
        files[f"{number}-{name}.yaml"] = yaml.safe_dump(data, sort_keys=False, allow_unicode=True)
    for name, text in files.items():
        write_text(folder / name, text)
    return [folder / name for name in files]
