from __future__ import annotations

import math

from imumon.blocks import SampleBlock
from imumon.cli.align_command import DONE, instruction
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.report import Estimate, Status
from imumon.estimation.alignment.stage import Alignment
from tests.estimation.alignment.units import samples, scenario


def _guided(block: SampleBlock, positions: int, patient: bool = False) -> list[str]:
    stage, said = Alignment(AlignmentParameters(settled_deg=0.2), 36.0), [""]
    for start in range(0, len(block), 50):
        stage.process(block.rows(start, start + 50))
        text = instruction(stage.status, positions, said[-1], patient)
        said += [text] if text != said[-1] else []
        if text == DONE:
            break
    return said[1:]


def test_a_person_is_led_through_two_positions() -> None:
    turn = {"kind": "turn", "at_s": 50.0, "duration_s": 4.0, "heading_deg": 170.0}
    said = _guided(samples(scenario(150.0, rate_hz=100.0, motion=[turn])), 2)
    assert said[0] == "position 1 of 2: do not touch the unit"
    assert said[1] == "turn the unit now by about 180° about the vertical"
    assert said[-1] == DONE


def test_how_far_the_unit_has_turned_is_reported_during_the_turn() -> None:
    turn = {"kind": "turn", "at_s": 20.0, "duration_s": 8.0, "heading_deg": 170.0}
    stage = Alignment(AlignmentParameters(), 36.0)
    stage.process(samples(scenario(40.0, rate_hz=100.0, motion=[turn])).rows(0, 2400))
    assert stage.status.to_go_text == "disturbed, turned by 75°"


def test_one_position_needs_no_words_and_ends_when_settled() -> None:
    assert _guided(samples(scenario(60.0, rate_hz=100.0)), 1) == [DONE]


def test_a_unit_that_is_not_turned_is_waited_for() -> None:
    said = _guided(samples(scenario(90.0, rate_hz=100.0)), 2)
    assert said[-1].startswith("turn the unit now")


def test_a_sigma_that_the_accelerometers_keep_up_is_not_waited_for() -> None:
    plan = scenario(150.0, rate_hz=100.0, latitude=65.0)
    stage = Alignment(AlignmentParameters(settled_deg=0.05, accel_bias_sd_ug=750.0), 65.0)
    stage.process(samples(plan))
    assert stage.status.estimates
    assert stage.status.observable
    assert math.isinf(stage.status.remaining_s)
    assert instruction(stage.status, 1, "", patient=False) == DONE


def test_a_sway_that_hides_north_at_first_is_waited_for_if_a_time_is_given() -> None:
    hidden = {"joint": Estimate(math.nan, 0.5)}
    status = Status(math.radians(0.05), 300.0, False, rest_s=300.0, estimates=hidden, positions=1)
    assert instruction(status, 1, "", patient=False) == DONE
    assert instruction(status, 1, "", patient=True) == ""
    assert instruction(status._replace(settled_s=790.0), 1, "", patient=True) == DONE


def test_the_last_position_is_held_until_it_has_separated_the_bias() -> None:
    wanted = math.radians(0.2)
    hidden = {"joint": Estimate(math.nan, 1.0)}
    arrived = Status(wanted, 310.0, False, rest_s=302.0, estimates=hidden, positions=2, position_s=2.0)
    settled = arrived._replace(estimates={"joint": Estimate(1.0, 1e-3)}, settled_s=50.0, remaining_s=0.0)
    noisy = arrived._replace(rest_s=315.0, position_s=15.0, position_sd=2.0 * wanted)
    for status in (arrived, settled, noisy):
        assert instruction(status, 2, "", patient=False) != DONE
    held = noisy._replace(position_s=80.0, position_sd=0.9 * wanted)
    assert instruction(held, 2, "", patient=False) == DONE
