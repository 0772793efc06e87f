"""A replay beside the live run: column by column, whichever stages ran in either."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from imumon.blocks import ColumnArray, SampleBlock
from imumon.columns import Column
from imumon.pipeline import Digest, Estimator
from imumon.protocols.device import device_text, load_device
from imumon.recordings.folder import Session, open_session
from imumon.recordings.source import open_source, run_over
from imumon.run.live import LiveRun
from imumon.run.replay import Comparison, compare_with_live, digested
from imumon.run.setup import Setup
from imumon.run.stages import pipeline_of
from imumon.simulation.virtual_device import VirtualDevice
from imumon.transport.settings import PortSettings
from tests.cli.command import imumon
from tests.waiting import wait_until


class Times:
    """A stage of another package: a multiple of a column."""

    def __init__(self, name: str, factor: float, until: int = 10**9) -> None:
        self.columns = (Column(name, "rad/s"),)
        self._name, self._factor, self._left = name, factor, until

    def process(self, block: SampleBlock) -> dict[str, ColumnArray]:
        self._left -= len(block)
        if self._left < 0:
            raise ZeroDivisionError("of mine")
        return {self._name: self._factor * block["gyro_x"]}

    def notices(self) -> list[str]:
        return []


def recorded(folder: Path, stages: Sequence[Estimator]) -> Session:
    with VirtualDevice(load_device("ax1"), folder / "ahrs") as device:
        settings, text = PortSettings(device.port.path), device_text("ax1")[0]
        run = LiveRun(load_device("ax1"), text, settings, Setup(), folder / "s", lambda *_: None, stages)
        run.open()
        run.begin([])
        assert wait_until(lambda: run.pipeline.counters.samples > 100, 15.0)
        run.stop()
    return open_session(folder / "s")


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Session:
    """A recording during which a stage of another package ran."""
    return recorded(tmp_path_factory.mktemp("live"), [Times("doubled", 2.0)])


def compared(session: Session, stages: Sequence[Estimator], **changes: Any) -> Comparison:
    """Replay a session and compare it as if its metadata had these changes."""
    source = open_source(session.path)
    pipeline, digest = pipeline_of(source, Setup(), stages), Digest()
    for _ in digested(run_over(source.items, pipeline), pipeline, digest):
        pass
    metadata = session.metadata.model_copy(update=changes)
    return compare_with_live(replace(session, metadata=metadata), Setup(), digest, pipeline)


def test_the_same_stages_give_the_same_columns(session: Session) -> None:
    same = compared(session, [Times("doubled", 2.0)])
    assert same.identical is True
    assert (same.differing, same.only_live, same.only_replay) == ((), (), ())
    assert same.compared == len(session.metadata.column_crc32) > 30
    assert str(same) == "bit for bit those of the live run"


def test_a_stage_more_or_less_does_not_count_and_is_named(session: Session) -> None:
    less = compared(session, [])
    assert (less.identical, less.only_live, less.only_replay) == (True, ("doubled",), ())
    other = compared(session, [Times("tripled", 3.0)])
    assert (other.identical, other.only_live, other.only_replay) == (True, ("doubled",), ("tripled",))
    assert str(other).endswith("compared); only in the live run: doubled; only in the replay: tripled")


def test_a_stage_that_gives_other_numbers_counts_and_is_named(session: Session) -> None:
    other = compared(session, [Times("doubled", 2.5)])
    assert (other.identical, other.differing) == (False, ("doubled",))
    assert str(other) == "NOT those of the live run: doubled; another version, or bytes missing"


def test_a_column_of_a_side_stream_that_is_lost_counts(session: Session) -> None:
    more = session.metadata.column_crc32 | {"gnss/latitude": 5}
    lost = compared(session, [], column_crc32=more)
    assert (lost.identical, lost.differing, lost.only_live) == (False, ("gnss/latitude",), ("doubled",))


def test_a_recording_without_any_of_its_samples_is_not_that_of_the_live_run(session: Session) -> None:
    assert compared(session, [], column_crc32={"other": 5}).identical is False


def test_a_stage_that_was_switched_off_is_not_compared(tmp_path: Path) -> None:
    session = recorded(tmp_path, [Times("doubled", 2.0, until=40), Times("tripled", 3.0)])
    assert not session.metadata.column_crc32.keys() & {"doubled", "tripled"}
    assert compared(session, [Times("doubled", 2.0, until=40), Times("tripled", 3.0)]).identical is True
    mended = compared(session, [Times("doubled", 2.0)])
    assert (mended.identical, mended.only_replay) == (True, ("doubled",))


def test_one_digest_of_all_columns_is_the_same_or_is_absent(session: Session) -> None:
    old: dict[str, Any] = {"column_crc32": {}}
    assert compared(session, [Times("doubled", 2.0)], **old).identical is True
    more = compared(session, [Times("doubled", 2.0), Times("tripled", 3.0)], **old)
    assert more.identical is None
    assert "one digest of all columns" in str(more)


def test_a_late_column_is_the_same_as_one_that_was_missing() -> None:
    late, whole = Digest(), Digest()
    x = np.array([np.nan, np.nan, 1.0])
    late.update(SampleBlock({"a": x[:2]}), {"gnss": SampleBlock({"a": x})})
    late.update(SampleBlock({"a": x[2:], "b": x[2:]}))
    whole.update(SampleBlock({"a": x, "b": x}), {"gnss": SampleBlock({"a": x})})
    assert late.columns() == whole.columns()
    assert late.columns().keys() == {"a", "b", "gnss/a"}
    assert late.columns(without=["a"]).keys() == {"b", "gnss/a"}


def test_replay_states_what_differs_and_exits_with_1(session: Session, tmp_path: Path) -> None:
    (tmp_path / "s").mkdir()
    for name in ("session.yaml", "wire.mcap"):
        (tmp_path / "s" / name).write_bytes((session.path / name).read_bytes())
    assert imumon("replay", tmp_path / "s").returncode == 0
    text = (tmp_path / "s" / "session.yaml").read_text()
    crc = session.metadata.column_crc32["gyro_y"]
    (tmp_path / "s" / "session.yaml").write_text(text.replace(f"gyro_y: {crc}", f"gyro_y: {crc ^ 1}"))
    done = imumon("replay", tmp_path / "s")
    assert done.returncode == 1
    assert "NOT those of the live run: gyro_y; only in the live run: doubled" in done.stderr
