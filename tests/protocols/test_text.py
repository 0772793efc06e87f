from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.blocks import SampleBlock
from imumon.protocols.device import load_device, parse_device
from imumon.protocols.text import TextDevice
from tests.protocols.streams import chunkings, feed_in_chunks
from tests.protocols.test_device import complaint

HEAD = "format: imumon-device/1\nname: t\ntitle: t\nprotocol: text\naxes: FLU\nlines:\n"
CSV = HEAD + (
    "  - name: csv\n    values: 4\n    fields:\n"
    "      - {at: 0, type: u32, column: device_ticks, unit: us}\n"
    "      - {at: 1, columns: [gyro_x, gyro_y, gyro_z], unit: deg/s}\n"
)
JSON = HEAD + (
    "  - name: j\n    form: json\n    fields:\n"
    "      - {key: imu.gyro, columns: [gyro_x, gyro_y, gyro_z], unit: deg/s}\n"
    "      - {key: temp, column: temperature, unit: degC}\n"
)
PAIRS = HEAD + (
    "  - name: p\n    form: pairs\n    separator: ' '\n    fields:\n"
    "      - {key: gx, column: gyro_x, unit: deg/s}\n      - {key: T, column: temperature, unit: degC}\n"
)
SUM = HEAD + (
    "  - name: s\n    prefix: '$IMU,'\n    checksum: xor8\n    values: 3\n    fields:\n"
    "      - {at: 0, columns: [accel_x, accel_y, accel_z], unit: m/s^2}\n"
)


def decoded(text: str, data: bytes, lengths: list[int] | None = None) -> SampleBlock:
    return feed_in_chunks(parse_device(text, "t.yaml").decoder(), data, lengths or [13])


def test_lines_with_separators() -> None:
    block = decoded(CSV, b"garbage\r\n1000,1,-2.5,.5e1\r\n2000,4,5,6\n3000,7,8\n4000,1,nan,2\n5000,1,2,3\n")
    assert block["device_ticks"].tolist() == [1000, 2000, 5000]
    np.testing.assert_allclose(np.rad2deg(block["gyro_y"]), [-2.5, 5, 2])
    np.testing.assert_allclose(np.rad2deg(block["gyro_z"]), [5, 6, 3])


@pytest.mark.parametrize("bad", [b"-5", b"70000", b"1.5", b"65536"])
def test_a_clock_that_its_type_does_not_hold_makes_a_line_bad(bad: bytes) -> None:
    decoder = parse_device(CSV.replace("u32", "u16"), "t.yaml").decoder()
    line = bad + b",1,2,3\n"
    block = feed_in_chunks(decoder, b"\n0,1,2,3\n" + line + b"65535,1,2,3\n", [7])
    assert block["device_ticks"].tolist() == [0, 65535]
    assert decoder.counters().checksum_errors == 1


def test_a_count_is_written_with_the_bits_that_its_type_has() -> None:
    device = parse_device(CSV.replace("u32", "i16"), "t.yaml")
    ticks = np.array([-32768, 32767, 32768, 65536 + 5])
    sent = b"".join(device.encoder().encode(SampleBlock({"device_ticks": ticks})))
    read = feed_in_chunks(device.decoder(), b"\n" + sent, [11])
    assert read["device_ticks"].tolist() == [-32768, 32767, -32768, 5]


def test_the_first_line_may_be_torn_and_does_not_count() -> None:
    assert len(decoded(CSV, b"00,1,2,3\n1000,1,2,3\n")) == 1


def test_pairs_and_json() -> None:
    block = decoded(PAIRS, b"\ngx:90 T:21.5 note:hello\ngx=45  T=22\ngx:1\n")
    np.testing.assert_allclose(np.rad2deg(block["gyro_x"]), [90, 45])
    assert block["temperature"].tolist() == [21.5, 22]
    good = b'{"t": 1, "imu": {"gyro": [1, 2, 3]}, "temp": 20.5}\n'
    bad = b'{"imu": {"gyro": [1, 2]}, "temp": 1}\n{"imu": 1, "temp": true}\n'
    huge = good.replace(b"20.5", b"9" * 400)  # as a float it would overflow
    block = decoded(JSON, b"\n" + good + bad + huge + good)
    np.testing.assert_allclose(np.rad2deg(block["gyro_z"]), [3, 3])
    assert block["temperature"].tolist() == [20.5, 20.5]


def test_a_decimal_comma() -> None:
    text = CSV.replace("values: 4", "values: 4\n    separator: ;\n    decimal: ','")
    assert np.rad2deg(decoded(text, b"\n1;1,5;2;3\n")["gyro_x"])[0] == pytest.approx(1.5)


def test_sentences_with_checksum_anywhere_in_the_stream() -> None:
    device = parse_device(SUM, "t.yaml")
    sent = SampleBlock({"accel_x": np.array([1.5, 2.5]), "accel_z": np.array([9.75, 9.5])})
    first, second = device.encoder().encode(sent)
    damaged = first.replace(b"1.5", b"1.7")
    decoder = device.decoder()
    block = feed_in_chunks(decoder, b"\x00$I" + first + damaged + b"junk" + second, [3])
    assert block["accel_x"].tolist() == [1.5, 2.5]
    assert decoder.counters().checksum_errors == 1


@pytest.mark.parametrize("text", [CSV, JSON, PAIRS, SUM])
@given(lengths=chunkings, seed=st.integers(0, 100))
@settings(max_examples=10, deadline=None)
def test_what_is_written_is_read_whatever_the_chunks(text: str, lengths: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    names = [f"{base}_{axis}" for base in ("gyro", "accel") for axis in "xyz"]
    sent = SampleBlock(
        {**{name: rng.normal(0, 1, 20) for name in names}, "temperature": rng.normal(20, 1, 20),
         "device_ticks": np.arange(20) * 1000}
    )  # fmt: skip
    device = parse_device(text, "t.yaml")
    block = feed_in_chunks(device.decoder(), b"\n" + b"".join(device.encoder().encode(sent)) + b"\n", lengths)
    assert len(block) == 20
    for name in block.columns:
        if name in sent.columns:
            np.testing.assert_allclose(block[name], sent[name], rtol=1e-6)


@pytest.mark.parametrize(
    ("sentence", "column", "value"),
    [
        (b"$HEHDT,274.07,T*19", "heading_true", 274.07),
        (b"$GPROT,35.6,A*01", "rate_of_turn", 35.6),
        (b"$PASHR,123816.80,312.95,T,-0.83,-0.42,-0.01,0.234,0.224,0.298,2,1*0B", "heading_true", 312.95),
        (b"$GPHDG,98.3,0.0,E,12.6,W*4B", "magnetic_heading", 98.3),
    ],
)
def test_nmea_sentences(sentence: bytes, column: str, value: float) -> None:
    block = feed_in_chunks(load_device("nmea").decoder(), sentence + b"\r\n", [5])
    assert block[column][0] == value
    wrong = sentence[:-1] + (b"2" if sentence[-1:] != b"2" else b"3") + b"\r\n"
    assert len(feed_in_chunks(load_device("nmea").decoder(), wrong, [5])) == 0


def test_known_boards() -> None:
    line = b"#YPRAG=10.0,-5.0,1.0,0.0,0.0,256.0,0.1,0.2,0.3\r\n"
    block = feed_in_chunks(load_device("razor").decoder(), line, [7])
    assert block["accel_z"][0] == pytest.approx(9.80665)
    assert block["gyro_z"][0] == 0.3
    block = feed_in_chunks(load_device("motioncal").decoder(), b"Raw:0,0,8192,16,0,0,10,0,400\r\n", [7])
    assert block["accel_z"][0] == pytest.approx(9.80665)
    assert np.rad2deg(block["gyro_x"][0]) == pytest.approx(1.0)
    assert block["mag_z"][0] == 40


@pytest.mark.parametrize(
    ("text", "old", "new", "words"),
    [
        (CSV, "values: 4", "values: 3", "behind the 3 values"),
        (CSV, "    values: 4\n", "", "give how many"),
        (CSV, "at: 0", "key: t", "need at"),
        (SUM, "'$IMU,'", "'IMU,'", "begins with $"),
        (CSV, "at: 0, type", "at: 0, key: t, type", "give either at"),
        (CSV, "gyro_y, gyro_z]", "gyro_y, gyro_x]", "fields[1]: column gyro_x is there twice"),
        (PAIRS, "column: temperature, unit: degC", "column: gyro_x, unit: deg/s", "gyro_x is there twice"),
    ],
)
def test_wrong_descriptions_are_refused(text: str, old: str, new: str, words: str) -> None:
    assert old in text
    assert words in complaint(text.replace(old, new))


def test_a_line_may_have_any_letters() -> None:
    line = '{"t°": 1, "imu": {"gyro": [1, 2, 3]}, "temp": 20.5, "note": "Münster"}\n'.encode()
    assert len(decoded(JSON, b"\n" + line + line)) == 2
    body = "$IMU,1,2,3é"
    total = np.bitwise_xor.reduce(np.frombuffer(body[1:].encode(), np.uint8))
    text = SUM.replace("values: 3", "values: 4")
    assert len(decoded(text, f"{body.replace('3é', '3,é')}*{total ^ ord(','):02X}\r\n".encode())) == 1


def test_json_has_points_and_its_texts_may_have_commas() -> None:
    text = JSON.replace("form: json", "form: json\n    separator: ;\n    decimal: ','")
    (line,) = parse_device(text, "t.yaml").encoder().encode(SampleBlock({"temperature": np.array([21.5])}))
    assert json.loads(line)["temp"] == 21.5
    assert decoded(text, b"\n" + line.replace(b"21.5", b'"22,5"'))["temperature"].tolist() == [22.5]


def test_places_and_times_are_written_with_all_their_digits() -> None:
    text = CSV.replace("type: u32, column: device_ticks, unit: us", "column: latitude, unit: deg")
    device = parse_device(text, "t.yaml")
    sent = SampleBlock({"latitude": np.array([51.123456789])})
    block = feed_in_chunks(device.decoder(), b"\n" + b"".join(device.encoder().encode(sent)), [9])
    assert block["latitude"][0] == pytest.approx(51.123456789, abs=1e-9)


def test_lines_of_one_name_are_counted_together() -> None:
    line = "  - {name: a, prefix: '%s,', values: 1, fields: [{at: 0, column: %s}]}\n"
    decoder = parse_device(HEAD + line % ("A", "x") + line % ("B", "y"), "t.yaml").decoder()
    feed_in_chunks(decoder, b"A,1\nB,2\nB,3\n", [4])
    assert decoder.counters().packets_by_type == {"a": 3}


def test_lines_of_two_kinds_may_have_one_column() -> None:
    line = "    values: 2\n    fields: [{at: 0, column: t, unit: s}, {at: 1, column: k, unit: g}]\n"
    text = HEAD + "".join(f"  - name: {name}\n    prefix: '{name},'\n{line}" for name in "ab")
    block = decoded(text, b"a,1,5\nb,2,6\n")
    assert block["k"].tolist() == [5, 6]


def test_lines_with_and_without_a_prefix_may_follow_each_other() -> None:
    fields = "    fields: [{at: 0, column: t, unit: s}, {at: 1, column: k, unit: g}]\n"
    text = (
        HEAD + f"  - name: a\n    prefix: 'a,'\n    values: 2\n{fields}  - name: b\n    values: 2\n{fields}"
    )
    block = decoded(text, b"\na,1,5\n2,6\na,3,7\n4,8\n5,9\n")
    assert block["k"].tolist() == [5, 6, 7, 8, 9]


def test_the_device_is_one_of_text() -> None:
    assert isinstance(load_device("razor"), TextDevice)
