"""What a stage is, and how it is run: its results are checked, and one that fails is switched off."""

import os
import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Any, Protocol, TypeVar, get_args

import numpy as np

from .blocks import Columns, SampleBlock, missing, nan_for_missing
from .charts import Chart, Curve
from .columns import NAME, Column, ColumnType
from .errors import bad_config
from .lane import LaneState
from .plugins import Plugin, described
from .units import parse_own_unit

STAGE = "callable that returns a stage"
"""What a plug-in offers in the group `imumon.plugins.STAGES`, in words."""
STRICT = "IMUMON_STRICT"
"""Environment variable, set in tests: a defect of a stage of imumon is raised in a live run as well."""

T = TypeVar("T")


class Estimator(Protocol):
    """A stage behind the clock: columns in, more columns out, sample by sample."""

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""

    def process(self, block: SampleBlock) -> Columns:
        """Return the new columns of a block; the result must not depend on the division into blocks."""

    # It may also have `notices`, which returns a list of str, what the user should know so far: a pipeline
    # reports each text once.  And `charts`, which returns a list of `Chart`; and `lanes`, a dict of the state
    # of each of its lanes in the view: a `LaneState`, or a str, which is neither good nor bad.


class GuardedStage:
    """A stage whose results are checked, and which is switched off when it fails.

    From the block on in which it failed, its columns are missing.

    Raises BAD_CONFIG as `check_stage`.
    """

    def __init__(self, stage: Estimator) -> None:
        check_stage(stage)
        self.stage = stage
        self.live = self.switched_off = False
        self._own = is_own(stage)
        self._columns = tuple(stage.columns)
        """Those of a stage of imumon may change until it is switched off: it knows by then what is sent."""
        self._samples = 0
        self._report: list[str] = []

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that it adds."""
        return self.stage.columns if self._own and not self.switched_off else self._columns

    def process(self, block: SampleBlock) -> Columns:
        """Return the new columns of a block.

        Raises whatever a stage of imumon raises where the run is not live: a result without its columns
        would pass for a whole one, and the recording can be read again.
        """
        new = self._call("process", partial(self._checked, block), None, self._shown(block))
        if new is None:
            return self._missing(block)
        self._samples += len(block)
        return new

    def notices(self) -> list[str]:
        """Return its notices so far, and why it was switched off."""
        return [*self._call("notices", partial(_each_is, str, "text"), list[str]()), *self._report]

    def charts(self) -> Sequence[Chart]:
        """Return its charts as they are now; empty while there is nothing to show."""
        return self._call("charts", _charts, list[Chart]())

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the state of each of its lanes as it is now."""
        return self._call("lanes", _lanes, dict[str, LaneState]())

    def _call(self, name: str, checked: Callable[[Any], T], otherwise: T, *blocks: SampleBlock) -> T:
        """Return what a call of the stage returns, or as if it had none; where it fails, switch it off."""
        if self.switched_off:
            return otherwise
        try:
            return checked(getattr(self.stage, name, type(otherwise))(*blocks))
        except Exception as error:  # whatever somebody else's code raises
            if self._own and (not self.live or STRICT in os.environ):
                raise
            self._switch_off(name, error, blocks)
            return otherwise

    def _switch_off(self, call: str, error: Exception, blocks: Sequence[SampleBlock]) -> None:
        declared = {column.name: column for column in self._columns}
        with suppress(Exception):  # those of a stage of imumon by now; it has failed, and may fail here too
            declared |= {column.name: column for column in self.columns}
        # What another has added already is not its own.
        others = {name for block in blocks for name in block.columns}
        self._columns = tuple(column for name, column in declared.items() if name not in others)
        self.switched_off = True
        what = f"{name_of(self.stage)} is switched off after {self._samples:,} samples"
        why = described(error, __file__)
        theirs = "mend it, or leave it out (a plug-in: --without-plugins)"
        advice = "report this defect of imumon" if self._own else theirs
        self._report.append(f"{what}, its columns are missing from there on: {call}: {why}; {advice}")

    def _shown(self, block: SampleBlock) -> SampleBlock:
        if self._own:
            return block
        # It cannot write to what was sent; compiled code of imumon would be compiled anew for that.
        shown = {name: nan_for_missing(values).view() for name, values in block.columns.items()}
        for view in shown.values():
            view.flags.writeable = False
        return SampleBlock(shown)

    def _missing(self, block: SampleBlock) -> Columns:
        """Return its columns without values, but for what another adds."""
        own = [column for column in self._columns if column.name not in block]
        return {column.name: missing(len(block), column.dtype) for column in own}

    def _checked(self, block: SampleBlock, new: Any) -> Columns:
        """Return the new columns of a block.

        Raises BAD_CONFIG for one that was not declared, is there already or does not come, or is otherwise
        than declared.
        """
        if not isinstance(new, Mapping):
            raise bad_config(f"it returned {_named(new)}", "return a dict: an array for each column")
        if not len(block):
            return new if self._own else self._missing(block)
        declared = {column.name: column.dtype for column in self.columns}
        if there := ", ".join(name for name in new if name in block):
            raise bad_config(f"it adds {there}, which is there already", "give it another name")
        if new and new.keys() != declared.keys():
            raise bad_config(
                f"it returned {', '.join(new)} and declares {', '.join(declared)}",
                "return every column that is declared, NaN where there is nothing",
            )
        for name, values in new.items():
            is_array = isinstance(values, np.ndarray)
            found = f"{values.dtype} of shape {values.shape}" if is_array else _named(values)
            expected = f"{declared[name]} of shape {(len(block),)}"
            if found != expected:
                raise bad_config(f"{name} is {found}, expected {expected}", "return a value for each sample")
        return new


def check_stage(stage: Estimator) -> None:
    """Raise BAD_CONFIG for a stage that lacks something, or declares what no table can have."""
    if isinstance(stage, type):
        name = stage.__name__
        raise bad_config(f"stage {name} is a class", f"give a stage that it makes: {name}()")
    for needed in ("columns", "process"):
        if not hasattr(stage, needed):
            raise bad_config(f"{name_of(stage)} has no {needed}", "a stage has columns and process")
    for column in stage.columns:
        if not isinstance(column, Column):
            raise bad_config(
                f"{name_of(stage)}: {column!r} is no column", "declare imumon.Column(name, unit)"
            )
        named = f"{name_of(stage)}: {column.name}"
        if not isinstance(column.name, str) or not re.fullmatch(NAME, column.name):
            raise bad_config(f"{named} is no name of a column", "small letters, digits and _")
        if column.dtype not in get_args(ColumnType):
            raise bad_config(f"{named} has type {column.dtype!r}", f"use {' or '.join(get_args(ColumnType))}")
        if is_own(stage):
            continue
        try:
            parse_own_unit(str(column.unit))
        except ValueError as error:
            raise bad_config(
                f"{named}: {error}", 'write it like rad/s, or "1" where there is no unit'
            ) from error


def made_by(plugin: Plugin) -> Estimator:
    """Return a new stage of a plug-in.

    Raises BAD_CONFIG, naming it, when it makes none.
    """
    try:
        stage: Estimator = plugin.offered()
        check_stage(stage)
    except Exception as error:  # whatever somebody else's code raises
        raise plugin.error(f"makes no stage: {described(error, __file__)}") from error
    return stage


def is_callable(_: str, offered: object) -> bool:
    """Return whether a plug-in offers what can be called."""
    return callable(offered)


def is_own(stage: object) -> bool:
    """Return whether a stage is one of imumon."""
    return type(stage).__module__.partition(".")[0] == "imumon"


def name_of(stage: object) -> str:
    """Return what messages call a stage: its class, and the module of one from another package."""
    name = type(stage).__name__
    return f"stage {name}" if is_own(stage) else f"stage {name} of {type(stage).__module__}"


def _each_is(kind: type[T], what: str, found: object) -> list[T]:
    """Return a list of a stage; raises BAD_CONFIG when it is none, or holds something else."""
    if not isinstance(found, list | tuple) or not all(isinstance(one, kind) for one in found):
        raise bad_config(f"it returned what is no {what}", f"return a list of {kind.__name__}")
    return [*found]


def _charts(found: object) -> list[Chart]:
    charts = _each_is(Chart, "chart", found)
    for curve in [curve for chart in charts for curve in _each_is(Curve, "curve", chart.curves)]:
        is_drawn = isinstance(curve.x, np.ndarray) and isinstance(curve.y, np.ndarray)
        if not is_drawn or curve.x.ndim != 1 or curve.x.shape != curve.y.shape:
            raise bad_config(f"x and y of curve {curve.name!r} are no points", "give two arrays, (n,) each")
    return charts


def _lanes(states: object) -> Mapping[str, LaneState]:
    if not isinstance(states, Mapping) or not all(isinstance(name, str) for name in states):
        raise bad_config("it returned what is no state", "return a dict of str: the state of each lane")
    each = [LaneState(state) if isinstance(state, str) else state for state in states.values()]
    return dict(zip(states, _each_is(LaneState, "state", each), strict=True))


def _named(value: object) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
