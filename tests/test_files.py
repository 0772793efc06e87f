"""Outputs: whole or not at all, under the name that was given, and never in the place of a recording."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import pytest

from imumon.errors import ImumonError, Reason
from imumon.files import SESSION_FILES, TRUTH, check_output, write_text
from imumon.recordings import folder
from imumon.recordings.lines import LOG_NAME
from imumon.simulation import recording


@pytest.mark.parametrize("there", TRUTH)
@pytest.mark.parametrize("name", SESSION_FILES)
def test_no_output_takes_the_place_of_a_file_of_a_session(tmp_path: Path, there: str, name: str) -> None:
    (tmp_path / there).touch()
    (tmp_path / "link").symlink_to(tmp_path / name)
    (tmp_path / "other").mkdir()
    if name not in TRUTH:  # what a session lacks of the others may be made
        check_output(tmp_path / name, replace=True)
        (tmp_path / name).touch()
    for path in (tmp_path / name, tmp_path / "link", tmp_path / "other" / ".." / name):
        with pytest.raises(ImumonError, match=f"whose {name} no output may be") as caught:
            check_output(path, replace=True)
        assert caught.value.reason is Reason.EXISTS
    check_output(tmp_path / "export.parquet", replace=True)
    check_output(tmp_path / "other" / name)


def test_what_imumon_keeps_in_a_session_is_known_to_be_kept() -> None:
    names = {folder.METADATA_NAME, folder.WIRE_NAME, folder.SAMPLES_NAME, folder.VIEW_NAME, LOG_NAME}
    made = {folder.TRUTH_NAME, recording.SCENARIO_NAME, recording.CHAMBER_NAME}
    assert names | made == set(SESSION_FILES)


def test_what_is_no_file_is_no_output(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    for path in (tmp_path, tmp_path / "pipe", Path("-"), Path("/dev/null")):
        with pytest.raises(ImumonError, match="the output is") as caught:
            check_output(path, replace=True)
        assert caught.value.reason is Reason.BAD_CONFIG
    with pytest.raises(OSError, match="circle"):
        write_text(tmp_path / "circle" / "t", "new")


def test_a_disk_that_fails_leaves_the_old_file_and_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(_: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    (tmp_path / "page.html").write_text("old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OSError, match="No space left on device") as caught:
        write_text(tmp_path / "page.html", "new")
    assert caught.value.filename == str(tmp_path / "page.html")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]
    assert (tmp_path / "page.html").read_text() == "old"


def test_a_link_stays_and_what_it_leads_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "kept").mkdir()
    (tmp_path / "kept" / "model.yaml").write_text("old")
    (tmp_path / "model.yaml").symlink_to("kept/model.yaml")
    write_text(tmp_path / "model.yaml", "new")
    assert (tmp_path / "model.yaml").is_symlink()
    assert (tmp_path / "kept" / "model.yaml").read_text() == "new"
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["model.yaml"]
