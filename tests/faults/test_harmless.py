from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.blocks import SampleBlock
from imumon.harmless import LONGEST_LINE, for_csv, for_log, for_markdown, for_plot, for_terminal
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.page import write_page
from imumon.pipeline import Pipeline
from imumon.recordings.folder import SessionMetadata, create_session
from imumon.recordings.wire import WireWriter
from imumon.run.narration import Narrator
from imumon.transport.reader import Bytes, Event, EventKind
from imumon.view.items import Log, Status, Timebase, ViewItem
from imumon.view.logger import status_card
from tests.cli.command import imumon
from tests.faults.documents import device_with
from tests.lab.diagnosis.units import three

CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202e]")
EVIL = "\x1b]0;owned\x07\x1b[2J\u202e\x9b31m"


@given(st.text())
def test_no_text_controls_a_terminal_or_forges_a_line(text: str) -> None:
    assert not CONTROL.search(for_terminal(text))
    assert "\n" not in for_log(text)
    assert len(for_log(text * 100)) < LONGEST_LINE + 40
    for_terminal(text).encode()


@given(st.text(alphabet=st.characters(exclude_categories=["C"])))
def test_what_is_harmless_stays_as_it_is_on_a_terminal(text: str) -> None:
    assert for_terminal(text).replace("\\u2028", "\u2028").replace("\\u2029", "\u2029") == text


@given(st.text())
def test_no_cell_is_a_formula_and_each_is_one_cell(text: str) -> None:
    import csv

    [[cell]] = csv.reader([for_csv(text or "x")], strict=True) if "\n" not in text else [["x"]]
    assert not cell.startswith(("=", "+", "-", "@", "\t", "\r"))


@given(st.text())
def test_no_text_is_markdown(text: str) -> None:
    assert not re.search(r"(?<!\\)[<>|`*\[\]#]", for_markdown(text).replace("\\\\", ""))


def test_labels_of_a_plot_are_no_formulas() -> None:
    from matplotlib.figure import Figure

    for text in ("$\\frac{$", "_hidden", "a$b", "\x1b[31m", "$$"):
        figure = Figure()
        figure.suptitle(for_plot(text))
        figure.canvas.draw()


@pytest.fixture
def session(tmp_path: Path) -> Path:
    """A session whose device, port and events say what controls a terminal."""
    title = device_with("title: ", f'title: "evil {EVIL.encode("unicode_escape").decode()}" # ')
    made = create_session(
        tmp_path / f"s{EVIL}[bold]",
        SessionMetadata.begun("live", 1, device="ax1", device_yaml=title),
    )
    writer = WireWriter(made.wire_path, {})
    writer.write(Event(EventKind.OPENED, 2, f"open {EVIL}\nERROR forged"))
    writer.write(Bytes(b"\x1b]0;x\x07" * 10, 3))
    writer.close()
    return made.path


@pytest.mark.parametrize("command", ["replay", "export", "decode", "recover"])
def test_commands_write_no_control_characters(session: Path, command: str) -> None:
    given: dict[str, list[object]] = {"export": ["--to", "csv"], "decode": ["--out", session / "t.csv"]}
    done = imumon(command, session, *given.get(command, []))
    assert done.stderr
    assert not CONTROL.search(done.stderr + done.stdout)


def test_an_error_shows_the_name_of_a_file_harmlessly(tmp_path: Path) -> None:
    done = imumon("replay", tmp_path / EVIL)
    assert done.returncode == 4
    assert "\\x1b]0;owned" in done.stderr
    assert not CONTROL.search(done.stderr)


def test_log_lines_of_the_view_are_one_line_each() -> None:
    lines: list[str] = []
    items: list[ViewItem] = []
    narrator = Narrator(Pipeline(None), None, [items.append], lambda _, text: lines.append(text), {})
    narrator.item(Event(EventKind.OPENED, 1, f"{EVIL}\nERROR forged"))
    [log] = [item for item in items if isinstance(item, Log)]
    assert log.text == lines[0]
    assert not CONTROL.search(log.text)
    assert "\n" not in log.text


def test_the_status_card_keeps_its_cells() -> None:
    card = status_card(Status(Timebase().at(), {"device": "a | b\n| **x** | <img src=x onerror=alert(1)>"}))
    assert len(card.splitlines()) == 3
    assert "\\<img" in card
    assert r"a \| b" in card


def test_the_report_escapes_the_names_of_recordings(tmp_path: Path) -> None:
    train, test = three(lambda time, _: 0.0 * time, 3000)
    name = "<script>alert(1)</script>$\\bad$\x1b[2J"
    diagnosis = diagnose([replace(run, name=name) for run in train], test)
    write_page(diagnosis, tmp_path / "report.html")
    page = (tmp_path / "report.html").read_text()
    assert "<script>alert" not in page
    assert "&lt;script&gt;alert(1)" in page
    assert not CONTROL.search(page)


def test_the_names_of_columns_are_no_formulas(tmp_path: Path) -> None:
    import numpy as np

    from imumon.columns import Column
    from imumon.recordings.table import TableWriter

    name = "=HYPERLINK(evil,1)"
    path = tmp_path / "t.csv"
    with TableWriter(path, {name: Column(name, "1"), "b": Column("b", "1")}) as table:
        table.write(SampleBlock({name: np.array([1.0]), "b": np.array([2.0])}))
    assert path.read_text().splitlines() == ['"\'=HYPERLINK(evil,1)",b', "1.0,2.0"]
