"""A pipeline that is stored and goes on: the same samples, bit for bit."""

from __future__ import annotations

import pytest

from imumon.pipeline import Digest, Pipeline
from imumon.protocols.device import device_names, load_device
from imumon.run.live import rest_and_turn
from imumon.run.setup import Setup
from imumon.run.stages import estimators

INTERVAL_NS = 50_000_000


def test_every_stage_goes_on_where_it_stopped() -> None:
    setup, samples = Setup(latitude_deg=45.0), rest_and_turn()
    whole, parts = (Pipeline(None, estimators(load_device("ax1"), setup)) for _ in range(2))
    expected, found = Digest(), Digest()
    for start in range(0, len(samples), 325):
        block = samples.rows(start, start + 325)
        whole.push(block)
        expected.update(whole.take())
        parts.push(block)
        found.update(parts.take())
        parts = Pipeline.restore(parts.snapshot())
    assert found.hexdigest() == expected.hexdigest()
    assert [chart.key for chart in parts.charts()] == [chart.key for chart in whole.charts()]


@pytest.mark.parametrize("name", device_names())
def test_every_decoder_goes_on_in_the_middle_of_a_packet(name: str) -> None:
    device = load_device(name)
    whole, parts = Pipeline(device), Pipeline(device)
    expected, found = Digest(), Digest()
    for number, packet in enumerate(device.encoder().encode(rest_and_turn().rows(0, 60))):
        whole.feed(packet, number * INTERVAL_NS)
        parts.feed(packet[: len(packet) // 2], number * INTERVAL_NS)
        if number % 20 == 10:
            parts = Pipeline.restore(parts.snapshot())
        parts.feed(packet[len(packet) // 2 :], number * INTERVAL_NS)
    for pipeline, digest in ((whole, expected), (parts, found)):
        pipeline.finish()
        digest.update(pipeline.take(), pipeline.side)
    assert whole.counters.samples > 0
    assert parts.counters == whole.counters
    assert found.hexdigest() == expected.hexdigest()


@pytest.mark.parametrize("given", [b"junk", b"N.", Pipeline(None).snapshot()[:-100]])
def test_what_is_no_snapshot_is_refused_in_words(given: bytes) -> None:
    with pytest.raises(ValueError, match="no snapshot of a pipeline"):
        Pipeline.restore(given)
