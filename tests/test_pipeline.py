from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, ColumnArray, SampleBlock, join, missing
from imumon.charts import RED, Axis, Chart, Curve
from imumon.columns import Column
from imumon.errors import ImumonError
from imumon.pipeline import UNDATED, Digest, Pipeline
from imumon.protocols.device import load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario

AX1 = load_device("ax1")
START = 1_700_000_000_000_000_000


class CountingEstimator:
    """A running sum: any dependence on the division into blocks would show."""

    columns: Sequence[Column] = (Column("turned_x", "rad"),)

    def __init__(self) -> None:
        self.sum = 0.0

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        out = np.empty(len(block))
        for i, rate in enumerate(block["gyro_x"]):
            self.sum += rate * 0.01
            out[i] = self.sum
        return {"turned_x": out}

    def notices(self) -> list[str]:
        return [f"{self.sum:.0f}"]


@cache
def stream(n: int) -> list[tuple[bytes, int]]:
    """Packets of a unit with junk and a reboot, and when each arrives."""
    packets = AX1.encoder().encode(SimulatedUnit(load_scenario("bench")).samples(n))
    packets += AX1.encoder().encode(SimulatedUnit(load_scenario("bench"), 1).samples(n))
    packets[n // 2] = b"junk" + packets[n // 2]
    packets[n // 3] = packets[n // 3][:20]
    return [(packet, START + i * 10_000_000) for i, packet in enumerate(packets)]


def run(pieces: list[tuple[bytes, int]], take_every: int) -> tuple[SampleBlock, Pipeline]:
    pipeline = Pipeline(AX1, [CountingEstimator()])
    blocks = []
    for number, (data, arrival) in enumerate(pieces):
        pipeline.feed(data, arrival)
        if number % take_every == 0:
            blocks.append(pipeline.take())
    pipeline.finish()
    return join([*blocks, pipeline.take()]), pipeline


@pytest.mark.long
@given(cuts=st.lists(st.integers(1, 57), max_size=12), take_every=st.integers(1, 50))
@settings(max_examples=20, deadline=None)
def test_samples_do_not_depend_on_chunks_or_blocks(cuts: list[int], take_every: int) -> None:
    pieces = stream(30)
    whole, reference = run(pieces, 1)
    cut_pieces = []
    for number, (data, arrival) in enumerate(pieces):
        at = cuts[number % len(cuts)] if cuts else 0
        # Both parts keep the arrival of the packet: the time of its last byte counts.
        cut_pieces += [(data[:at], arrival), (data[at:], arrival)]
    pieced, pipeline = run(cut_pieces, take_every)
    assert pipeline.counters == reference.counters
    for name in whole.columns:
        np.testing.assert_array_equal(whole[name], pieced[name], err_msg=name)
    one, many = Digest(), Digest()
    one.update(whole)
    for start in range(0, len(pieced), 7):
        many.update(pieced.rows(start, start + 7))
    assert one.hexdigest() == many.hexdigest()


@pytest.mark.long
@given(together=st.lists(st.integers(1, 40), min_size=1, max_size=6), cut=st.integers(1, 57))
@settings(max_examples=20, deadline=None)
def test_reads_given_together_are_those_given_one_by_one(together: list[int], cut: int) -> None:
    # The last byte of a packet comes alone, or with the next packet: the arrivals differ within a read.
    whole = b"".join(data for data, _ in stream(30))
    reads = [(whole[at : at + cut], START + at) for at in range(0, len(whole), cut)]
    one_by_one, reference = run(reads, 3)
    pipeline, at, turn = Pipeline(AX1, [CountingEstimator()]), 0, 0
    while at < len(reads):
        some = reads[at : at + together[turn % len(together)]]
        ends = np.cumsum([len(data) for data, _ in some])
        data = np.frombuffer(b"".join(data for data, _ in some), np.uint8)
        pipeline.feed_reads(data, ends, np.array([arrival for _, arrival in some]))
        at, turn = at + len(some), turn + 1
    pipeline.finish()
    block = pipeline.take()
    assert pipeline.counters == reference.counters
    for name in one_by_one.columns:
        np.testing.assert_array_equal(block[name], one_by_one[name], err_msg=name)


def test_counters_account_for_every_byte_and_packet() -> None:
    pieces = stream(60)
    block, pipeline = run(pieces, 1)
    counters = pipeline.counters
    assert counters.bytes_received == sum(len(data) for data, _ in pieces)
    assert counters.bytes_received == (
        counters.bytes_in_packets + counters.bytes_skipped + counters.bytes_pending
    )
    assert counters.packets == counters.samples == len(block) == 119
    assert counters.packets_by_type == {"ax1": 119}
    assert counters.bytes_skipped == 4 + 20
    assert (counters.packets_missing, counters.counter_gaps, counters.clock_restarts) == (1, 1, 1)
    assert set(block["segment"]) == {0, 1}


def test_columns_come_in_table_order_with_their_units() -> None:
    block, pipeline = run(stream(6), 1)
    names = [column.name for column in pipeline.columns]
    assert names[:5] == ["device_time_ns", "arrival_time_ns", "host_time_ns", "segment", "packet_counter"]
    assert names[-1] == "turned_x"
    assert "device_ticks" not in names
    assert set(names) == set(block.columns)
    assert {c.name: c.unit for c in pipeline.columns}["mag_x"] == "uT"


def test_host_time_is_never_later_than_the_arrival() -> None:
    block, _ = run(stream(60), 10)
    assert np.all(block["host_time_ns"] <= block["arrival_time_ns"])


def test_a_capture_without_times_has_device_time_only() -> None:
    pipeline = Pipeline(AX1)
    pipeline.feed(b"".join(data for data, _ in stream(20)), UNDATED)
    block = pipeline.take()
    assert np.all(block["arrival_time_ns"] == NO_INT)
    assert np.all(block["host_time_ns"] == NO_INT)
    assert np.all(np.diff(block["device_time_ns"][:6]) == 10_000_000)


def test_samples_of_a_table_go_through_the_estimators() -> None:
    pipeline = Pipeline(None, [CountingEstimator()])
    pipeline.push(SampleBlock({"device_time_ns": np.arange(3), "gyro_x": np.ones(3)}))
    block = pipeline.take()
    np.testing.assert_allclose(block["turned_x"], [0.01, 0.02, 0.03])
    assert pipeline.counters.samples == 3
    with pytest.raises(ValueError, match="takes samples"):
        pipeline.feed(b"x")


def test_the_digest_sees_a_single_bit_and_a_late_column() -> None:
    def digest(*blocks: SampleBlock) -> str:
        result = Digest()
        for block in blocks:
            result.update(block)
        return result.hexdigest()

    x = np.linspace(0.0, 1.0, 5)
    changed = x.copy()
    changed[3] = np.nextafter(changed[3], 2.0)
    assert digest(SampleBlock({"a": x})) != digest(SampleBlock({"a": changed}))
    assert digest(SampleBlock({"a": x})) != digest(SampleBlock({"b": x}))
    late = np.array([np.nan, np.nan, 1.0, 2.0, 3.0])
    assert digest(SampleBlock({"a": x[:2]}), SampleBlock({"a": x[2:], "b": late[2:]})) == digest(
        SampleBlock({"a": x, "b": late})
    )


@pytest.mark.parametrize(
    ("columns", "returned", "said"),
    [
        (["twice"], {"twice": 2}, "twice is float64 of shape (2,), expected float64 of shape (3,)"),
        (["gyro_x"], {"gyro_x": 3}, "it adds gyro_x, which is there already"),
        (["mine"], {"other": 3}, "it returned other and declares mine"),
        (["mine", "absent"], {"mine": 3}, "it returned mine and declares mine, absent"),
    ],
)
def test_a_stage_that_does_not_return_what_it_declares_is_switched_off(
    columns: list[str], returned: dict[str, int], said: str
) -> None:
    pipeline = Pipeline(None, [_Given(columns, returned)])
    block = {"device_time_ns": np.arange(3), "segment": np.zeros(3, np.int64), "gyro_x": np.zeros(3)}
    pipeline.push(SampleBlock(block))
    [warning] = pipeline.warnings()
    assert "stage _Given of tests.test_pipeline is switched off after 0 samples" in warning
    assert f"process: {said}" in warning
    taken = pipeline.take()
    assert not taken["gyro_x"].any()
    assert all(np.isnan(taken[name]).all() for name in columns if name != "gyro_x")


@pytest.mark.parametrize(
    ("dtype", "returned", "said"),
    [
        ("float64", {"mine": [1.0, 2.0, 3.0]}, "mine is a list"),
        (
            "float64",
            {"mine": np.zeros((3, 1))},
            "mine is float64 of shape (3, 1), expected float64 of shape (3,)",
        ),
        ("float64", {"mine": 1.0}, "mine is a float"),
        ("int64", {"mine": np.full(3, 1.5)}, "mine is float64 of shape (3,), expected int64"),
        ("float64", {"mine": np.zeros(3, np.float32)}, "mine is float32 of shape (3,), expected float64"),
        ("float64", {"mine": np.zeros(3, np.int64)}, "mine is int64 of shape (3,), expected float64"),
        ("float64", None, "it returned None"),
    ],
)
def test_what_is_no_column_as_declared_switches_the_stage_off(dtype: Any, returned: Any, said: str) -> None:
    pipeline = Pipeline(None, [_Returned(Column("mine", "1", dtype), returned)])
    pipeline.push(SampleBlock({"gyro_x": np.zeros(3)}))
    [warning] = pipeline.warnings()
    assert f"process: {said}" in warning
    assert pipeline.take()["mine"].tolist() == pytest.approx(missing(3, dtype).tolist(), nan_ok=True)


class _Fails:
    """Adds a column until it has had five samples."""

    columns = (Column("mine", "1"),)

    def __init__(self, call: str = "process") -> None:
        self._call, self._left = call, 5

    def _use(self, call: str) -> None:
        if call == self._call and self._left < 0:
            raise ZeroDivisionError("of mine")

    def process(self, block: SampleBlock) -> dict[str, Any]:
        self._left -= len(block)
        self._use("process")
        return {"mine": np.ones(len(block))}

    def notices(self) -> list[str]:
        self._use("notices")
        return []

    def charts(self) -> list[Chart]:
        self._use("charts")
        return []

    def lanes(self) -> dict[str, str]:
        self._use("lanes")
        return {"mine": "good"}


@pytest.mark.parametrize("call", ["process", "notices", "charts", "lanes"])
def test_a_stage_that_raises_is_switched_off_and_all_else_goes_on(call: str) -> None:
    pipeline, reports = Pipeline(None, [_Fails(call), CountingEstimator()]), list[str]()
    for _ in range(4):
        pipeline.push(SampleBlock({"device_time_ns": np.arange(3), "gyro_x": np.ones(3)}))
        assert pipeline.charts() == []
        reports += pipeline.warnings()
        lanes = pipeline.lanes()
    block = pipeline.take()
    first = 3 if call == "process" else 6
    assert np.isfinite(block["mine"]).tolist() == [True] * first + [False] * (12 - first)
    np.testing.assert_allclose(block["turned_x"], 0.01 * np.arange(1, 13))
    assert lanes == {}
    [report] = [text for text in reports if "_Fails" in text]
    assert f"switched off after {first} samples" in report
    assert f"{call}: ZeroDivisionError: of mine" in report
    assert f"{__file__}:" in report
    assert "in _use, called at" in report
    assert pipeline.irreproducible == {"mine", "turned_x"}


class _Draws(CountingEstimator):
    def __init__(self, curve: Any) -> None:
        super().__init__()
        self._curve = curve

    def charts(self) -> list[Chart]:
        return [Chart("mine", "Mine", "Mine", Axis("x"), Axis("y"), (self._curve,))]


@pytest.mark.parametrize(
    ("curve", "reported"),
    [
        (Curve("a", [1.0], [1.0], RED), "x and y of curve 'a' are no points"),  # type: ignore[arg-type]
        (Curve("a", np.ones(2), np.ones(3), RED), "x and y of curve 'a' are no points"),
        (Curve("a", np.ones((2, 2)), np.ones((2, 2)), RED), "x and y of curve 'a' are no points"),
        ("a", "it returned what is no curve"),
    ],
)
def test_a_chart_that_cannot_be_drawn_switches_its_stage_off(curve: Any, reported: str) -> None:
    pipeline = Pipeline(None, [_Draws(curve)])
    assert pipeline.charts() == []
    [warning] = pipeline.warnings()
    assert "_Draws of tests.test_pipeline is switched off" in warning
    assert f"charts: {reported}" in warning


def test_a_defect_of_imumon_is_raised_but_in_a_live_run(monkeypatch: pytest.MonkeyPatch) -> None:
    def pushed(live: bool) -> Pipeline:
        pipeline = Pipeline(None, [_Fails()])
        if live:
            pipeline.go_live()
        pipeline.push(SampleBlock({"gyro_x": np.ones(6)}))
        return pipeline

    monkeypatch.setattr(_Fails, "__module__", "imumon.estimation")
    for live in (False, True):  # tests see it in a live run as well
        with pytest.raises(ZeroDivisionError):
            pushed(live)
    monkeypatch.delenv("IMUMON_STRICT")
    with pytest.raises(ZeroDivisionError):
        pushed(False)
    [report] = pushed(True).warnings()
    assert "report this defect of imumon" in report


RETURNED = "stage _Returned of tests.test_pipeline"
USUAL = "usual here: V, A, rpm, degC; or 1"


@pytest.mark.parametrize(
    ("column", "said"),
    [
        (Column("mine", "1", "complex128"), f"{RETURNED}: mine has type 'complex128'"),  # type: ignore[arg-type]
        (Column("My column", "1"), f"{RETURNED}: My column is no name of a column"),
        (
            Column("mine", "furlongs/s^"),
            f"{RETURNED}: mine: unit 'furlongs/s^' is not known; {USUAL}",
        ),
        (Column("mine", ""), f"{RETURNED}: mine: unit '' is not known; {USUAL}"),
        ("mine", f"{RETURNED}: 'mine' is no column"),
    ],
)
def test_a_declaration_that_no_table_can_have_is_refused_at_once(column: Any, said: str) -> None:
    with pytest.raises(ImumonError) as caught:
        Pipeline(None, [_Returned(column, {})])
    assert caught.value.seen == said


@pytest.mark.parametrize("lacking", ["columns", "process"])
def test_a_stage_that_lacks_something_is_refused_at_once(lacking: str) -> None:
    whole = {"columns": [], "process": lambda _: {}}
    stage: Any = SimpleNamespace(**{name: what for name, what in whole.items() if name != lacking})
    with pytest.raises(ImumonError, match=f"has no {lacking}"):
        Pipeline(None, [stage])


def test_what_stages_and_parameters_give_again_and_again_is_reported_once() -> None:
    silent: Any = SimpleNamespace(columns=[], process=lambda _: {})
    found = ["it shakes"]
    stage: Any = SimpleNamespace(columns=[], process=lambda _: {}, notices=lambda: found)
    pipeline = Pipeline(None, [silent, stage, stage], remarks=["key is not used any more"])
    assert pipeline.warnings() == ["key is not used any more", "it shakes"]
    found.append("it shakes, 2 times so far")
    assert pipeline.warnings() == ["it shakes, 2 times so far"]
    assert pipeline.warnings() == []


def test_a_class_in_place_of_a_stage_is_refused_at_once() -> None:
    whole: Any = type("Whole", (), {"columns": (), "process": None, "notices": None})
    with pytest.raises(ImumonError, match="stage Whole is a class") as caught:
        Pipeline(None, [whole])
    assert "Whole()" in str(caught.value)


def test_a_stage_cannot_change_what_was_sent() -> None:
    class Changing(_Returned):
        def process(self, block: SampleBlock) -> Any:
            block["gyro_x"][:] = 7.0
            return {}

    pipeline = Pipeline(None, [Changing(Column("mine", "1"), {})])
    pipeline.push(SampleBlock({"gyro_x": np.zeros(3)}))
    assert "read-only" in pipeline.warnings()[0]


class _Returned:
    def __init__(self, column: Column, returned: Any) -> None:
        self.columns, self._returned = [column], returned

    def process(self, _: SampleBlock) -> Any:
        return self._returned

    def notices(self) -> list[str]:
        return []


class _Given:
    def __init__(self, columns: list[str], returned: dict[str, int]) -> None:
        self.columns = [Column(name, "1") for name in columns]
        self._returned = returned

    def process(self, _: SampleBlock) -> dict[str, ColumnArray]:
        return {name: np.zeros(length) for name, length in self._returned.items()}

    def notices(self) -> list[str]:
        return []
