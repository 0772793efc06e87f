from __future__ import annotations

from typing import Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.config import StrictModel, parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.fleet.rack.description import RackFile
from imumon.protocols.device import parse_device
from imumon.run.setup import Setup


class Example(StrictModel):
    name: str
    scale: float = 1.0


class Kind(Example):
    format: Literal["kind/1"]


@pytest.mark.parametrize("text", ["1e-6", "1.0e-6", "1E-6", "+1e-6", ".1e-5", "10.e-7"])
def test_a_number_with_an_exponent_is_a_number(text: str) -> None:
    assert parse_yaml(f"name: a\nscale: {text}\n", Example, "x.yaml").scale == pytest.approx(1e-6)


@pytest.mark.parametrize("text", ["10e727c913", "1e5x", "e5", "12e", "1e-"])
def test_what_only_begins_like_a_number_is_text(text: str) -> None:
    assert parse_yaml(f"name: {text}\n", Example, "x.yaml").name == text


@pytest.mark.parametrize(
    "text", ["name: 2026-13-41", "name: 99:99:99 x: y", "? [a, b]\n: c", "name: !!int x", "a: *b"]
)
def test_values_that_break_the_parser_are_an_error_of_the_file(text: str) -> None:
    with pytest.raises(ImumonError, match=r"x\.yaml") as caught:
        parse_yaml(text, Example, "x.yaml")
    assert caught.value.reason is Reason.BAD_CONFIG


@pytest.mark.parametrize("text", ["1:16.4", "1:30", "010", "-007"])
def test_numbers_that_yaml_reads_as_others_are_refused(text: str) -> None:
    with pytest.raises(ImumonError, match=r"x.yaml:2: .* is not a plain number"):
        parse_yaml(f"name: a\nscale: {text}\n", Example, "x.yaml")


def test_of_a_file_of_another_kind_only_that_is_stated() -> None:
    with pytest.raises(ImumonError) as caught:
        parse_yaml("format: other/1\nwhat: 1\nelse: 2\n", Kind, "x.yaml")
    assert caught.value.seen == "x.yaml:1: format: Input should be 'kind/1', got 'other/1'"


@pytest.mark.parametrize(
    ("kind", "what"),
    [
        ("imumon-bias-model/2", "a model file, which --model takes"),
        ("imumon-pipeline/1", "a pipeline file, which --pipeline takes"),
        ("imumon-device/1", "a device file, which --device takes"),
    ],
)
def test_a_file_that_another_option_takes_is_named(kind: str, what: str) -> None:
    with pytest.raises(ImumonError) as caught:
        parse_yaml(f"# mine\nformat: {kind}\nother: 1\n", Kind, "x.yaml")
    assert caught.value.seen == f"x.yaml:2: this is {what}"


def test_another_version_of_the_same_kind_is_not_called_another_kind() -> None:
    with pytest.raises(ImumonError, match="format: Input should be 'imumon-pipeline/1', got"):
        parse_yaml("format: imumon-pipeline/9\n", Setup, "x.yaml")


def test_a_list_of_one_is_shown_where_a_list_is_expected() -> None:
    text = "format: imumon-device/1\nname: a\ntitle: a\nprotocol: text\nserial: {baudrates: 115200}\n"
    with pytest.raises(ImumonError, match=r"x.yaml:5: serial.baudrates: expected a list: \[115200\]"):
        parse_device(text, "x.yaml")


def test_a_wrong_key_gets_those_that_there_are_and_a_tab_its_cure() -> None:
    with pytest.raises(ImumonError, match="keys that there are: name, scale"):
        parse_yaml("name: a\nscael: 2\n", Example, "x.yaml")
    nested = "format: imumon-rack/1\nunits:\n  port: {prot: /dev/ttyUSB0}\n  b: {port: x, baud: 1}\n"
    with pytest.raises(ImumonError, match=r"in units\.port: device, baud, model, pipeline, port, serial"):
        parse_yaml(nested, RackFile, "x.yaml")
    with pytest.raises(ImumonError, match="YAML is indented with spaces"):
        parse_yaml("name:\n\tscale: 2\n", Example, "x.yaml")


def outcome(text: str) -> Reason | None:
    try:
        parse_yaml(text, Example, "x.yaml")
    except ImumonError as error:
        return error.reason
    return None


@given(st.text(max_size=60))
@settings(max_examples=200, deadline=None)
def test_any_text_is_read_or_refused(text: str) -> None:
    assert outcome(text) in (None, Reason.BAD_CONFIG)
