"""Tables and labelled lines on a terminal of 80 columns: folded between words, none torn."""

from __future__ import annotations

import pytest

from imumon.cli.common import labelled
from imumon.fleet.catalog_command import HEADS, _show
from imumon.transport.detect import Evidence

WIDTH = 80
UNIT = [
    "0380123-of-a-long-name", "xsens-mti", "128", "1024.25", "2026-01-01", "2026-11-28", "-20.5 to 48.1",
    "0.021 to 3.51", "12", "gyro_x +0.35 ± 0.02", "3",
]  # fmt: skip


@pytest.fixture(autouse=True)
def narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", str(WIDTH))


def test_labelled_lines_fold_between_words() -> None:
    rows = {"failed": "1,203 bad data, 17 timeout, " * 6, "table": "out/rows/" + "x" * 100 + "/*.parquet"}
    lines = labelled(rows, WIDTH)
    assert [line for line in lines if len(line) > WIDTH] == [f"  table   {rows['table']}"]
    assert " ".join(" ".join(lines).split()) == " ".join(
        f"failed {rows['failed']} table {rows['table']}".split()
    )
    assert len(labelled(rows)) == 2


def test_the_catalog_fits_a_narrow_terminal_and_tears_no_word(capsys: pytest.CaptureFixture[str]) -> None:
    _show([UNIT])
    text = capsys.readouterr().out
    assert [line for line in text.splitlines() if len(line) > WIDTH] == []
    assert all(word in text for word in (*HEADS, *UNIT))


def test_the_evidence_of_detect_fits_a_narrow_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    from imumon.cli.computer_commands import _show as show_evidence

    unread = Evidence("inertialsense", 3000000, 1.5, 400000, 399000, 0, 12345, 12345, 0, 0, 0.1, 0.2)
    show_evidence([unread])
    text = capsys.readouterr().out
    assert [line for line in text.splitlines() if len(line) > WIDTH] == []
    words = text.split()
    assert {"inertialsense", "3000000", "12345", *unread.verdict.value.split()} <= set(words)
