"""``imumon replay --smooth`` as a user or a program meets it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from tests.cli.command import imumon


def test_a_replay_adds_what_the_future_shows(tmp_path: Path) -> None:
    session, table = tmp_path / "session", tmp_path / "samples.parquet"
    made = imumon("simulate", "self-heating", "--rate", 50, "--duration", 120, "--out", session)
    assert made.returncode == 0, made.stderr
    done = imumon("replay", session, "--smooth", "--out", table, "--json")
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    assert {"gyro_bias_x", "temperature_estimate_z", "temperature_rate_x"} <= set(report["disagreement"])
    assert report["identical_to_live"] is None
    found = pq.read_table(table).to_pydict()
    smoothed, forward = (np.array(found[name], float) for name in ("gyro_bias_smoothed_x", "gyro_bias_x"))
    assert len(smoothed) == report["rows"]
    assert np.isnan(forward[0])
    assert np.isfinite(smoothed).all()
    sd, forward_sd = (np.array(found[name], float) for name in ("gyro_bias_smoothed_sd_x", "gyro_bias_sd_x"))
    assert np.median(sd) < np.nanmedian(forward_sd)
    assert "forward minus backward" in done.stderr
