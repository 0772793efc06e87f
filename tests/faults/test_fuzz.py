from __future__ import annotations

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tests.faults.fuzz import TOKENS, Edit, Target, attempt, edited, targets

TARGETS = targets()
edits = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.integers(0, 12), st.sampled_from(TOKENS) | st.binary(max_size=12)),
    min_size=1,
    max_size=4,
)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
def test_what_is_changed_is_refused_in_words_or_taken(target: Target) -> None:
    @settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
    @given(changes=edits)
    def check(changes: list[Edit]) -> None:
        assert not attempt(target, edited(target.seed, changes))

    check()
