from __future__ import annotations

import itertools

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import NO_INT, SampleBlock
from imumon.view.items import Log, Samples, State, Timebase, ViewItem, merge
from tests.view.streams import DEVICE_NS, HOST_NS, block

MS = 1_000_000


def restarted(gap_ms: int, n: int = 10) -> SampleBlock:
    """A device that starts its clock anew after n samples; on the host clock the gap is gap_ms."""
    before, after = block(0, n), block(0, n)
    shift = int(before["host_time_ns"][-1]) + gap_ms * MS - int(after["host_time_ns"][0])
    columns = {name: np.concatenate([before[name], after[name]]) for name in before.columns}
    columns["segment"] = np.repeat(np.array([0, 1], np.int64), n)
    columns["host_time_ns"][n:] += shift
    return SampleBlock(columns)


def test_first_segment_keeps_the_devices_own_time() -> None:
    samples = Timebase().samples(block(0, 20))
    assert samples.times.device_ns is not None
    assert samples.times.host_ns is not None
    np.testing.assert_array_equal(samples.times.device_ns, block(0, 20)["device_time_ns"])
    np.testing.assert_array_equal(samples.times.host_ns, block(0, 20)["host_time_ns"])


def test_new_segment_begins_as_much_later_as_the_host_clock_states() -> None:
    samples = Timebase().samples(restarted(gap_ms=250))
    assert samples.times.device_ns is not None
    steps = np.diff(samples.times.device_ns)
    assert steps[9] == 250 * MS
    assert (np.delete(steps, 9) == 10 * MS).all()


def test_new_segment_without_host_time_begins_where_the_last_ended() -> None:
    both = restarted(gap_ms=250)
    columns = {name: values for name, values in both.columns.items() if name != "host_time_ns"}
    samples = Timebase().samples(SampleBlock(columns))
    assert samples.times.host_ns is None
    assert samples.times.device_ns is not None
    steps = np.diff(samples.times.device_ns)
    assert steps[9] == 0
    assert (np.delete(steps, 9) == 10 * MS).all()


@settings(max_examples=40, deadline=None)
@given(cuts=st.lists(st.integers(1, 39), max_size=8), gap_ms=st.integers(1, 5000))
def test_times_do_not_depend_on_how_the_stream_is_cut(cuts: list[int], gap_ms: int) -> None:
    whole = restarted(gap_ms, n=20)
    expected = Timebase().samples(whole)
    timebase = Timebase()
    edges = [0, *sorted(set(cuts)), 40]
    parts = [timebase.samples(whole.rows(a, b)) for a, b in itertools.pairwise(edges)]
    (joined,) = merge(parts)
    assert isinstance(joined, Samples)
    np.testing.assert_array_equal(joined.times.sample, expected.times.sample)
    assert joined.times.device_ns is not None
    assert expected.times.device_ns is not None
    np.testing.assert_array_equal(joined.times.device_ns, expected.times.device_ns)
    np.testing.assert_array_equal(joined.block["gyro_x"], whole["gyro_x"])


def test_missing_host_time_leaves_the_host_timeline_out() -> None:
    part = block(0, 5)
    columns = {**part.columns, "host_time_ns": np.full(5, NO_INT, np.int64)}
    samples = Timebase().samples(SampleBlock(columns))
    assert samples.times.host_ns is None
    assert samples.times.device_ns is not None


def test_device_time_of_an_event_goes_on_while_the_device_is_silent() -> None:
    timebase = Timebase()
    timebase.samples(block(0, 10))
    at = timebase.at(HOST_NS + 90 * MS + 3_000 * MS)
    assert at.sample == 9
    assert at.device_ns == DEVICE_NS + 90 * MS + 3_000 * MS


def test_device_time_of_an_event_that_is_shown_late_is_that_of_its_moment() -> None:
    timebase = Timebase()
    timebase.samples(block(0, 10))
    assert timebase.at(HOST_NS + 30 * MS).device_ns == DEVICE_NS + 30 * MS
    assert timebase.at(HOST_NS - 3_000 * MS).device_ns == DEVICE_NS


def test_event_before_the_first_sample_has_host_time_only() -> None:
    at = Timebase().at(HOST_NS)
    assert (at.sample, at.device_ns, at.host_ns) == (None, None, HOST_NS)


def test_merge_joins_samples_also_about_a_gap_and_keeps_events_in_order() -> None:
    timebase = Timebase()
    parts = [timebase.samples(block(10 * k, 10)) for k in range(4)]
    at = timebase.at()
    events: list[ViewItem] = [State(at, "port", "open"), Log(at, "a"), Log(at, "b")]
    merged = merge([parts[0], events[0], parts[1], events[1], parts[3], events[2]])
    assert isinstance(merged[0], Samples)
    assert merged[0].times.sample is not None
    assert merged[0].times.sample.tolist() == [*range(20), *range(30, 40)]
    assert merged[1:] == events


def _side(first: int, n: int, segment: int = 0) -> SampleBlock:
    rows = block(first, n)
    columns = {name: rows[name] for name in ("device_time_ns", "host_time_ns")}
    return SampleBlock(
        {**columns, "segment": np.full(n, segment, np.int64), "gnss_latitude": np.full(n, 48.0)}
    )


def test_side_streams_are_on_the_timelines_of_the_main_one() -> None:
    timebase = Timebase()
    main = timebase.samples(restarted(gap_ms=250))
    assert main.times.device_ns is not None
    before, after = timebase.side("gnss", _side(5, 2)), timebase.side("gnss", _side(5, 2, segment=1))
    assert before.times.device_ns is not None
    assert after.times.device_ns is not None
    np.testing.assert_array_equal(before.times.device_ns, main.times.device_ns[5:7])
    np.testing.assert_array_equal(after.times.device_ns, main.times.device_ns[15:17])
    assert before.times.sample is None


def test_merge_joins_each_stream_apart() -> None:
    timebase = Timebase()
    items: list[ViewItem] = []
    for k in range(4):
        items.append(timebase.samples(block(10 * k, 10)))
        items.append(timebase.side("gnss", _side(k, 1)))
    main, side = merge(items)
    assert isinstance(main, Samples)
    assert isinstance(side, Samples)
    assert (main.rows, main.stream, side.rows, side.stream) == (40, "", 4, "gnss")


def test_merge_does_not_join_blocks_of_different_columns() -> None:
    timebase = Timebase()
    parts = [timebase.samples(block(0, 5)), timebase.samples(block(5, 5, leave_out=("mag",)))]
    assert len(merge(parts)) == 2
