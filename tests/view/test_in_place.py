"""An arrangement that changes while somebody looks on: what was chosen stays."""

from __future__ import annotations

import time
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader
from rerun.experimental import ViewerClient
from support.screenshots import studio

from imumon.view import in_place
from imumon.view.blueprint import arranged
from imumon.view.in_place import InPlace
from imumon.view.rrd import LIVE_APPLICATION, messages
from tests.waiting import LIMIT_S


def tabs(names: Sequence[str]) -> rrb.Blueprint:
    """Return an arrangement with a tab for each name, two texts in each."""
    parts = [
        rrb.Horizontal(*(rrb.TextDocumentView(origin=f"/{name}", name=side) for side in "ab"), name=name)
        for name in names
    ]
    return arranged(rrb.Tabs(*parts), "host_time")


def parts_of(path: Path) -> list[tuple[str, str, int]]:
    """Return application, entity and time of each part of the one blueprint in a file, by time."""
    reader = RrdReader(str(path))
    (store,) = reader.blueprints()
    found = []
    for chunk in reader.stream(store=store):
        batch = chunk.to_record_batch()
        at = batch.column("blueprint")[0].as_py() if "blueprint" in batch.schema.names else 0
        found.append((store.application_id, chunk.entity_path, at))
    return sorted(found, key=lambda part: part[2])


def sent(path: Path, *arrangements: Sequence[str], forget: bool = False) -> list[tuple[str, str, int]]:
    rec = rr.RecordingStream(LIVE_APPLICATION, recording_id="test")
    rec.set_sinks(rr.FileSink(path))
    place = InPlace(rec)
    for names in arrangements:
        place.send(tabs(names))
        if forget:
            place.forget()
    rec.disconnect()
    return parts_of(path)


def test_only_what_has_changed_is_sent_and_what_is_inside_comes_first(tmp_path: Path) -> None:
    once, twice = sent(tmp_path / "a.rrd", "xy"), sent(tmp_path / "b.rrd", "xy", "xy")
    assert {application for application, _, _ in once} == {LIVE_APPLICATION}
    assert [entity for _, entity, _ in twice[len(once) :]] == ["/viewport"], "a viewer may have changed it"
    added = sent(tmp_path / "c.rrd", "xy", "xyz")[len(once) :]
    kinds = [entity.strip("/").split("/")[0] for _, entity, _ in added]
    assert kinds == ["view"] * 4 + ["container"] * 2 + ["viewport"], "two views, their tab, the tabs"
    assert min(at for _, _, at in added) > max(at for _, _, at in once)


def test_a_new_reader_gets_everything(tmp_path: Path) -> None:
    once = sent(tmp_path / "a.rrd", "xy")
    assert len(sent(tmp_path / "b.rrd", "xy", "xy", forget=True)) == 2 * len(once)


def test_an_arrangement_of_many_units_is_handed_over_in_pieces(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    sizes, hand_over = [], rr.RecordingStream.log_file_from_contents

    def count_and_hand_over(rec: rr.RecordingStream, name: str, contents: bytes) -> None:
        sizes.append(sum(1 for _ in messages(BytesIO(contents))))
        hand_over(rec, name, contents)

    monkeypatch.setattr(rr.RecordingStream, "log_file_from_contents", count_and_hand_over)
    in_one = sent(tmp_path / "a.rrd", "abcdef")
    whole = sizes.pop()
    monkeypatch.setattr(in_place, "ROOM", 7)
    in_pieces = sent(tmp_path / "b.rrd", "abcdef")
    assert whole == len(in_one) > 20
    assert max(sizes) == 7, "Rerun never ends with more than it has room for"
    assert sum(sizes) == whole
    assert [entity for _, entity, _ in in_pieces] == [entity for _, entity, _ in in_one]


def looked_at(viewer: ViewerClient) -> tuple[dict[str, Any], dict[str, Any], list[str], str]:
    """Return the blueprint that is shown, its tabs, their names, and the name of the one that is seen."""
    shown: dict[str, Any] = viewer.get_blueprint().blueprint
    containers = {path.strip("/"): part.get("ContainerBlueprint", {}) for path, part in shown.items()}
    (root,) = (part for part in containers.values() if part.get("container_kind") == "Tabs")
    names = {path: part.get("display_name", "") for path, part in containers.items()}
    seen = root.get("active_tab", "").strip("/")
    return shown, root, [names[path.strip("/")] for path in root["contents"]], names.get(seen, "")


def wait_for(viewer: ViewerClient, names: Sequence[str]) -> str:
    """Wait until the viewer has these tabs; return which is seen."""
    deadline, found = time.monotonic() + LIMIT_S, list[str]()
    while time.monotonic() < deadline:
        try:
            _, _, found, seen = looked_at(viewer)
        except (ValueError, KeyError):  # it has not come yet
            found = []
        if found == list(names):
            return seen
        time.sleep(0.2)
    raise AssertionError(f"the viewer has tabs {found}")


@pytest.mark.viewer
@pytest.mark.usefixtures("vulkan")
def test_whoever_looks_at_a_tab_stays_there() -> None:
    with studio() as place:
        rec = rr.RecordingStream(LIVE_APPLICATION, recording_id="test")
        rec.set_sinks(rr.GrpcSink(place.url))
        arrangement = InPlace(rec)
        rec.set_time("host_time", timestamp=1.0)
        for name in "vwxyz":
            rec.log(name, rr.TextDocument(name))
        arrangement.send(tabs("xyz"))
        wait_for(place.viewer, "xyz")
        shown, root, _, _ = looked_at(place.viewer)
        root["active_tab"] = root["contents"][1]
        place.viewer.set_blueprint(shown, of="recording")
        seen = [wait_for(place.viewer, "xyz")]
        for names in ("xyzw", "vyzw", "yz"):
            arrangement.send(tabs(names))
            seen.append(wait_for(place.viewer, names))
        arrangement.send(tabs("zv"))
        wait_for(place.viewer, "zv")
        views = [view.origin for view in place.viewer.get_state().views]
        rec.disconnect()
    assert seen == ["y"] * 4
    assert sorted(set(views)) == ["/v", "/z"]
