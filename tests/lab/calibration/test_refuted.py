"""A session that was left out confirms or refutes the curves of the others."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.errors import ImumonError, Reason
from imumon.lab.calibration.record import Record, record_of
from imumon.lab.calibration.refuted import check_last, followed
from tests.lab.calibration.records import few_steps, record, samples, soak

SHORT_S = 600.0


@pytest.fixture(autouse=True)
def _soon(monkeypatch: pytest.MonkeyPatch) -> None:
    few_steps(monkeypatch)


def soaks(*seeds: int) -> list[Record]:
    return [record(soak(SHORT_S), f"soak-{seed}", seed=seed, offset=1e-5 * seed) for seed in seeds]


def test_a_session_of_the_same_unit_confirms_the_curves() -> None:
    records = soaks(11, 12)
    found = followed(records, None, None)
    assert found.keys() == {"gyro_x", "gyro_y", "gyro_z"}
    assert all(abs(share - 1.0) < 0.1 for share, _ in found.values()), "the turn-on offset is no part of it"
    assert check_last(records, None, None) == []


def test_a_session_of_another_unit_refutes_them() -> None:
    block = samples(soak(SHORT_S), seed=14)
    block.columns["gyro_y"][:] *= -1.0
    with pytest.raises(ImumonError, match=r"the last session refutes .* gyro_y -") as refused:
        check_last([*soaks(13), record_of([block], "other", "0" * 64)], None, None)
    assert refused.value.reason is Reason.BAD_DATA
    assert "gyro_x" not in refused.value.seen


def test_what_cannot_tell_refutes_nothing() -> None:
    one, still = soaks(15)[0], record(np.full(3600, 20.0), "still", seed=16)
    assert check_last([one], None, None) == []
    assert check_last([one, still], None, None) == []
    (said,) = check_last([still, one], None, None)
    assert "is not shown" in said
