from __future__ import annotations

import errno
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from imumon.errors import ImumonError, Reason
from imumon.recordings import folder
from imumon.recordings.folder import (
    PortUsed,
    SessionMetadata,
    create_session,
    default_path,
    is_session,
    open_session,
    sessions_in,
)

NOW = 1_767_268_805_000_000_007
DEVICE = "format: imumon-device/1\nname: test # µ\n\n  indented: 'x'\n"


def metadata() -> SessionMetadata:
    return SessionMetadata.begun(
        "live",
        NOW,
        device="test",
        axes="FRD",
        device_yaml=DEVICE,
        port=PortUsed(url="/dev/ttyUSB0", settings={"baudrate": 115200, "parity": "N"}),
        counters={"bytes": 7},
    )


def test_a_session_is_opened_as_it_was_made(tmp_path: Path) -> None:
    session = create_session(tmp_path / "a" / "s", metadata())
    session.wire_path.touch()
    opened = open_session(tmp_path / "a" / "s")
    assert opened.metadata == metadata()
    assert opened.state == "interrupted"
    assert DEVICE.splitlines()[1] in (opened.path / "session.yaml").read_text()


def test_a_session_that_was_closed_states_when_and_with_what(tmp_path: Path) -> None:
    session = create_session(tmp_path / "s", metadata())
    session.wire_path.touch()
    session.save(metadata().closed(NOW + 10**9, counters={"bytes": 9}, events=2, results_digest="ab"))
    opened = open_session(tmp_path / "s" / "session.yaml")
    assert opened.state == "closed"
    assert opened.metadata.ended == "2026-01-01T12:00:06.000000007Z"
    assert opened.metadata.counters == {"bytes": 9}
    assert {entry.name for entry in opened.path.iterdir()} == {"session.yaml", "wire.mcap"}


def test_a_folder_that_holds_a_session_is_not_used_again(tmp_path: Path) -> None:
    create_session(tmp_path / "s", metadata())
    with pytest.raises(ImumonError, match=r"holds a session already \(session.yaml\)") as caught:
        create_session(tmp_path / "s", metadata())
    assert caught.value.reason is Reason.EXISTS


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    (tmp_path / "s").touch()
    with pytest.raises(ImumonError, match="is a file") as caught:
        create_session(tmp_path / "s", metadata())
    assert caught.value.reason is Reason.EXISTS
    with pytest.raises(ImumonError) as caught:
        create_session(tmp_path / "s" / "t", metadata())
    assert caught.value.reason is Reason.BAD_CONFIG


def test_a_path_that_is_no_session_is_refused_with_what_is_there(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "raw.bin").write_bytes(b"12345")
    for name, seen in {
        "none": "no such file or folder",
        "empty": "the folder has no session.yaml",
        "raw.bin": "it is a file",
    }.items():
        assert not is_session(tmp_path / name)
        with pytest.raises(ImumonError, match=seen) as caught:
            open_session(tmp_path / name)
        assert caught.value.reason is Reason.BAD_DATA


def test_a_session_without_its_data_is_refused(tmp_path: Path) -> None:
    create_session(tmp_path / "s", metadata())
    with pytest.raises(ImumonError, match=r"there is no file wire\.mcap"):
        open_session(tmp_path / "s")


@pytest.mark.parametrize("make", [Path.mkdir, os.mkfifo, lambda path: path.symlink_to("gone")])
def test_what_is_no_file_is_no_data(make: Callable[[Path], object], tmp_path: Path) -> None:
    make(create_session(tmp_path / "s", metadata()).wire_path)
    with pytest.raises(ImumonError, match=r"is missing: there is no file wire\.mcap"):
        open_session(tmp_path / "s")


def test_a_session_of_a_folder_that_cannot_be_opened_is_reported(tmp_path: Path) -> None:
    for name in ("good", "broken", "bare"):
        create_session(tmp_path / name, metadata()).wire_path.touch()
    (tmp_path / "broken" / "session.yaml").write_text("{")
    (tmp_path / "bare" / "session.yaml").unlink()
    (tmp_path / "notes").mkdir()
    (tmp_path / "model.yaml").touch()
    told: list[str] = []
    assert [session.path.name for session in sessions_in(tmp_path, told.append)] == ["good"]
    assert [text.partition(":")[0] for text in told] == ["bare is left out", "broken is left out"]


def test_a_session_itself_is_no_folder_of_sessions(tmp_path: Path) -> None:
    """It was returned once for each of its files."""
    create_session(tmp_path / "s", metadata()).wire_path.touch()
    assert sessions_in(tmp_path / "s", print) == sessions_in(tmp_path / "none", print) == []


def test_metadata_of_another_format_is_refused_with_file_and_line(tmp_path: Path) -> None:
    session = create_session(tmp_path / "s", metadata())
    session.wire_path.touch()
    path = session.path / "session.yaml"
    path.write_text(path.read_text().replace("imumon-session/1", "imumon-session/9"))
    with pytest.raises(ImumonError, match=r"session\.yaml:1: format.*imumon-session/9") as caught:
        open_session(tmp_path / "s")
    assert caught.value.reason is Reason.BAD_DATA


def test_the_default_folder_never_names_one_that_exists(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path = default_path("mti", NOW)
    assert path == Path("sessions/20260101T120005Z-mti")
    path.mkdir(parents=True)
    assert default_path("mti", NOW) == Path("sessions/20260101T120005Z-mti-2")


def test_a_session_that_cannot_be_written_leaves_nothing_behind(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(folder, "write_text", full)
    with pytest.raises(ImumonError, match="No space left"):
        create_session(tmp_path / "s", metadata())
    assert list(tmp_path.iterdir()) == []


def test_of_two_that_make_the_same_session_at_once_one_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    create_session(tmp_path / "s", metadata())
    before = (tmp_path / "s" / "session.yaml").read_bytes()
    refuse, asked = folder.refuse_existing, []

    def too_early(path: Path) -> None:
        asked.append(path)
        if len(asked) > 1:
            refuse(path)

    monkeypatch.setattr(folder, "refuse_existing", too_early)
    with pytest.raises(ImumonError) as caught:
        create_session(tmp_path / "s", metadata())
    assert caught.value.reason is Reason.EXISTS
    assert (tmp_path / "s" / "session.yaml").read_bytes() == before
