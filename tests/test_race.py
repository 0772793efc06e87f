"""The race against other programs goes to its end on small data, with what is installed here and without."""

from __future__ import annotations

import pytest
from benchmarks import race
from study import Table


def column(table: Table, heading: str) -> list[str]:
    at = table.heads.index(heading)
    assert all(len(row) == len(table.heads) for row in table.rows)
    return [str(row[at]) for row in table.rows]


def test_decoders_agree_with_every_package_that_is_installed() -> None:
    table = race.decoders(packets=50, rounds=1)
    installed = [peer for peer in race.PEERS if race.named(peer.package)]
    differences = [float(text) for text in column(table, "difference") if text != "-"]
    assert "pymavlink" in [peer.package for peer in installed]
    assert len(differences) == len(installed)
    assert max(differences) < 1e-6
    assert len(table.rows) == len(race.PEERS)


def test_a_package_that_gives_fewer_values_is_not_called_equal() -> None:
    import numpy as np

    true = np.array([1.0, np.nan, 2.0])
    assert race.difference([1.0], 1.0, true) == "1 of 2"
    assert race.difference([1.0, 2.5], 1.0, true) == "2e-01"


def test_a_package_that_is_missing_has_a_row_that_reports_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(race, "named", lambda _: None)
    assert set(column(race.decoders(50, 1), "the other, µs")) == {"not installed"}


def test_the_better_one_is_named() -> None:
    assert race.faster(2.0, 1.0) == "imumon 2 ×"
    assert race.faster(1.0, 3.0) == "**the other 3 ×**"
