"""What training cannot tell from a wander: a loop is proven by a test that it predicts, a jump never is."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.effects.base import Drive
from imumon.effects.since_power_on import Drift, WarmUp
from imumon.effects.thermal_lag import Hysteresis
from imumon.lab.diagnosis.candidates import Candidate, Finding, Part
from imumon.lab.diagnosis.claims import chosen_by_test
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.runs import Run
from tests.lab.diagnosis.units import ramps, run

SECONDS = 5400
LOOP = Hysteresis(half_width=5.0, middle=26.0, half_span=14.0)


def wandering(seed: int, dph_per_sqrt_s: float, loop_dph: float, tails: bool = False) -> Run:
    """Return a run with a loop and a walk; with `tails` a few of the walk's steps are large."""
    random = np.random.default_rng(100 + seed)
    time, temperature = ramps(SECONDS, True, 1.2)
    steps = random.standard_normal(SECONDS) * dph_per_sqrt_s
    if tails:
        steps[random.choice(SECONDS, 12, replace=False)] += random.choice([-12.0, 12.0], 12)
    walk = np.cumsum(steps)
    return run(
        seed, time, temperature, lambda t, u: np.asarray(walk + loop_dph * LOOP.columns(Drive(t, u))[:, 0])
    )


@pytest.mark.parametrize(("loop_dph", "names"), [(70.0, ["hysteresis"]), (0.0, [])])
def test_a_loop_that_training_cannot_prove_is_proven_by_what_it_predicts(
    loop_dph: float, names: list[str]
) -> None:
    diagnosis = diagnose([wandering(11, 0.5, loop_dph)], [wandering(12, 0.1, loop_dph)])
    (verdict,) = diagnosis.verdicts
    assert [claim.finding.name for claim in verdict.claims] == names
    assert verdict.unexplained
    channel = report(diagnosis)["channels"]["gyro_x"]
    assert channel["questions"][-1][0]["name"] == "nothing"
    if names:
        assert verdict.claims[0].finding.by_test
        assert "chosen by the test alone, so this test is no independent proof" in verdict.summary
        (effect,) = channel["effects"]
        assert effect["evidence"]["proven_by"] == "test"


def test_effects_of_several_names_that_explain_the_test_are_not_told_apart() -> None:
    effects = {"drift": Drift(), "warm_up": WarmUp(time_constant_s=200.0)}

    def hit(left: float, name: str) -> tuple[float, Finding]:
        return left, Finding(Candidate((Part(effects[name]),)), 9.0, 9.0, by_test=True)

    best = chosen_by_test([hit(2.0, "drift"), hit(1.0, "warm_up"), hit(1.5, "warm_up")])
    assert best is not None
    assert best.name == "warm_up"
    assert best.names == ["warm_up", "drift"]
    assert list(best.alternatives) == ["drift"]
    best = chosen_by_test([hit(1.0, "warm_up"), hit(1.5, "warm_up")])
    assert best is not None
    assert best.names == ["warm_up"]
    assert chosen_by_test([]) is None
