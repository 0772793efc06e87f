"""The race against other programs goes to its end on small data, with what is installed here and without."""

from __future__ import annotations

import pytest
from benchmarks import peers, race_allan, race_bias, race_decoders, race_files
from benchmarks.measure import Table
from bias_race_table import ATHERMAL

SHORT = {"rate_hz": 20.0, "duration_s": 380.0}
"""Three rests and one that counts."""


def column(table: Table, heading: str) -> list[str]:
    at = table.headings.index(heading)
    assert all(len(row) == len(table.headings) for row in table.rows)
    return [row[at] for row in table.rows]


def test_decoders_agree_with_every_package_that_is_installed() -> None:
    table = race_decoders.table(packets=50, rounds=1)
    installed = [peer for peer in race_decoders.PEERS if peers.named(peer.package)]
    differences = [float(text) for text in column(table, "difference") if text != "-"]
    assert "pymavlink" in [peer.package for peer in installed]
    assert len(differences) == len(installed)
    assert max(differences) < 1e-6
    assert len(table.rows) == len(race_decoders.PEERS)


def test_a_package_that_gives_fewer_values_is_not_called_equal() -> None:
    import numpy as np

    true = np.array([1.0, np.nan, 2.0])
    assert race_decoders.difference([1.0], 1.0, true) == "1 of 2"
    assert race_decoders.difference([1.0, 2.5], 1.0, true) == "2e-01"


def test_a_package_that_is_missing_has_a_row_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (race_decoders, race_allan, race_files):
        monkeypatch.setattr(module, "named", lambda _: None)
    assert set(column(race_decoders.table(50, 1), "the other, µs")) == {"not installed"}
    assert column(race_allan.table(2000, 1), "deviation") == ["not installed"]
    assert column(race_files.table(1.0, race_files.READERS[-1:]), "rows") == ["not installed"]


def test_allan_deviations_are_those_of_allantools() -> None:
    table = race_allan.table(samples=4000, rounds=1)
    assert len(table.rows) == len(race_allan.OTHERS) + 1
    assert max(float(text) for text in column(table, "largest difference") if text) < 1e-9


def test_bias_of_all_on_the_same_record() -> None:
    table = race_bias.table((ATHERMAL,), seeds=1, tune=False, changes=SHORT)
    errors = [float(text) for text in column(table, "no thermal effect, °/h")]
    assert len(errors) == 5
    assert 0.0 < min(errors) < 50.0


def test_the_better_one_is_named() -> None:
    assert peers.faster(2.0, 1.0) == "imumon 2 ×"
    assert peers.faster(1.0, 3.0) == "**the other 3 ×**"
    assert race_bias.better([1.0, 4.0], [2.0, 2.0]) == "**the other in 1 of 2, by up to 2.00 ×**"
    assert race_bias.better([3.0, 4.0], [2.0, 2.0]) == "imumon, by 1.50 to 2.00 ×"


def test_files_hold_the_same_numbers_for_others() -> None:
    readers = [reader for reader in race_files.READERS if reader.file in ("npz", "wire.mcap")]
    table = race_files.table(1.0, readers)
    assert column(table, "opened") == ["yes", "yes"]
    assert column(table, "rows") == ["100", "100"]


def test_a_file_that_another_cannot_open_is_counted() -> None:
    def broken(_: object) -> object:
        raise ValueError("what is this?")

    readers = [race_files.Reader("numpy", "npz", broken)]
    table = race_files.table(1.0, readers)
    assert column(table, "opened") == ["**no**"]
    assert table.notes[0].startswith("**0 of 1 opened")
