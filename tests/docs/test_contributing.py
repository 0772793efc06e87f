"""The examples of CONTRIBUTING.md are an effect, a stage and a command that work."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from click.testing import CliRunner

from imumon.effects.base import Drive, Memory
from imumon.stage import check_stage
from tests.view.streams import block

PAGE = Path(__file__).resolve().parents[2] / "CONTRIBUTING.md"


def examples() -> dict[str, Any]:
    """Return the names that the blocks of Python make."""
    names: dict[str, Any] = {}
    for program in re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL):
        exec(compile(program, PAGE.name, "exec", dont_inherit=True), names)
    return names


def test_the_examples_work() -> None:
    made = examples()
    effect, stage = made["SlowSettling"](), made["RateMagnitude"]()
    drive = Drive(np.array([0.0, 3600.0, 14400.0]), np.zeros(3))
    assert effect.advance(Memory(), drive).ravel().tolist() == [0.0, 1.0, 2.0]
    check_stage(stage)
    samples = block(0, 5)
    assert samples.gyro is not None
    np.testing.assert_allclose(stage.process(samples)["rate_magnitude"] ** 2, (samples.gyro**2).sum(axis=1))
    assert CliRunner().invoke(made["command"]).output == "hello\n"
