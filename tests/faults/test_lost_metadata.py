"""A recording whose session.yaml is lost: nothing but wire.mcap is left of what was recorded."""

from __future__ import annotations

import json
import shutil
from contextlib import closing
from pathlib import Path

import pytest
from mcap.writer import Writer

from imumon.errors import ImumonError, Reason
from imumon.recordings.folder import SessionMetadata, begun_of, lost_metadata, open_session
from imumon.recordings.source import open_source
from imumon.recordings.wire import WireWriter
from imumon.recordings.wire_reader import WireReader
from tests.cli.command import answer, imumon

PIPELINE = "format: imumon-pipeline/1\nlatitude_deg: 48.0\n"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole") / "s"
    done = imumon("simulate", "bench", "--out", folder, "--duration", 5, "--serial", "SN1")
    assert done.returncode == 0, done.stderr
    return folder


def damaged(whole: Path, to: Path, content: str | None) -> Path:
    """Return a copy whose session.yaml holds something else, or is gone."""
    shutil.copytree(whole, to)
    if content is None:
        (to / "session.yaml").unlink()
    else:
        (to / "session.yaml").write_text(content)
    return to


@pytest.fixture
def old(whole: Path, tmp_path: Path) -> Path:
    """As versions recorded whose wire file did not hold the session.yaml of its start."""
    folder = damaged(whole, tmp_path / "old", None)
    items = list(WireReader(folder / "wire.mcap"))
    (folder / "wire.mcap").unlink()
    said = {"device": "ax1", "port": "/dev/ttyUSB0 at 921600 8N1"}
    with closing(WireWriter(folder / "wire.mcap", said)) as writer:
        for item in items:
            writer.write(item)
    return folder


@pytest.mark.parametrize("content", [None, "", "{", "format: imumon-session/1\nsource: \0"])
def test_session_yaml_is_made_anew_from_the_wire_file(
    whole: Path, tmp_path: Path, content: str | None
) -> None:
    folder = damaged(whole, tmp_path / "s", content)
    for command in (["replay", folder], ["export", folder, "--to", "csv"], ["allan", folder / "wire.mcap"]):
        done = imumon(*command)
        assert done.returncode == 4
        assert f"imumon recover {folder} makes session.yaml anew" in done.stderr
    told = answer("recover", folder)
    assert any("not known" in text for text in told["warnings"])
    originals = [] if content is None else [str(folder / "session.yaml.original")]
    assert told["originals"] == originals
    if content is not None:
        assert (folder / "session.yaml.original").read_text() == content
    before, after = open_session(whole).metadata, open_session(folder).metadata
    kept = ("source", "created_ns", "device", "axes", "device_yaml", "pipeline_yaml", "port", "versions")
    assert {name: getattr(after, name) for name in kept} == {name: getattr(before, name) for name in kept}
    assert after.state == "closed"
    assert after.counters["samples"] == before.counters["samples"]
    assert "nothing was written" in imumon("recover", folder).stderr
    assert answer("replay", folder)["packets"] == answer("replay", whole)["packets"]


def test_a_wire_file_is_read_as_one_wherever_it_is(whole: Path, tmp_path: Path) -> None:
    shutil.copy(whole / "wire.mcap", tmp_path / "alone.bin")
    with (tmp_path / "alone.bin").open("r+b") as file:
        file.write(b"\0")  # of the eight bytes that tell MCAP
    imumon("decode", whole, "--out", tmp_path / "a.csv")
    for given in ([], ["--device", "ax1"]):
        told = answer("decode", tmp_path / "alone.bin", "--out", tmp_path / "b.csv", *given)
        assert told["bytes_skipped"] == 0
        assert told["recording"]["damage"]["places"] == 1
        assert (tmp_path / "b.csv").read_bytes() == (tmp_path / "a.csv").read_bytes()
    assert open_source(whole / "wire.mcap").session is not None
    assert "is a recording of imumon" in imumon("import", whole / "wire.mcap", "--out", tmp_path / "i").stderr


def test_a_bag_is_not_decoded_as_bytes(tmp_path: Path) -> None:
    with (tmp_path / "bag").open("wb") as file:
        bag = Writer(file)
        bag.start("ros2")
        bag.finish()  # type: ignore[no-untyped-call]  # the library does not say
    done = imumon("decode", tmp_path / "bag", "--device", "ax1", "--out", tmp_path / "b.csv")
    assert done.returncode == 4
    assert "of profile 'ros2'" in done.stderr


def test_the_device_is_searched_for_where_nothing_holds_it(old: Path) -> None:
    for command, what in (
        (["recover", old], "does not hold the session.yaml of its start"),
        (["decode", old / "wire.mcap", "--out", old / "a.csv"], "does not hold its device file"),
    ):
        done = imumon(*command)
        assert done.returncode == 2
        assert what in done.stderr
        assert "--device" in done.stderr
    assert not (old / "session.yaml").exists()
    told = answer("recover", old, "--device", "ax1")
    assert any("only the device is known" in text for text in told["warnings"])
    metadata = open_session(old).metadata
    first = next(iter(WireReader(old / "wire.mcap").batches()))
    assert metadata.created_ns == getattr(first, "time_ns", None)
    assert metadata.device == "ax1"
    assert "knows its device" in imumon("recover", old, "--device", "ax1").stderr


def test_a_session_of_another_version_is_left_alone(whole: Path, tmp_path: Path) -> None:
    text = (whole / "session.yaml").read_text().replace("imumon-session/1", "imumon-session/2")
    folder = damaged(whole, tmp_path / "s", text)
    assert lost_metadata(folder) is None
    done = imumon("recover", folder)
    assert done.returncode == 4
    assert "imumon-session/2" in done.stderr
    assert (folder / "session.yaml").read_text() == text


def test_the_catalog_states_what_it_left_out(whole: Path, tmp_path: Path) -> None:
    shutil.copytree(whole, tmp_path / "good")
    for name, content in (("gone", None), ("empty", "")):
        damaged(whole, tmp_path / name, content)
    done = imumon("catalog", tmp_path, "--json")
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert [Path(row["session"]).name for row in told["sessions"]] == ["good"]
    assert [Path(row["session"]).name for row in told["left_out"]] == ["empty", "gone"]
    for row in told["left_out"]:
        assert f"imumon recover {row['session']} makes" in row["error"]
        assert f"{row['session']} is left out" in done.stderr
        assert imumon("recover", row["session"]).returncode == 0
    again = answer("catalog", tmp_path)
    assert not again["left_out"]
    assert [row["error"] for row in again["sessions"]] == [None] * 3


def test_the_wire_file_holds_the_session_yaml_of_its_start() -> None:
    begun = SessionMetadata.begun("live", 1, device="ax1", device_yaml="a: 1\n", pipeline_yaml=PIPELINE)
    large = begun.model_copy(update={"pipeline_yaml": PIPELINE + "# " + "x" * (1 << 19)})
    assert (begun_of(begun.for_wire()), begun_of(large.for_wire())) == (begun, large)
    assert begun_of({"device": "ax1"}) is None


def test_a_folder_of_samples_alone_states_how_to_read_them(tmp_path: Path) -> None:
    (tmp_path / "samples.parquet").touch()
    with pytest.raises(ImumonError, match=r"as a table: .*samples\.parquet") as caught:
        open_session(tmp_path)
    assert caught.value.reason is Reason.BAD_DATA
