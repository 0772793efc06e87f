"""Families that are tables of messages: against frames of the vendors' own encoders."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from imumon.blocks import NO_INT, SampleBlock
from imumon.errors import ImumonError
from imumon.geodesy import STANDARD_GRAVITY
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.protocols.framing import Checksum
from imumon.protocols.messages import table
from imumon.protocols.numbers import Record
from imumon.protocols.sbg import SbgDecoder
from tests.data_folder import measured
from tests.protocols.streams import feed_in_chunks

DEGREE = np.pi / 180
HIPNUC_91 = bytes.fromhex(
    "5AA54C0014BB9108152309A2C44708151C00CCE861BE9A35563E65EA723F31D07CBD75DDC5BB6BD724BC8988FC4001006A41AB2A"
    "70C296D45041ED03434141F4F4C2CCCAF8BE736A19BEF0001C3D8D375C3F"
)


def vectors(device: str, name: str) -> SampleBlock:
    """Decode a file of frames, all of which must be valid."""
    decoder = load_device(device).decoder()
    block = feed_in_chunks(decoder, measured(f"vectors/{name}").read_bytes(), [11])
    counters = decoder.counters()
    assert counters.bytes_in_packets == counters.bytes_received
    return block


def test_a_table_of_messages_is_read() -> None:
    found = table(
        """
0x50 first [side] >=4: gyro i16*deg/16 | 2
  | ned_xyz f32 m/s velocity, north, east, down
A second: year u8+2000 1 year | count u16 1 counts | scaled u16*1.0 V voltage | gnss:hdop,vdop u8*0.1 1
"""
    )
    first, second = found.values()
    assert list(found) == [0x50, ord("A")]
    assert (first.name, first.group, first.least, first.size) == ("first", "side", 4, 6 + 2 + 12)
    assert [(item.name, item.at) for item in first.placed(0, first.size, False)][2:6] == [
        ("gyro_z", 4),
        ("", 6),
        ("", 7),
        ("ned_x", 8),
    ]
    assert first.numbers[0].factor == DEGREE / 16
    ned = first.columns[-1]
    assert (ned.name, ned.unit, ned.description) == ("ned_z", "m/s", "velocity, north, east, down, z")
    assert [column.dtype for column in second.columns[:3]] == ["int64", "int64", "float64"]
    assert second.numbers[0].offset == 2000.0
    assert second.columns[-1].description == "receiver gnss: vdop"


def test_sbg_frames_of_the_vendor() -> None:
    block = vectors("sbg", "sbg_vendor_vectors.bin")
    assert len(block) == 24
    assert block["device_ticks"][[0, 8, 16]].tolist() == [123_456_789, 123_461_789, 123_466_789]
    assert block["accel_z"][0] == pytest.approx(-9.8000002)
    assert block["gyro_y"][0] == pytest.approx(-1.000017e-4, rel=1e-6)
    assert block["status"][16] == 0x07FF  # the scale of fast sensors
    assert block["gyro_z"][16] == pytest.approx(10.0)
    assert block["temperature"][[0, 8, 16]].tolist() == [31.5, 11.5, -8.5]
    assert block["accel_x"][1] == -1.0
    assert block["temperature"][1] == -12.25
    assert block["yaw"][2] == 3.0
    assert [block[f"q_{c}"][3] for c in "wxyz"] == [0.5, -0.5, 0.5, 0.5]
    up_time = block["up_time"][block["up_time"] != NO_INT]
    assert up_time.tolist() == [3600] * 3
    assert block["processor_load"][block["processor_load"] != NO_INT].tolist() == [42] * 3


def test_a_raw_rate_of_sbg_needs_the_status_that_has_its_scale() -> None:
    (log,) = table("9 other: _rate_xyz i32 1 rate as it is sent").values()
    record = Record(log.placed(0, log.size, False), SbgDecoder.derived)
    assert record.columns == ()


def test_sbg_rates_about_north_are_not_in_the_columns_of_those_about_the_body_axes() -> None:
    device = load_device("sbg")
    logs = {
        "rate_body": {f"{name}_{c}": [0.5] for name in ("gyro_compensated", "free_accel") for c in "xyz"},
        "rate_ned": {f"{name}_{c}": [0.25] for name in ("rate_ned", "free_accel_ned") for c in "xyz"},
    }
    stream = b""
    for log, columns in logs.items():
        sent = SampleBlock({name: np.array(values) for name, values in columns.items()})
        stream += device.model_copy(update={"sends": [log]}).encoder().encode(sent)[0]
    block = feed_in_chunks(device.decoder(), stream, [9])
    for name, values in {**logs["rate_body"], **logs["rate_ned"]}.items():
        assert block[name][np.isfinite(block[name])].tolist() == values


def test_inertial_sense_packets_of_the_vendor() -> None:
    block = vectors("inertialsense", "isb_vendor_vectors.bin")
    assert len(block) == 9
    assert block["device_ticks"][:3].tolist() == [123_456_000_000, 123_456_000_000, 123_000_000_000]
    assert block["gyro_x"][[0, 3, 6]] == pytest.approx([0.01, 0.02, 0.03])
    assert block["status"][0] == 0x00030003
    assert block["accel_z"][1] == pytest.approx(-9.8)  # -0.0392 m/s in 4 ms
    assert block["temperature"][2] == 31.5
    assert block["gyro_x"][2] == 0.25


def test_stim_datagrams_of_another_implementation() -> None:
    block = vectors("stim300", "stim300_pystim300_vectors.bin")
    assert len(block) == 18
    np.testing.assert_allclose([block[f"gyro_{c}"][0] / DEGREE for c in "xyz"], [1, 2, -3])
    accel = [block[f"accel_{c}"][3] / STANDARD_GRAVITY for c in "xyz"]
    np.testing.assert_allclose(accel, [0.1, -0.2, 0.05], atol=2e-6)
    assert [block[f"temperature_{c}"][9] for c in "xyz"] == [25.0, 25.5, 26.0]
    assert block["device_ticks"][0] == 42
    assert block["latency"][0] == 1234


def test_what_a_stim_does_not_say_comes_from_the_device_file() -> None:
    text, source = device_text("stim300")
    other = text.replace("output: rate ", "output: increment ").replace(
        "accel_range_g: 10", "accel_range_g: 5"
    )
    data = measured("vectors/stim300_pystim300_vectors.bin").read_bytes()
    decoder = parse_device(other, source).decoder()
    block = feed_in_chunks(decoder, data, [50])
    # 2^14 counts are 1/128 degree a sample, at 500 Hz.
    assert block["gyro_x"][0] / DEGREE == pytest.approx(500 / 128)
    assert block["accel_x"][3] == pytest.approx(0x00CCCD / 2**23 * 500)
    assert any("increments" in text and "5 g" in text for text in decoder.notices())


@pytest.mark.parametrize("end", [b"", b"\r\n"])
def test_a_line_end_belongs_to_the_datagram(end: bytes) -> None:
    datagram = bytes.fromhex("900040000080 00FF4000002A04D2DC70DB2F")
    decoder = load_device("stim300").decoder()
    block = feed_in_chunks(decoder, (datagram + end) * 4, [1])
    assert len(block) == 4
    assert decoder.counters().bytes_in_packets == 4 * len(datagram + end)


def test_a_hipnuc_frame_of_the_vendor() -> None:
    block = feed_in_chunks(load_device("hipnuc").decoder(), HIPNUC_91, [7])
    assert block["device_ticks"][0] == 1_840_392_000
    assert block["temperature"][0] == 35
    assert block["pressure"][0] == pytest.approx(100_676.07)
    assert block["accel_z"][0] / STANDARD_GRAVITY == pytest.approx(0.94888908)
    assert block["gyro_x"][0] / DEGREE == pytest.approx(-0.061721984)
    assert block["mag_z"][0] == pytest.approx(-60.041668)
    assert block["yaw"][0] / DEGREE == pytest.approx(-122.47706)
    assert block["q_z"][0] == pytest.approx(0.86022264)


def test_a_hipnuc_frame_states_by_bits_what_follows() -> None:
    numbers = np.array([1.5, 0, 9.75, 0, 0, 90], "<f4").tobytes()
    payload = b"\x83\0\0\0\x23\x01\0\0" + numbers + struct.pack("<Qf", 5000, 20.125)
    head = b"\x5a\xa5" + len(payload).to_bytes(2, "little")
    frame = head + Checksum("crc16-xmodem").sealed(head + payload)[-2:] + payload
    block = feed_in_chunks(load_device("hipnuc").decoder(), frame * 2, [9])
    assert block["accel_x"].tolist() == [1.5, 1.5]
    assert block["gyro_z"][0] / DEGREE == pytest.approx(90)
    assert (block["temperature"][0], block["device_ticks"][0]) == (20.125, 5000)


def test_an_ximu3_file_that_the_vendors_decoder_read() -> None:
    block = vectors("ximu3", "ximu3_checked_with_vendor_wheel.ximu3")
    assert len(block) == 21
    assert block["device_ticks"][0] == 1_000_000
    np.testing.assert_allclose([block[f"gyro_{c}"][0] / DEGREE for c in "xyz"], [0, -2.25, 10])
    accel = [block[f"accel_{c}"][0] / STANDARD_GRAVITY for c in "xyz"]
    np.testing.assert_allclose(accel, [0.01, -0.02, 1], rtol=1e-6)
    assert block["temperature"][1] == 25.5
    assert np.rad2deg(block["yaw"][-1]) == pytest.approx(3.0)  # a message of text


def test_a_mavlink_message_of_pymavlink() -> None:
    message = "fd1d00000001011b00000100000000000000020003000400050006000700080009000a0000c409045d"
    decoder = load_device("mavlink").decoder()
    block = feed_in_chunks(decoder, bytes.fromhex(message), [6])
    assert block["device_ticks"].tolist() == [1]
    np.testing.assert_allclose(
        [block[f"accel_{c}"][0] for c in "xyz"], np.array([2, 3, 4]) * STANDARD_GRAVITY / 1e3
    )
    np.testing.assert_allclose([block[f"gyro_{c}"][0] for c in "xyz"], [5e-3, 6e-3, 7e-3])
    assert block["temperature"][0] == 25.0
    warning = next(text for text in decoder.warnings() if "206 deg/h" in text)
    assert "PX4" in warning  # of the finer message, whose rates PX4 corrects


def test_mavlink_of_one_vehicle_is_read_in_both_versions() -> None:
    device = load_device("mavlink")
    block = SampleBlock({"gyro_x": np.array([0.5, 0.25, 0.125]), "device_ticks": np.arange(3) * 1000})
    mine = device.encoder().encode(block)
    body = bytes([62, 7, 1, 1, 105]) + mine[0][10:-2].ljust(62, b"\0")
    first = b"\xfe" + body + mcrf4xx(body + b"\x5d")
    foreign = mine[1][1:5] + bytes([9]) + mine[1][6:-2]
    foreign = b"\xfd" + foreign + mcrf4xx(foreign + b"\x5d")
    decoder = device.decoder()
    rows = feed_in_chunks(decoder, mine[0] + foreign + first + mine[2], [40])
    assert rows["gyro_x"].tolist() == [0.5, 0.5, 0.125]
    assert decoder.counters().packets_by_type == {"MAVLink 1": 1, "MAVLink 2": 3}
    assert any("only vehicle 1" in text for text in decoder.notices())


def test_the_vehicle_is_the_first_that_sends_more_than_a_heartbeat() -> None:
    device = load_device("mavlink")
    block = SampleBlock({"gyro_x": np.array([0.5, 0.25]), "device_ticks": np.arange(2) * 1000})
    mine = device.encoder().encode(block)

    def beat(component: int) -> bytes:
        body = bytes([9, 0, 0, 0, 1, component, 0, 0, 0]) + bytes(8) + b"\x03"
        return b"\xfd" + body + mcrf4xx(body + bytes([50]))

    stream = beat(154) + mine[0] + beat(154) + beat(1) + mine[1]
    for cuts in ([len(stream)], [1], [30]):
        decoder = device.decoder()
        rows = feed_in_chunks(decoder, stream, cuts)
        assert rows["gyro_x"][np.isfinite(rows["gyro_x"])].tolist() == [0.5, 0.25]
        assert len(rows) == 3
        assert decoder.counters().packets == 5
        assert any("only vehicle 1, component 1 " in text for text in decoder.notices())


def mcrf4xx(data: bytes) -> bytes:
    crc = 0xFFFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    return crc.to_bytes(2, "little")


def test_a_shorter_log_of_older_firmware_lacks_the_tail() -> None:
    device = load_device("sbg")
    text, source = device_text("sbg")
    encoder = parse_device(text.replace("sends: [imu_short]", "sends: [ekf_euler]"), source).encoder()
    packet = encoder.encode(SampleBlock({"roll": np.array([0.5]), "device_ticks": np.array([7])}))[0]
    body = packet[2:4] + (32).to_bytes(2, "little") + packet[6:38]
    crc = 0
    for byte in body:
        crc ^= byte
        for _ in range(8):
            crc = crc >> 1 ^ (0x8408 if crc & 1 else 0)
    block = feed_in_chunks(device.decoder(), packet[:2] + body + crc.to_bytes(2, "little") + b"\x33", [5])
    assert block["roll"][0] == 0.5
    assert "declination" not in block


@pytest.mark.parametrize("device", ["sbg", "inertialsense", "hipnuc", "ximu3", "mavlink"])
def test_a_message_that_is_not_there_is_named(device: str) -> None:
    text, source = device_text(device)
    wrong = "\n".join("sends: [nonsense]" if line.startswith("sends:") else line for line in text.split("\n"))
    with pytest.raises(ImumonError, match="nonsense"):
        parse_device(wrong, source).encoder()


def test_increments_are_sent_without_an_interval() -> None:
    device = load_device("inertialsense").model_copy(update={"sends": ["pimu"]})
    sent = {f"{what}_{axis}": np.array([0.5]) for what in ("gyro", "accel") for axis in "xyz"}
    block = feed_in_chunks(device.decoder(), device.encoder().encode(SampleBlock(sent))[0], [9])
    assert block["gyro_x"][0] == pytest.approx(0.5)
