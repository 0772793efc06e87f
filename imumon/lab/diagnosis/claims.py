"""What is claimed of the findings of a channel.

w is the white floor, f the total floor.  Of a residual rms A, the *baseline's* (the declared model, or the
present one as it is), a model that leaves B *explains* enough if B < 1.8 f, or if it has 0.6 of the excess::

    explained share = 1 - (B² - f²) / (A² - f²)                                                      (10)

`choose_claims` takes four steps:

1. *Events* (`_without_small_jumps`).  A jump counts only where 1.3 w or more are left of training without
   it, and no run has two.
2. *Refuted* (`_not_refuted`).  New findings without which the test is estimated better are left out, the
   worst one first.
3. (a) *By training* (`_refutation`).  The others are claimed if they explain training and test, and
   0.25 of both; else none.
4. (b) *By the test* (`_claimed_by_test`).  Where 1.8 f are left of training without findings, and 3 claims
   nothing, or carries over (predicts the test) and leaves 1.8 f of it: of single effects, that is claimed
   which leaves least of it, if it takes away 8 w, has 0.6 of the excess over w, not f, and leaves less than
   half of what 3 leaves.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .candidates import Channel, Finding
from .fit import Fit, Score, fit, score_test
from .search import GAIN, MOST_NAMES, AxisSearch, Note

# Total floors below which a residual is explained: sqrt(1 + 1.5²), of slow noise of 1.5 floors (assumed).
SMALL_RESIDUAL = 1.8
# White (of coarse samples total) floors below which it is clean: sqrt(1 + 0.83²), 0.83 are missing (assumed).
CLEAN_RESIDUAL = 1.3
# Explained share (10) from which on effects are named, in training and in the test.  With it nothing is named
# in 99 channels of causes that are no effect; on a chamber record true effects have 0.67 to 0.99.
LEAST_EXPLAINED = 0.6
# The same of training and test together, whatever is left: true effects of half a floor have 0.28 or more;
# what a thermometer in steps of 1 °C makes of a steep curve mostly has less.
LEAST_OF_ALL = 0.25
# sqrt(A² - B²) of what the test alone proves, in white floors: false ones, of effects that are not in the
# library, had at most 5.4, true ones of a chamber record at least 90.
FLOORS_BY_TEST = 8.0


def explained_share(before: float, after: float, floor: float) -> float:
    """Return the explained share (10), 0 where `before` is below the (total or white) floor; all are rms."""
    excess = before**2 - floor**2
    return 1.0 - (after**2 - floor**2) / excess if excess > 0 and np.isfinite(after) else 0.0


@dataclass
class Hypothesis:
    """Findings that may be claimed of a channel, and the models without them (the baseline) and with them."""

    channel: Channel  # in the blocks that are scored, where the search may have been in shorter ones
    findings: list[Finding]  # what is fitted anew of the present model, too
    before: Fit  # the baseline: the declared model, or the present one as it is
    after: Fit  # that with the findings
    test_before: Score  # of `before`
    test_after: Score  # of `after`; over the same blocks
    remark: str = ""  # why nothing else is claimed

    @property
    def new(self) -> list[Finding]:
        """The findings that are not of the present model."""
        return [finding for finding in self.findings if not finding.of_present_model]


def choose_claims(channel: Channel, search: AxisSearch) -> tuple[Hypothesis, list[Note]]:
    """Return what is claimed, by the four steps above, and what the second leaves out."""
    nothing_new = _hypothesis(channel, search.of_present)
    passed, left_out = _not_refuted(channel, _without_small_jumps(channel, search))
    trained = _hypothesis(channel, passed)
    if trained.new and (why := _refutation(trained)):
        best = max(trained.new, key=GAIN)
        trained = replace(nothing_new, remark=f"the best of the known effects is {best.name}, but {why}")
    elif search.repeated_event:
        trained = replace(trained, remark="there is more than one jump in a run")
    return _claimed_by_test(search, trained, nothing_new) or trained, left_out


def _hypothesis(channel: Channel, findings: list[Finding]) -> Hypothesis:
    before = fit(channel.with_model_fixed(), [])
    after = fit(channel, [finding.candidate for finding in findings])
    test_before = score_test(channel, before, settled_as=after)
    return Hypothesis(channel, findings, before, after, test_before, score_test(channel, after))


def _without_small_jumps(channel: Channel, search: AxisSearch) -> list[Finding]:
    """Return what passes step 1."""
    lasting = [finding for finding in search.findings if finding.candidate.scope != "event"]
    without_jumps = fit(channel, [finding.candidate for finding in lasting]).train_rms
    jumps_count = not search.repeated_event and without_jumps >= CLEAN_RESIDUAL * channel.floor.sd
    return search.findings if jumps_count else lasting


def _not_refuted(channel: Channel, findings: list[Finding]) -> tuple[list[Finding], list[Note]]:
    """Return what passes step 2, and what is left out; what does not carry over predicts nothing that could
    be refuted."""
    passed, left_out = list(findings), []
    while passed and channel.test:
        everything = fit(channel, [finding.candidate for finding in passed])
        predicting = {part.effect.label for part in everything.parts if part.carries_over}
        with_it, trials = score_test(channel, everything).estimated_rms, []
        for finding in (each for each in passed if each.name in predicting and not each.of_present_model):
            others = fit(channel, [other.candidate for other in passed if other is not finding])
            without = score_test(channel, others, settled_as=everything).estimated_rms
            trials += [(without, finding)] if without < with_it else []
        if not trials:
            break
        without, worst = min(trials, key=lambda trial: trial[0])
        left_out.append({"name": worst.name, "test_rms_with": with_it, "test_rms_without": without})
        passed.remove(worst)
    return passed, left_out


def _claimed_by_test(search: AxisSearch, trained: Hypothesis, nothing_new: Hypothesis) -> Hypothesis | None:
    """Return what step 4 claims in place of `trained`; None where it claims nothing."""
    small = SMALL_RESIDUAL * trained.channel.total_floor
    test_rms = trained.test_after.smaller_rms if trained.new else np.inf
    leaves_much = trained.after.carries_over and test_rms >= small
    needless = nothing_new.after.train_rms < small or (trained.new and not leaves_much)
    if needless or not (proven := _proven_by_test(search, nothing_new)):
        return None
    by_test = _hypothesis(trained.channel, [*nothing_new.findings, proven])
    # What training proves goes first unless it leaves twice as much of the test (assumed).
    return by_test if 2.0 * by_test.test_after.rms < test_rms else None


def _refutation(trial: Hypothesis) -> str:
    """Return what of training, or of the test, refutes a hypothesis by step 3; empty where nothing does."""
    # An estimate takes some of any slow noise away: it counts as what is left, and together with training.
    channel, score = trial.channel, trial.test_after
    floor, white = channel.total_floor, channel.floor.sd
    if channel.test and not np.isfinite(score.rms):
        return "too few blocks of the test can be scored with it"

    def unless_explained(what: str, before: float, after: float, least: float) -> str:
        share = explained_share(before, after, floor)
        if share >= least:
            return ""
        change = f"{before / white:.1f} white floors become {after / white:.1f}"
        return f"it explains only {max(0.0, share):.0%} of {what}: {change}"

    train_before, train_after = trial.before.train_rms, trial.after.train_rms
    why = unless_explained("the training", train_before, train_after, LEAST_EXPLAINED)
    if why and train_after >= SMALL_RESIDUAL * floor:
        return why
    why = unless_explained("the test", trial.test_before.rms, score.rms, LEAST_EXPLAINED)
    if why and channel.test and score.smaller_rms >= SMALL_RESIDUAL * floor:
        return why
    # Training and test weigh the same, however long; without a test, whose rms is NaN, training alone counts.
    both_before = np.sqrt(np.nanmean(np.square([train_before, trial.test_before.rms])))
    both_after = np.sqrt(np.nanmean(np.square([train_after, score.smaller_rms])))
    return unless_explained("all recordings", both_before, both_after, LEAST_OF_ALL)


def _proven_by_test(search: AxisSearch, nothing_new: Hypothesis) -> Finding | None:
    """Return the effect that predicts the test best, if it explains it, where training proves nothing."""
    # Noise that wanders as fast as it does within minutes may go anywhere within the hour, so that no
    # likelihood separates a loop gone through once from a wander.  But no wander goes the same way again.
    # Only effects count that make the training likelier, by more than their coefficients cost: the best of
    # each family by the likelihood, and by least squares.
    channel = nothing_new.channel
    if not channel.test or any(run.in_slots.woven for run in channel.test):
        return None
    floor = channel.floor.sd
    plain = [one for one in search.candidates if one.shared and len(one.parts) == 1 and not one.free_start]
    hits: list[tuple[float, Finding]] = []
    every = [scored for table in search.tables for scored in table.values()]
    for leader in (one for one in every if one.linear_gain > 0.0 and one.candidate.shared):
        # The likelihood looks at what is fast; of a slow course least squares see more.
        of_family = [candidate for candidate in plain if candidate.family == leader.candidate.family]
        # There is one: what is late as a whole, or has a free start, has a plain one in its family.
        closest = min(of_family, key=lambda one: channel.residual_rms([*search.present, one]))
        for candidate in (leader.candidate, closest):
            after = fit(channel, [*search.present, candidate])
            without = score_test(channel, nothing_new.after, settled_as=after).rms
            with_it = score_test(channel, after).rms
            large = without**2 - with_it**2 >= (FLOORS_BY_TEST * floor) ** 2
            if large and explained_share(without, with_it, floor) >= LEAST_EXPLAINED:
                hits.append((with_it, Finding(candidate, leader.gain, leader.gain, by_test=True)))
    return chosen_by_test(hits)


def chosen_by_test(hits: Sequence[tuple[float, Finding]]) -> Finding | None:
    """Return the effect that leaves the least rms of the test; other names are not told apart from it."""
    if not hits:
        return None
    by_name: dict[str, Finding] = {}
    for _, finding in sorted(hits, key=lambda hit: hit[0]):
        by_name.setdefault(finding.name, finding)
    best, *others = by_name.values()
    best.family_gains = {name: finding.gain for name, finding in by_name.items()}
    best.alternatives = {other.name: other.candidate for other in others[: MOST_NAMES - 1]}
    return best
