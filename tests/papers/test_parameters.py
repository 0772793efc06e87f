"""What a pipeline file may say of the random error."""

from __future__ import annotations

import pytest

from imumon.config import parse_yaml
from imumon.errors import ImumonError
from imumon.run.setup import RandomErrorParameters


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("method: ukf", "method"),
        ("noise: {gyro_x: {angle_random_walk: 1e-4}}", "leave the axis out"),
        ("noise: {gyro_w: {angle_random_walk: 1e-4, rate_random_walk: 1e-6}}", "gyro_w"),
        ("learn_s: 1.0", "learn_s"),
        ("q: 1", "unknown key"),
    ],
)
def test_wrong_parameters_are_refused(text: str, said: str) -> None:
    with pytest.raises(ImumonError, match=said):
        parse_yaml(text, RandomErrorParameters, "pipeline.yaml")
