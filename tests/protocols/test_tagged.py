from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np
import pytest

from imumon.blocks import NO_INT, SampleBlock
from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import Encoder, Timing
from imumon.protocols.decoder import MOST_NOTICES
from imumon.protocols.messages import Message
from imumon.protocols.numbers import Derived, Number
from imumon.protocols.tagged import XBUS, XBUS_DATA, TaggedDecoder
from tests.protocols.streams import feed_in_chunks, xbus_message

WIDE, LEVEL = Column("wide", "1", "int64"), Column("level", "m")
DOUBLE = Derived(
    ("_half",),
    (LEVEL,),
    lambda columns: [columns["_half"] * 2],
    lambda columns: [columns["level"] / 2],
)
FIELDS = [
    (0x0101, Message("wide", (Number(WIDE, "u16"),))),
    (0x0101, Message("wide", (Number(WIDE, "i64"),))),
    (0x0202, Message("level", (Number(LEVEL, "f32"),))),
    (0x0303, Message("half", (Number(None, "u8"), Number(Column("_half", "m"), "f64")))),
    (0x0404, Message("blob", ())),
]


class Talker(TaggedDecoder):
    """A decoder that repeats what it was told."""

    timing, data, derived = Timing(), (0x36,), (DOUBLE,)

    def __init__(self, bare: bool = False) -> None:
        self.form, self._there = (XBUS_DATA, [(0, FIELDS[0][1])]) if bare else (XBUS, FIELDS)
        self.messages = dict(enumerate(item for _, item in self._there))
        super().__init__()

    def _field(self, key: int, size: int) -> Message | None:
        there = (item for known, item in self._there if known == key and item.size == size)
        return next(there, None)

    def encoder(self, names: Sequence[str]) -> Encoder:
        raise NotImplementedError

    def _describe(self, kind: int, payload: bytes) -> Iterable[str]:
        yield f"{kind:02X} {payload.hex()}"


def data(*fields: tuple[int, bytes]) -> bytes:
    body = b"".join(key.to_bytes(2, "big") + bytes([len(content)]) + content for key, content in fields)
    return xbus_message(0x36, body)


def test_a_field_may_have_several_sizes() -> None:
    decoder = Talker()
    decoder.feed(data((0x0101, b"\xff\xff")) + data((0x0101, b"\xff" * 8)) + data((0x0101, b"\x00")), 0)
    assert decoder.take()["wide"].tolist() == [65_535, -1]
    assert decoder.notices() == ["field 0x0101 of 1 bytes is not known and is passed over"]


def test_computed_values_fill_in_where_none_were_sent() -> None:
    half = b"\x07" + np.array([4.0], ">f8").tobytes()
    level = np.array([3.0], ">f4").tobytes()
    decoder = Talker()
    decoder.feed(data((0x0202, level)) + data((0x0303, half)) + data((0x0202, level), (0x0303, half)), 0)
    block = decoder.take()
    assert block["level"].tolist() == [3, 8, 3]
    assert set(block.columns) == {"arrival_time_ns", "level"}
    assert [column.name for column in decoder.columns] == ["arrival_time_ns", "level"]


def test_a_packet_with_nothing_for_a_row_makes_none() -> None:
    decoder = Talker()
    decoder.feed(data((0x0404, b"abc")) + data() + data((0x0404, b""), (0x0101, b"\x00\x05")), 0)
    assert decoder.take()["wide"].tolist() == [5]
    assert decoder.counters().packets == 3


def test_missing_values_are_missing() -> None:
    decoder = Talker()
    decoder.feed(data((0x0101, b"\x00\x05")) + data((0x0202, bytes(4))), 0)
    block = decoder.take()
    assert block["wide"].tolist() == [5, NO_INT]
    np.testing.assert_array_equal(block["level"], [np.nan, 0])


@pytest.mark.parametrize("lengths", [[1 << 16], [1000], [7]])
def test_all_of_many_messages_are_reported(lengths: list[int]) -> None:
    messages = [xbus_message(0x10, number.to_bytes(2, "big") * 100) for number in range(200)]
    stream = b"".join(message + data((0x0101, b"\x00\x01")) for message in messages)
    decoder = Talker()
    block = feed_in_chunks(decoder, stream, lengths)
    assert len(block) == 200
    assert decoder.notices() == [f"10 {number.to_bytes(2, 'big').hex() * 100}" for number in range(200)]


def test_the_number_of_different_notices_is_bounded() -> None:
    decoder = Talker()
    for number in range(MOST_NOTICES + 50):
        decoder.feed(xbus_message(0x10, number.to_bytes(2, "big")), 0)
    assert len(decoder.notices()) == MOST_NOTICES
    assert decoder.counters().packets == MOST_NOTICES + 50


def test_many_rows_and_messages_at_once_lose_nothing() -> None:
    piece = data((0x0101, b"\x00\x01")) + xbus_message(0x10, bytes(30))
    decoder = Talker()
    block = feed_in_chunks(decoder, piece * 5000, [1 << 16, 5])
    assert len(block) == 5000
    assert decoder.counters().bytes_in_packets == len(piece) * 5000


def test_arrival_is_that_of_the_last_byte() -> None:
    packet = data((0x0101, b"\x00\x01"))
    decoder = Talker()
    decoder.feed(packet[:5], 1)
    decoder.feed(packet[5:] + packet * 5000 + packet[:3], 2)
    decoder.feed(packet[3:], 3)
    assert decoder.take()["arrival_time_ns"].tolist() == [2] * 5001 + [3]


def test_packets_of_a_thousand_layouts_are_read_in_bounded_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("imumon.protocols.messages.MOST_LAYOUTS", 50)
    decoder = Talker()
    for number in range(1000):
        unknown = (0x0900 + number, b"")
        decoder.feed(data(unknown, (0x0101, number.to_bytes(2, "big"))), number)
        assert decoder.take()["wide"].tolist() == [number]
    assert len(decoder._layouts) <= 51


def test_a_fixed_payload_is_the_first_field_of_the_table() -> None:
    decoder = Talker(bare=True)
    decoder.feed(xbus_message(0x36, b"\x12\x34") + xbus_message(0x36, b"\x12\x34\x56"), 0)
    assert decoder.take()["wide"].tolist() == [0x1234]
    assert decoder.notices() == ["field 0x0000 of 3 bytes is not known and is passed over"]


def test_the_role_of_a_type_that_is_not_named_is_a_message() -> None:
    decoder = Talker()
    decoder.feed(xbus_message(0x99), 0)
    assert decoder.notices() == ["99 "]


def test_the_encoder_sends_columns_that_the_block_lacks_as_zero() -> None:
    encoder = Talker().field_encoder(0x36, FIELDS[1:4])
    (packet,) = encoder.encode(SampleBlock({"wide": np.array([-3])}))
    decoder = Talker()
    decoder.feed(packet, 0)
    block = decoder.take()
    assert (block["wide"][0], block["level"][0]) == (-3, 0)


def test_the_encoder_refuses_a_packet_that_is_too_long() -> None:
    long = Message("long", (Number(KNOWN["roll"], "f64"),) * 31)
    with pytest.raises(ImumonError, match="2259 bytes") as caught:
        Talker().field_encoder(0x36, [(0x0505, long)] * 9)
    assert caught.value.reason is Reason.BAD_CONFIG


def test_an_empty_block_makes_no_packets() -> None:
    encoder = Talker().field_encoder(0x36, FIELDS[:1])
    assert encoder.encode(SampleBlock({"wide": np.zeros(0, np.int64)})) == []
