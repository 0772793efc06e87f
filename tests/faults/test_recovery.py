from __future__ import annotations

import numpy as np
import pytest

from tests.faults.recovery import SOON_S, VARIANTS, attack_all, run

SEVERE = [
    "one sample of 1e30",
    "10 s of NaN, all",
    "first 60 s stuck gyro",
    "first 60 s saturated gyro",
    "time leaps to 2^62 for 5 samples",
    "a new segment every 0.5 s for 10 s",
]
LENGTH_S = 210.0
"""A little more than what is promised after a fault: it ends with the columns that longer ones end with."""


# With a latitude there is every stage, and the one that seeks the heading; without one the earth rate is in
# the bias.
@pytest.mark.long
@pytest.mark.parametrize(("latitude_deg", "names"), [(None, SEVERE[:1] + SEVERE[-1:]), (48.0, SEVERE)])
def test_every_stage_recovers_when_the_data_is_good_again(
    latitude_deg: float | None, names: list[str]
) -> None:
    for name, outcome in attack_all(latitude_deg, names, LENGTH_S):
        assert not outcome.dead, name
        assert not outcome.wild, name
        assert outcome.alive_after_s < SOON_S, name


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "latitude_deg"),
    [*((name, 48.0) for name in sorted(VARIANTS.keys() - {"4 kHz"})), ("0.01 Hz", None), ("no gyro", None)],
)
def test_devices_out_of_the_ordinary_have_columns_without_infinities(
    name: str, latitude_deg: float | None
) -> None:
    block, _ = run(VARIANTS[name].columns(), latitude_deg)
    assert not [k for k, v in block.columns.items() if v.dtype == np.float64 and np.isinf(v).any()]
