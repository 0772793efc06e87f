"""What the stages that compute once a slot have in common."""

from collections.abc import Sequence

import numpy as np

from imumon.blocks import NO_INT, BoolArray, FloatArray, IntArray, SampleBlock
from imumon.filters.slots import ENDLESS_NS, SlotGatherer, Slots, held
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor


class SlotStage:
    """A stage whose results of a slot hold until the next slot, and are void from a restart of the device on.

    `inputs`: columns that are gathered into slots.
    `results`: their number in a slot.
    """

    def __init__(self, inputs: int, slot_s: float, results: int) -> None:
        self._gatherer = SlotGatherer(inputs, round(slot_s * 1e9))
        self._shown = np.full(results, np.nan)
        self._runs = SlotGatherer(0, ENDLESS_NS)

    def slots(self, block: SampleBlock, values: FloatArray) -> tuple[Slots, list[int]]:
        """Return the slots that end in a block, and the rows from which on nothing before holds."""
        times, segment = block["device_time_ns"], block["segment"]
        ended = self._runs.process(times, segment, values[:, :0])
        return self._gatherer.process(times, segment, values), ended.row.tolist()

    def spread(self, rows: IntArray, results: FloatArray, breaks: Sequence[int], n: int) -> FloatArray:
        """Return what is shown at n rows, (n, k), of results that are known from `rows` on."""
        at = np.concatenate([rows, np.array(breaks, np.int64)])
        values = np.concatenate([results, np.full((len(breaks), results.shape[1]), np.nan)])
        order = np.argsort(at, kind="stable")
        shown = held(at[order], values[order], self._shown, n)
        if n:
            self._shown = shown[-1].copy()
        return shown


def inertial(block: SampleBlock) -> FloatArray:
    """Return rates and specific forces, rad/s and m/s², (n, 6); NaN where either sensor is missing."""
    gyro, accel = block.gyro, block.accel
    if gyro is None or accel is None:
        return np.full((len(block), 6), np.nan)
    return np.column_stack([gyro, accel])


def at_rest(block: SampleBlock, otherwise: bool) -> BoolArray:
    """Return whether the unit is at rest, (n,); `otherwise` where it is not stated."""
    if "at_rest" not in block:
        return np.full(len(block), otherwise)
    return np.asarray((block["at_rest"] != 0) & (block["at_rest"] != NO_INT))


def gyro_predictor(model: BiasModel | None) -> tuple[BiasPredictor | None, list[int]]:
    """Return what predicts the bias of the gyros that a model has, and their axes."""
    axes = [i for i, a in enumerate("xyz") if model is not None and f"gyro_{a}" in model.channels]
    return None if model is None else BiasPredictor(model, [f"gyro_{'xyz'[i]}" for i in axes]), axes
