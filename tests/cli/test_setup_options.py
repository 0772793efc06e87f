"""What the options of the command line make of a setup."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import pytest

from imumon.cli.common import make_setup
from imumon.papers.random_error import RandomErrorMethods
from imumon.recordings.folder import Session, SessionMetadata
from imumon.run.setup import Setup, unused_keys
from imumon.run.stages import estimators


def given(**options: Any) -> Setup:
    recorded = "format: imumon-pipeline/1\npublished: [stf]\n"
    metadata = SessionMetadata.begun("live", 0, device="ax1", pipeline_yaml=recorded)
    return make_setup(options, Session(Path("session"), metadata))


def test_published_methods_are_named_by_commas_and_go_before_the_file() -> None:
    assert given().published == ["stf"]
    assert given(published="fir, sr_rsukf").published == ["fir", "sr_rsukf"]
    assert given(published="").published == []


@pytest.mark.parametrize("names", ["fir,kalman", "fir,fir"])
def test_an_unknown_name_or_one_that_comes_twice_is_refused_with_those_there_are(names: str) -> None:
    with pytest.raises(click.BadParameter, match="dense_tczupt"):
        given(published=names)


def test_the_retired_method_of_the_random_error_is_a_published_one() -> None:
    setup = given(random_error="sr_rsukf")
    assert setup.methods == ["stf", "sr_rsukf"]
    assert any(isinstance(stage, RandomErrorMethods) for stage in estimators(None, setup))
    (text,) = unused_keys(setup, None)
    assert text == "random_error: method is not used any more, it is as published: [sr_rsukf]"


def test_a_session_keeps_what_was_chosen(tmp_path: Path) -> None:
    text = given(published="curve_fit").text()
    assert text is not None
    (tmp_path / "pipeline.yaml").write_text(text)
    assert make_setup({"pipeline": tmp_path / "pipeline.yaml"}).published == ["curve_fit"]
