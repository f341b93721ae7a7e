"""Measure the moment-curvature law of a test, and find the state of its string at rest.

A string that is taut at rest carries the load at the tip: the counterweight, and 3/8 of the weight
of the wire, as a prop at the tip would. With a slack string, the wire carries this load. It then
hangs, and is bent downwards before it is bent upwards. Four observations distinguish the states:

- the string becomes slack in a later cycle, and the tip moves with the clamp. The force is then
  lower than at rest by the tension at rest;
- the force falls below the force at rest, which is not possible for a slack string;
- the clamp is ahead of the tip when the string begins to pull: the string was slack by that length;
- at rest, the tip is below the axis of the clamp by the deflection under that load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt
from typing import Any, Literal, TypeAlias

import numpy as np

from labpipe.errors import format_overrides
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints, average_blocks, drop_missing, median
from labpipe.records.curve import AT_REST, Aligned, Bending, Branch, Curve, Direction, Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote
from labpipe.results.bending import compute_prop_force
from labpipe.results.kinds import ReducedTest
from labpipe.results.measured_law import BendingErrors, BendingTest, TipPull, measure_bending
from labpipe.units import GRAVITY

MIN_SLACK_TRAVEL = 0.2e-3
"""Smallest travel of the clamp ahead of the tip, m, that shows a slack string."""
HANGING_FRACTION = 0.5
"""Fraction of the deflection under the load at the tip, above which the sag of a wire shows that it
hung."""
LEANING_FRACTION = 0.1
"""Fraction of the deflection under the load at the tip, above which the sag of a wire is reported;
smaller sags are usual, because wires are not quite straight."""
_N_MEAN_SAMPLES = 50
"""Number of samples over which a force is averaged."""

State: TypeAlias = Literal["taut", "slack", "off the wire", "part", "unknown"]
"""State of a string at rest, see `StringState`."""


@dataclass(frozen=True, slots=True)
class RestEvidence:
    """Evidence of a test on its string and wire at rest.

    Parameters
    ----------
    clamp_lead : m, travel of the clamp less deflection of the tip early in the first loading; NaN
        without a travel of the clamp
    sag : m, distance of the tip below the axis of the clamp at rest; NaN without a shape
    load_deflection : m, deflection of the first loading at which the force is the load at the tip;
        the largest deflection if the force stays below that load
    tip_load : N, the counterweight and 3/8 of the wire's weight
    force_error : N, standard error of `lowest_force` and `slack_force`
    lowest_force : N, lowest mean force after the first loading, less that at rest; NaN if unknown
    slack_force : N, force while the string is slack after the first loading, less that at rest; NaN
        if the string is never slack
    wire_load : N, 3/8 of the wire's weight, which `tip_load` includes
    """

    clamp_lead: float
    sag: float
    load_deflection: float
    tip_load: float
    force_error: float
    lowest_force: float = float("nan")
    slack_force: float = float("nan")
    wire_load: float = 0.0

    @property
    def load_description(self) -> str:
        """Description of the load at the tip, with its numbers."""
        weight, counterweight = 1e3 * self.tip_load, 1e3 * (self.tip_load - self.wire_load)
        if self.wire_load == 0.0:
            return format_sentence("results.counterweight", weight=weight)
        return format_sentence("results.load_at_tip", weight=weight, counterweight=counterweight)

    @property
    def load_name(self) -> str:
        """Short name of the load at the tip."""
        return "the counterweight" if self.wire_load == 0.0 else "that load"

    @property
    def sag_fraction(self) -> float:
        """Sag as a fraction of the deflection under the load at the tip, or NaN."""
        # Below this deflection, m, the sag is not distinguished from the direction of the clamp.
        min_deflection = 0.5e-3
        return self.sag / self.load_deflection if self.load_deflection >= min_deflection else np.nan

    @property
    def state(self) -> State:
        """State of the string at rest, from the most direct evidence."""
        taut_fraction, slack_fraction = 0.75, 0.25  # of the load at the tip
        straight_fraction = 0.25  # of the deflection under that load, as wires are slightly curved
        # If the string was under tension at rest, the force falls by more than drift and noise.
        min_loss = max(0.05 * self.tip_load, 5.0 * self.force_error)
        has_lost_tension = self.lowest_force < -min_loss
        is_unloaded = self.clamp_lead > MIN_SLACK_TRAVEL and not has_lost_tension
        if np.isfinite(self.slack_force):
            if -self.slack_force >= taut_fraction * self.tip_load:
                return "taut"
            if -self.slack_force > slack_fraction * self.tip_load:
                return "part"
            is_unloaded = True
        sag = self.sag_fraction
        if is_unloaded:
            if sag > HANGING_FRACTION:
                return "slack"
            return "off the wire" if abs(sag) <= LEANING_FRACTION else "unknown"
        if sag > HANGING_FRACTION:  # the string just reaches a hanging wire, or the wire is curved
            return "unknown" if has_lost_tension else "slack"
        return "taut" if has_lost_tension or abs(sag) <= straight_fraction else "unknown"

    @property
    def summary(self) -> str:
        """Sentence on the evidence."""
        facts = []
        if np.isfinite(self.sag):
            sag, reach, load = 1e3 * self.sag, 1e3 * self.load_deflection, self.load_name
            facts.append(format_sentence("results.tip_below", sag=sag, load=load, reach=reach))
        if np.isfinite(self.clamp_lead):
            facts.append(format_sentence("results.clamp_ahead", ahead=1e3 * self.clamp_lead))
        if np.isfinite(self.slack_force):
            facts.append(format_sentence("results.slackened", force=1e3 * self.slack_force))
        elif np.isfinite(self.lowest_force):
            facts.append(format_sentence("results.lowest_force", force=1e3 * self.lowest_force))
        return "; ".join(facts) or format_sentence("results.no_evidence")

    @property
    def bend_at_rest(self) -> str:
        """Sentence on a wire that was bent before the first loading, or an empty text."""
        state = self.state
        if state in ("taut", "off the wire"):
            return ""
        sag, lead, reach = 1e3 * self.sag, 1e3 * self.clamp_lead, 1e3 * self.load_deflection
        load = self.load_description
        if self.clamp_lead > MIN_SLACK_TRAVEL:
            below = "" if np.isnan(self.sag) else f", its tip {sag:.3g} mm below"
            return format_sentence("results.string_was_slack", ahead=lead, load=load, below=below)
        if state != "unknown" or self.sag_fraction > HANGING_FRACTION:
            return format_sentence("results.wire_hung", sag=sag, load=load, reach=reach)
        return ""


def collect_rest_evidence(
    aligned: Aligned | None,
    shape: Shape | None,
    curve: Curve,
    first_loading: Branch,
    counterweight: float,
    *,
    wire_load: float = 0.0,
) -> RestEvidence:
    """Collect the evidence of a test on its string and wire at rest.

    Parameters
    ----------
    aligned : signals of the test on one clock, or None
    shape : shape of the specimen in every frame, or None
    curve : force-deflection curve of the test
    first_loading : branch of the first loading
    counterweight : N, weight at the tip
    wire_load : N, part of the wire's weight that a prop at its tip carries, see
        `compute_prop_force`

    Returns
    -------
    The evidence, with NaN where the test shows none.
    """
    # In this range of deflections, m, the string pulls, and the clamp leads the tip by the slack.
    lead_range = (0.5e-3, 3e-3)
    n_blocks = 100
    tip_load = counterweight + wire_load
    samples = slice(first_loading.start, first_loading.stop)
    deflection = curve.displacement[samples]
    mean_deflection = average_blocks(deflection, n_blocks)
    mean_force = average_blocks(curve.force[samples], n_blocks)
    loaded_deflection = mean_deflection[mean_force >= tip_load]
    clamp_lead = sag = slack_force = lowest_force = float("nan")
    travel = None if aligned is None else aligned.series.get("travel")
    if travel is not None and len(travel.values) == len(curve.displacement):
        is_in_range = (deflection > lead_range[0]) & (deflection < lead_range[1])
        clamp_lead = median(drop_missing((travel.values[samples] - deflection)[is_in_range]))
        slack_force = median(_collect_slack_forces(travel.values, curve, first_loading))
    if shape is not None and len(shape.names):
        heights = shape.positions[shape.time < first_loading.start_time, :, 1]
        sag = median(drop_missing(heights[:, 0] - heights[:, -1]))
    rest_force = drop_missing(curve.force[: first_loading.start])
    later_force = drop_missing(curve.force[first_loading.stop :])
    if len(later_force) >= _N_MEAN_SAMPLES:
        lowest_force = float(average_blocks(later_force, len(later_force) // _N_MEAN_SAMPLES).min())
    rest_scatter = float(rest_force.std()) if len(rest_force) else 0.0
    return RestEvidence(
        clamp_lead=clamp_lead,
        sag=sag,
        load_deflection=float([*loaded_deflection, np.nanmax(mean_deflection)][0]),
        tip_load=tip_load,
        lowest_force=lowest_force,
        slack_force=slack_force,
        force_error=rest_scatter / sqrt(min(len(rest_force), _N_MEAN_SAMPLES) or 1),
        wire_load=wire_load,
    )


def list_rest_notes(test: str, evidence: RestEvidence) -> Iterator[QualityNote]:
    """Yield a note if the wire of a test was not straight at rest, or if that is unknown.

    Parameters
    ----------
    test : name of the test
    evidence : evidence of the test on string and wire at rest
    """
    if np.isnan([evidence.clamp_lead, evidence.sag]).all():
        yield QualityNote.of("results.rest_unknown", test)
    elif evidence.sag > LEANING_FRACTION * evidence.load_deflection:
        sag, load = 1e3 * evidence.sag, evidence.load_name
        yield QualityNote.of("results.wire_not_straight", test, sag=sag, load=load)


def _collect_slack_forces(travel: Floats, curve: Curve, first_loading: Branch) -> Floats:
    """Collect mean forces after the first loading while the tip does not follow the clamp, N."""
    max_movement_ratio, min_stretches = 0.3, 2  # movement of the tip over that of the clamp
    forces: list[float] = []
    for branch in curve.branches:
        if branch.start < first_loading.stop:
            continue
        means = _average_stretches(travel, curve, branch)
        clamp_movement, tip_movement = np.abs(np.diff(means[:, :2], axis=0)).T
        slack_forces = means[1:, 2][tip_movement < max_movement_ratio * clamp_movement].tolist()
        if len(slack_forces) >= min_stretches:
            # In the stretch at the largest deflection, the string may still pull.
            is_unloading = branch.direction is Direction.UNLOADING
            forces += slack_forces[1:] if is_unloading else slack_forces[:-1]
    return np.array(forces)


def _average_stretches(travel: Floats, curve: Curve, branch: Branch) -> Floats:
    """Average travel, deflection and force over stretches of equal sample counts, shape (n, 3).

    The mean travel in a stretch is a quarter of a millimetre.
    """
    stretch_travel = 0.25e-3  # m
    samples = slice(branch.start, branch.stop)
    rows = np.column_stack([travel[samples], curve.displacement[samples], curve.force[samples]])
    rows = rows[np.isfinite(rows).all(axis=1)]
    n_stretches = int(np.ptp(rows[:, 0]) / stretch_travel) if len(rows) else 0
    if n_stretches < 2 or len(rows) < 2 * n_stretches:
        return np.zeros((1, 3))
    return np.array([stretch.mean(axis=0) for stretch in np.array_split(rows, n_stretches)])


@dataclass(frozen=True, slots=True)
class StringState:
    """Assumed state of the string at rest.

    Parameters
    ----------
    state : ``taut``: the string carried all of the load at the tip; ``slack``: the string carried
        nothing, and the wire hung; ``off the wire``: the string carried nothing, yet the wire did
        not hang; ``part``: the string carried the measured part of the load; ``unknown``: the test
        does not show the state
    tension : N, tension of the string at rest
    weight : N, counterweight at the tip; 0 if it did not pull at the tip
    alternative_tension : N, another tension at rest that the intervals include, or None
    evidence : sentence on the state and its evidence, with numbers
    """

    state: State
    tension: float
    weight: float
    alternative_tension: float | None
    evidence: str

    @property
    def note(self) -> QualityNote:
        """Quality note for the results of the test."""
        if self.state == "unknown":
            return QualityNote.of("results.string_not_known", "rig.string", why=self.evidence)
        return QualityNote.of("results.string_at_rest", "rig.string", why=self.evidence)


def decide_string_state(evidence: RestEvidence) -> StringState:
    """Decide which load the string carried at rest.

    Parameters
    ----------
    evidence : evidence of the test on string and wire at rest

    Returns
    -------
    The state, with the alternative tension if the evidence is not sufficient.
    """
    tip_load, state = evidence.tip_load, evidence.state
    context = {"load": evidence.load_description, "facts": evidence.summary}
    tension = {"taut": tip_load, "part": -evidence.slack_force}.get(state, 0.0)
    weight, alternative = tip_load - evidence.wire_load, None
    if state == "unknown":
        is_slack = evidence.clamp_lead > MIN_SLACK_TRAVEL
        tension, alternative = (0.0, tip_load) if is_slack else (tip_load, 0.0)
        assumed = "all of it" if tension else "nothing"
        remedy = format_overrides("rig.string.at_rest", "taut")
        why = format_sentence("results.string_unknown", **context, assumed=assumed, remedy=remedy)
    elif state == "part":
        # The standard error of the law from an alternative is 1 / sqrt(3) of the change.
        alternative = tension - sqrt(3.0) * evidence.force_error
        why = format_sentence("results.string_carried_part", **context, tension=1e3 * tension)
    elif state == "off the wire":
        weight, why = 0.0, format_sentence("results.string_off_the_wire", facts=context["facts"])
    elif state == "taut":
        why = format_sentence("results.string_was_taut", **context)
    else:
        why = format_sentence("results.string_carried_nothing", **context)
    return StringState(state, tension, weight, alternative, why)


def make_stated_state(
    at_rest: Literal["taut", "slack"], weight: float, wire_load: float = 0.0
) -> StringState:
    """Make the state of a string at rest that the protocol states.

    Parameters
    ----------
    at_rest : value of ``rig.string.at_rest`` in the protocol
    weight : N, counterweight at the tip
    wire_load : N, part of the wire's weight that a prop at its tip carries
    """
    tension = weight + wire_load if at_rest == "taut" else 0.0
    full_load = "the counterweight" + " and 3/8 of the wire's weight" * (wire_load > 0.0)
    carried = full_load if at_rest == "taut" else "nothing"
    why = format_sentence("results.string_stated", state=at_rest, carried=carried)
    return StringState(at_rest, tension, weight, None, why)


def measure_moment_curvature(test: ReducedTest) -> tuple[Bending | Failure | None, list[Finding]]:
    """Measure the moment-curvature law of a test, and note the assumptions.

    Parameters
    ----------
    test : reduced test with curve and shape

    Returns
    -------
    bending : cloud and law, or the reason why there are none; None without curve, shape or loading
    findings : notes on the assumptions, and on the data of cloud and law
    """
    curve, shape, loading = test.curve, test.shape, test.first_loading
    if curve is None or shape is None or loading is None:
        return None, []
    if not test.setup.has_markers:
        return Failure.of("results.no_marker_block"), []
    start, stop = test.signals.zero_stretches["deflection"]
    is_at_rest = np.asarray((shape.time >= start) & (shape.time <= stop), dtype=np.bool_)
    pull, alternative_tension, findings = _make_tip_pull(test, curve, shape, loading, is_at_rest)
    force = np.interp(shape.time, curve.time, curve.force, left=np.nan, right=np.nan)
    force_at_rest = drop_missing(force[is_at_rest])
    branch_indices: Ints = np.full(len(shape.time), AT_REST, dtype=np.int64)
    cycles: Ints = np.zeros(len(shape.time), dtype=np.int64)
    for index, branch in enumerate(curve.branches):
        is_in_branch = (shape.time >= branch.start_time) & (shape.time < branch.stop_time)
        branch_indices[is_in_branch], cycles[is_in_branch] = index, branch.cycle
    bending_test = BendingTest(
        shape=shape,
        force=force,
        branch=branch_indices,
        cycle=cycles,
        first_branch=curve.branches.index(loading),
        is_at_rest=is_at_rest,
        centre_offset=test.setup.centre_offset,
        free_tip=test.setup.free_tip,
        pull=pull,
        errors=BendingErrors(
            force_noise=float(force_at_rest.std()) if len(force_at_rest) else 0.0,
            force_zero=test.force.zero_error,
            force_scale=test.force.relative_error,
            end_position=test.setup.offset_uncertainty,
            alternative_tension=alternative_tension,
            centre_offset=test.setup.centre_uncertainty,
        ),
    )
    try:
        bending = measure_bending(bending_test)
    except ValueError as error:
        return Failure("no_moment_curvature", str(error)), findings
    if test.setup.mass_per_length is None:
        findings.append(Finding.of("results.weight_not_stated", "specimen.mass_per_length"))
    cloud, law, law_clause = bending.cloud, bending.law, ""
    if law is not None:
        facts = {"largest": law.curvature[-1], "residual": 1e6 * law.residual, "floor": law.floor}
        law_clause = format_sentence("results.law_of_frames", frames=law.n_frames, **facts)
    cloud_facts: dict[str, Any] = {"points": cloud.curvature.size, "frames": cloud.frames_per_mean}
    cloud_facts |= {"places": len(cloud.arc_length), "law": law_clause}
    finding = Finding.of("results.moment_curvature", "shape", **cloud_facts)
    return bending, [*findings, finding]


def _make_tip_pull(
    test: ReducedTest, curve: Curve, shape: Shape, loading: Branch, is_at_rest: Flags
) -> tuple[TipPull, float | None, list[Finding]]:
    """Make the pull at the tip, an alternative tension at rest (N) or None, and findings."""
    # A power series in arc length / length has the sum of its coefficients as its value at the tip.
    tip_x = float(np.nanmean(shape.coefficients[is_at_rest], axis=0)[0].sum())
    string = test.setup.string
    self_weight = GRAVITY * (test.setup.mass_per_length or 0.0)
    wire_load = compute_prop_force(self_weight, shape.length)
    if string is None:
        finding = Finding.of("results.force_taken_normal", "rig.string")
        return TipPull(None, 0.0, wire_load, tip_x, self_weight), None, [finding]
    weight = GRAVITY * string.counterweight
    if weight + wire_load == 0.0:
        return TipPull(string.length, 0.0, 0.0, tip_x), None, []
    if string.at_rest != "by-data":
        state = make_stated_state(string.at_rest, weight, wire_load)
    else:
        records = test.aligned, shape, curve, loading
        state = decide_string_state(collect_rest_evidence(*records, weight, wire_load=wire_load))
    pull = TipPull(string.length, state.weight, state.tension, tip_x, self_weight)
    return pull, state.alternative_tension, [Finding(state.note)]
