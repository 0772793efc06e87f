from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from imumon.blocks import FloatArray, SampleBlock
from imumon.errors import ImumonError
from imumon.lab.calibration.magnetometer import covered, fit_magnetometer, slower_than_white
from imumon.models.model import BiasModel, MagnetometerModel

FIELD = np.array([20.0, 1.0, -43.0])
HARD = np.array([30.0, -20.0, 12.0])
RATE_HZ = 100.0


def figure_eight(
    seed: int,
    seconds: float = 60.0,
    swing: tuple[float, float, float] = (1.2, 1.0, 3.0),
    over: bool = True,
    noise: float = 0.3,
    slow: float = 0.0,
    iron: float = 0.1,
) -> tuple[SampleBlock, FloatArray]:
    """Readings of a unit that is swung about three axes, rad, and turned over; and its soft iron."""
    rng = np.random.default_rng(seed)
    t = np.arange(int(seconds * RATE_HZ)) / RATE_HZ
    phases, periods = rng.uniform(0.0, 6.0, 3), (2.3, 3.1, 7.7)
    angles = np.column_stack(
        [a * np.sin(2 * np.pi * t / p + s) for a, p, s in zip(swing, periods, phases, strict=True)]
    )
    angles[:, 0] += 2 * np.pi * t / 40.0 if over else 0.0
    turned = Rotation.from_euler("xyz", angles).inv()
    bent = rng.uniform(-iron, iron, (3, 3))
    soft = np.eye(3) + 0.5 * (bent + bent.T)
    soft /= np.linalg.det(soft) ** (1 / 3)
    keep = np.exp(-1.0 / (0.5 * RATE_HZ))
    walk = slow * np.sqrt(1 - keep * keep) * rng.normal(size=(len(t), 3))
    field = turned.apply(FIELD) + lfilter([1.0], [1.0, -keep], walk, axis=0)
    mag = field @ np.linalg.inv(soft).T + HARD + noise * rng.normal(size=(len(t), 3))
    accel = turned.apply([0.0, 0.0, 9.81])
    columns = {f"mag_{a}": mag[:, j] for j, a in enumerate("xyz")}
    return SampleBlock(columns | {f"accel_{a}": accel[:, j] for j, a in enumerate("xyz")}), soft


@pytest.mark.parametrize(
    ("noise", "slow", "seconds", "iron"),
    [(0.3, 0.0, 60.0, 0.1), (0.03, 0.0, 60.0, 0.5), (1.0, 0.0, 200.0, 0.1), (0.3, 0.3, 60.0, 0.1)],
)
def test_hard_and_soft_iron_are_found_with_true_sigmas(
    noise: float, slow: float, seconds: float, iron: float
) -> None:
    hard, soft = [], []
    for seed in range(6):
        block, true = figure_eight(seed, seconds, noise=noise, slow=slow, iron=iron)
        model = fit_magnetometer([block.rows(0, 700), block.rows(700, len(block))], "uT", "test").model
        hard.append((np.array(model.hard_iron) - HARD) / model.hard_iron_sd)
        soft.append((np.array(model.soft_iron) - true)[np.triu_indices(3)])
        soft[-1] /= np.array(model.soft_iron_sd)[np.triu_indices(3)]
        assert model.field == pytest.approx(float(np.linalg.norm(FIELD)), rel=0.005)
        assert model.coverage > 0.6
        assert np.linalg.det(np.array(model.soft_iron)) == pytest.approx(1.0)
    for z in (np.array(hard), np.array(soft)):
        assert 0.5 < np.sqrt(np.mean(z**2)) < 1.8
        assert np.abs(z).max() < 5.0


def test_the_corrected_field_is_the_field() -> None:
    block, _ = figure_eight(3)
    fit = fit_magnetometer([block], "uT", "test")
    mag = np.column_stack([block[f"mag_{a}"] for a in "xyz"])
    strength = np.linalg.norm(fit.model.corrected(mag), axis=1)
    assert strength.std() == pytest.approx(fit.model.residual_sd, rel=0.1)
    assert fit.model.residual_sd == pytest.approx(0.3, rel=0.15)
    assert fit.residual_before > 10.0


@pytest.mark.long
@pytest.mark.parametrize("swing", [(0.15, 0.15, 1.0), (0.0, 0.0, 3.0)])
def test_few_directions_are_refused_with_what_to_turn(swing: tuple[float, float, float]) -> None:
    block, _ = figure_eight(1, swing=swing, over=False)
    with pytest.raises(ImumonError, match=r"\d+% of the directions") as caught:
        fit_magnetometer([block], "uT", "a recording")
    assert "turn the -z axis up" in str(caught.value.hint)
    alone = SampleBlock({name: values for name, values in block.columns.items() if name.startswith("mag")})
    with pytest.raises(ImumonError) as caught:
        fit_magnetometer([alone], "uT", "a recording")
    assert "next" not in str(caught.value.hint)


@pytest.mark.long
def test_a_unit_that_did_not_turn_is_refused() -> None:
    block, _ = figure_eight(1, swing=(0.0, 0.0, 0.0), over=False)
    with pytest.raises(ImumonError, match="directions"):
        fit_magnetometer([block], "uT", "a recording")
    still = SampleBlock({f"mag_{axis}": np.full(300, 20.0) for axis in "xyz"})
    with pytest.raises(ImumonError, match="0 readings in other directions"):
        fit_magnetometer([still], "uT", "a recording")
    with pytest.raises(ImumonError, match="there is no magnetometer"):
        fit_magnetometer([SampleBlock({"accel_x": np.zeros(3)})], "uT", "a recording")


def test_rest_does_not_weigh_more_than_motion() -> None:
    block, _ = figure_eight(2, noise=0.05)
    at_rest = {name: np.full(20_000, values[0]) for name, values in block.columns.items()}
    moved = fit_magnetometer([block], "uT", "test").model
    rested = fit_magnetometer([SampleBlock(at_rest), block], "uT", "test").model
    np.testing.assert_allclose(rested.hard_iron, moved.hard_iron, atol=0.02)


def test_coverage_counts_directions() -> None:
    directions = np.random.default_rng(0).normal(size=(5000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert covered(directions).mean() == 1.0
    assert covered(directions[directions[:, 2] > 0.0]).mean() == pytest.approx(0.6, abs=0.06)
    assert covered(directions[:1]).mean() == pytest.approx(1 / 60)


def test_noise_that_is_slow_counts_less() -> None:
    white = np.random.default_rng(1).normal(size=20_000)
    assert slower_than_white(white) < 1.8
    assert slower_than_white(np.repeat(white[:2000], 10)) == pytest.approx(10.0, rel=0.5)


def test_a_model_file_may_have_a_magnetometer_alone() -> None:
    block, _ = figure_eight(4)
    found = fit_magnetometer([block], "uT", "test").model
    model = BiasModel(made_by="test", created="now", magnetometer=found)
    assert BiasModel.model_validate(model.model_dump()) == model
    with pytest.raises(ValueError, match="neither a channel nor a magnetometer"):
        BiasModel(made_by="test", created="now")
    with pytest.raises(ValueError, match="not a stretching"):
        MagnetometerModel.model_validate(found.model_dump() | {"soft_iron": (-np.eye(3)).tolist()})
