"""Measure the moment-curvature law of a test, and find the state of its string at rest.

A string that is taut at rest carries the load at the tip: the counterweight, and 3/8 of the weight
of the wire, as a prop at the tip would. Under a slack string the wire carries that load itself: it
hangs, and is bent downwards before it is bent upwards. Four observations distinguish the two:

- the string becomes slack in a later cycle, and the tip moves with the clamp. The force is then
  below that at rest by the tension at rest;
- the force falls below that at rest, which is not possible for a slack string;
- the clamp is ahead of the tip when the string begins to pull: the string was slack by that length;
- the tip is below the axis of the clamp at rest by the deflection under that load.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from math import sqrt
from typing import Literal, TypeAlias

import numpy as np

from labpipe.errors import format_overrides
from labpipe.messages import format_sentence
from labpipe.records.arrays import Flags, Floats, Ints, average_blocks, median
from labpipe.records.curve import AT_REST, Aligned, Bending, Branch, Curve, Direction, Shape
from labpipe.records.estimates import Failure
from labpipe.records.quality import Finding, QualityNote
from labpipe.results.bending import compute_prop_force
from labpipe.results.kinds import ReducedTest
from labpipe.results.measured_law import BendingErrors, BendingTest, TipPull, measure_bending
from labpipe.units import GRAVITY

MIN_SLACK_TRAVEL = 0.2e-3
"""m; a string was slack if the clamp is ahead of the tip by more than this."""
HANGING_SHARE, LEANING_SHARE = 0.5, 0.1
"""Shares of the deflection under the load. A wire with a tip lower than the first share hung; one
lower than the second share is reported, since wires are not quite straight."""
_MEAN_SAMPLES = 50
"""Number of samples of a mean force."""

State: TypeAlias = Literal["taut", "slack", "off the wire", "part", "unknown"]


@dataclass(frozen=True, slots=True)
class RestEvidence:
    """Evidence of a test on its string and wire at rest.

    Parameters
    ----------
    clamp_lead : m, travel of the clamp less deflection of the tip early in the first loading; NaN
        without a travel of the clamp
    sag : m, of the tip below the axis of the clamp at rest; NaN without a shape
    reach : m, deflection at which the force is the load at the tip, or the largest
    weight : N, load at the tip: the counterweight and 3/8 of the wire's weight
    error : N, standard error of the next two forces
    lowest_force : N, lowest mean force after the first loading; 0 at rest; NaN if unknown
    slack_force : N, force while the string is slack after the first loading; 0 at rest; NaN if it
        never is
    own_weight : N, part of `weight` that is from the wire
    """

    clamp_lead: float
    sag: float
    reach: float
    weight: float
    error: float
    lowest_force: float = float("nan")
    slack_force: float = float("nan")
    own_weight: float = 0.0

    @property
    def load(self) -> str:
        """Return a description of the load at the tip, with its numbers."""
        weight, counterweight = 1e3 * self.weight, 1e3 * (self.weight - self.own_weight)
        if self.own_weight == 0.0:
            return format_sentence("results.counterweight", weight=weight)
        return format_sentence("results.load_at_tip", weight=weight, counterweight=counterweight)

    @property
    def load_name(self) -> str:
        """Return a short name of the load."""
        return "the counterweight" if self.own_weight == 0.0 else "that load"

    @property
    def share(self) -> float:
        """Return the sag as a share of the deflection under the load at the tip, or NaN."""
        min_reach = 0.5e-3  # m, to differ from the direction of the clamp
        return self.sag / self.reach if self.reach >= min_reach else float("nan")

    @property
    def tension(self) -> float:
        """Return the tension at rest, N, from the force of the slack string, or NaN."""
        return -self.slack_force

    @property
    def has_lost_tension(self) -> bool:
        """Return whether the force falls below that at rest: the string was then under tension."""
        return self.lowest_force < -max(0.05 * self.weight, 5.0 * self.error)

    @property
    def state(self) -> State:
        """Return the state of the string, from the most direct evidence."""
        all_share, none_share, straight_share = 0.75, 0.25, 0.25  # wires are curled
        carried_nothing = self.clamp_lead > MIN_SLACK_TRAVEL and not self.has_lost_tension
        if np.isfinite(self.slack_force):
            if self.tension >= all_share * self.weight:
                return "taut"
            if self.tension > none_share * self.weight:
                return "part"
            carried_nothing = True
        if carried_nothing:
            if self.share > HANGING_SHARE:
                return "slack"
            return "off the wire" if abs(self.share) <= LEANING_SHARE else "unknown"
        if self.share > HANGING_SHARE:  # the string just reaches a hanging wire, or it is curled
            return "unknown" if self.has_lost_tension else "slack"
        return "taut" if self.has_lost_tension or abs(self.share) <= straight_share else "unknown"

    @property
    def summary(self) -> str:
        """Return the evidence as a sentence."""
        facts = []
        if np.isfinite(self.sag):
            sag, reach, load = 1e3 * self.sag, 1e3 * self.reach, self.load_name
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
        """Return a sentence on a wire that was bent before the first loading, or an empty text."""
        state = self.state
        if state in ("taut", "off the wire"):
            return ""
        sag, lead, reach = 1e3 * self.sag, 1e3 * self.clamp_lead, 1e3 * self.reach
        if self.clamp_lead > MIN_SLACK_TRAVEL:
            below = "" if np.isnan(self.sag) else f", its tip {sag:.3g} mm below"
            return format_sentence(
                "results.string_was_slack", ahead=lead, load=self.load, below=below
            )
        if state != "unknown" or self.share > HANGING_SHARE:
            return format_sentence("results.wire_hung", sag=sag, load=self.load, reach=reach)
        return ""


def collect_rest_evidence(
    aligned: Aligned | None,
    shape: Shape | None,
    curve: Curve,
    first: Branch,
    weight: float,
    *,
    own_weight: float = 0.0,
) -> RestEvidence:
    """Collect the evidence of a test on its string and wire at rest.

    Parameters
    ----------
    aligned, shape : aligned signals and shape of the test, or None
    curve, first : curve of the test, and its first loading branch
    weight : N, of the counterweight
    own_weight : N, part of the wire's weight on a prop at its tip: `compute_prop_force`
    """
    # Deflections, m, while the string pulls, for the distance of the clamp ahead of the tip.
    early_deflections = (0.5e-3, 3e-3)
    n_blocks = 100
    weight += own_weight
    part = slice(first.start, first.stop)
    path = curve.displacement[part]
    deflection, force = (average_blocks(values, n_blocks) for values in (path, curve.force[part]))
    reached = deflection[force >= weight]
    clamp_lead = sag = slack_force = lowest_force = float("nan")
    travel = None if aligned is None else aligned.series.get("travel")
    if travel is not None and len(travel.values) == len(curve.displacement):
        is_early = (path > early_deflections[0]) & (path < early_deflections[1])
        clamp_lead = median(_select_finite((travel.values[part] - path)[is_early]))
        slack_force = median(_read_slack_forces(travel.values, curve, first))
    if shape is not None and len(shape.names):
        heights = shape.positions[shape.time < first.start_time, :, 1]
        sag = median(_select_finite(heights[:, 0] - heights[:, -1]))
    stretches = slice(first.start), slice(first.stop, None)
    at_rest, loading = (_select_finite(curve.force[stretch]) for stretch in stretches)
    if len(loading) >= _MEAN_SAMPLES:
        lowest_force = float(average_blocks(loading, len(loading) // _MEAN_SAMPLES).min())
    scatter = float(at_rest.std()) if len(at_rest) else 0.0
    return RestEvidence(
        clamp_lead=clamp_lead,
        sag=sag,
        reach=float(reached[0]) if len(reached) else float(np.nanmax(deflection)),
        weight=weight,
        lowest_force=lowest_force,
        slack_force=slack_force,
        error=scatter / sqrt(min(len(at_rest), _MEAN_SAMPLES) or 1),
        own_weight=own_weight,
    )


def _select_finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def list_rest_notes(test: str, evidence: RestEvidence) -> Iterator[QualityNote]:
    """Yield notes on a wire that is assumed to have been straight at rest."""
    if np.isnan([evidence.clamp_lead, evidence.sag]).all():
        yield QualityNote.of("results.rest_unknown", test)
    elif evidence.sag > LEANING_SHARE * evidence.reach:
        sag, load = 1e3 * evidence.sag, evidence.load_name
        yield QualityNote.of("results.wire_not_straight", test, sag=sag, load=load)


def _read_slack_forces(travel: Floats, curve: Curve, first: Branch) -> Floats:
    """Return forces after the first loading while the tip moves with the clamp, N."""
    max_following_share, min_stretches = 0.3, 2
    forces: list[float] = []
    for branch in curve.branches:
        if branch.start < first.stop:
            continue
        means = _average_stretches(travel, curve, branch)
        movements = np.abs(np.diff(means, axis=0))
        slack = means[1:, 2][movements[:, 1] < max_following_share * movements[:, 0]].tolist()
        if len(slack) >= min_stretches:  # the string may still pull in the first or last one
            forces += slack[1:] if branch.direction is Direction.UNLOADING else slack[:-1]
    return np.array(forces)


def _average_stretches(travel: Floats, curve: Curve, branch: Branch) -> Floats:
    """Return means of travel, deflection and force over about 0.25 mm of travel, shape (n, 3)."""
    part = slice(branch.start, branch.stop)
    columns = np.column_stack([travel[part], curve.displacement[part], curve.force[part]])
    columns = columns[np.isfinite(columns).all(axis=1)]
    count = int(np.ptp(columns[:, 0]) / 0.25e-3) if len(columns) else 0
    if count < 2 or len(columns) < 2 * count:
        return np.zeros((1, 3))
    return np.array([block.mean(axis=0) for block in np.array_split(columns, count)])


@dataclass(frozen=True, slots=True)
class StringState:
    """Assumed state of the string at rest.

    Parameters
    ----------
    state : ``taut``: it carried all of the load; ``slack``: nothing, and the wire hung;
        ``off the wire``: nothing, yet the wire did not hang; ``part``: a part of it, as measured;
        ``unknown``: not known from the test
    tension : N, in the string at rest
    weight : N, of the counterweight; 0 if it did not pull at the tip
    alternative_tension : N, another tension at rest that the intervals include, or None
    evidence : a sentence, with the numbers
    """

    state: State
    tension: float
    weight: float
    alternative_tension: float | None
    evidence: str

    @property
    def note(self) -> QualityNote:
        """Return the note for the results."""
        is_unknown = self.state == "unknown"
        return QualityNote.of(
            "results.string_not_known" if is_unknown else "results.string_at_rest",
            "rig.string",
            why=self.evidence,
        )


def decide_string_state(evidence: RestEvidence) -> StringState:
    """Decide from the evidence what the string carried at rest.

    Parameters
    ----------
    evidence : the evidence

    Returns
    -------
    The state, with the alternative tension if the evidence is not sufficient.
    """
    full, state, load, facts = evidence.weight, evidence.state, evidence.load, evidence.summary
    carried = {"taut": full, "part": evidence.tension}.get(state, 0.0)
    weight, alternative = full - evidence.own_weight, None
    if state == "unknown":
        is_slack = evidence.clamp_lead > MIN_SLACK_TRAVEL
        carried, alternative = (0.0, full) if is_slack else (full, 0.0)
        assumed = "all of it" if carried else "nothing"
        remedy = format_overrides("rig.string.at_rest", "taut")
        why = format_sentence(
            "results.string_unknown", load=load, assumed=assumed, facts=facts, remedy=remedy
        )
    elif state == "part":
        alternative = carried - sqrt(3.0) * evidence.error  # a rectangle counts by 1 / sqrt(3)
        tension = 1e3 * carried
        why = format_sentence(
            "results.string_carried_part", tension=tension, load=load, facts=facts
        )
    elif state == "off the wire":
        weight, why = 0.0, format_sentence("results.string_off_the_wire", facts=facts)
    else:
        why = format_sentence(
            "results.string_was_taut" if state == "taut" else "results.string_carried_nothing",
            load=load,
            facts=facts,
        )
    return StringState(state, carried, weight, alternative, why)


def make_stated_state(
    at_rest: Literal["taut", "slack"], weight: float, own_weight: float = 0.0
) -> StringState:
    """Return the state of a string at rest as stated in the protocol.

    Parameters
    ----------
    at_rest : value of ``rig.string.at_rest``
    weight : N, of the counterweight
    own_weight : N, part of the wire's weight on a prop at its tip
    """
    tension = weight + own_weight if at_rest == "taut" else 0.0
    full_load = "the counterweight" + " and 3/8 of the wire's weight" * (own_weight > 0.0)
    carried = full_load if at_rest == "taut" else "nothing"
    why = format_sentence("results.string_stated", state=at_rest, carried=carried)
    return StringState(at_rest, tension, weight, None, why)


def measure_moment_curvature(test: ReducedTest) -> tuple[Bending | Failure | None, list[Finding]]:
    """Measure the moment-curvature law of a test, and note the assumptions.

    Parameters
    ----------
    test : a test with curve and shape

    Returns
    -------
    The law, or the reason why there is none (None without curve, shape or loading); the findings.
    """
    curve, shape, first = test.curve, test.shape, test.first_loading
    if curve is None or shape is None or first is None:
        return None, []
    if not test.setup.has_markers:
        return Failure.of("results.no_marker_block"), []
    start, stop = test.signals.zero_stretches["deflection"]
    is_at_rest = np.asarray((shape.time >= start) & (shape.time <= stop), dtype=np.bool_)
    pull, alternative_tension, notes = _make_tip_pull(test, curve, shape, first, is_at_rest)
    force = np.interp(shape.time, curve.time, curve.force, left=np.nan, right=np.nan)
    force_at_rest = _select_finite(force[is_at_rest])
    branch: Ints = np.full(len(shape.time), AT_REST, dtype=np.int64)
    cycle: Ints = np.zeros(len(shape.time), dtype=np.int64)
    for number, part in enumerate(curve.branches):
        in_branch = (shape.time >= part.start_time) & (shape.time < part.stop_time)
        branch[in_branch], cycle[in_branch] = number, part.cycle
    errors = BendingErrors(
        force_noise=float(force_at_rest.std()) if len(force_at_rest) else 0.0,
        force_zero=test.force.zero_error,
        force_scale=test.force.relative_error,
        offset=test.setup.offset_uncertainty,
        other_tension_at_rest=alternative_tension,
        centre=test.setup.centre_uncertainty,
    )
    frames = BendingTest(
        shape=shape,
        force=force,
        branch=branch,
        cycle=cycle,
        first=curve.branches.index(first),
        rest=is_at_rest,
        centre_offset=test.setup.centre_offset,
        free_tip=test.setup.free_tip,
        pull=pull,
        errors=errors,
    )
    try:
        bending = measure_bending(frames)
    except ValueError as error:
        return Failure("no_moment_curvature", str(error)), notes
    if test.setup.mass_per_length is None:
        notes.append(Finding.of("results.weight_not_stated", "specimen.mass_per_length"))
    cloud, law, law_text = bending.cloud, bending.law, ""
    if law is not None:
        law_text = format_sentence(
            "results.law_of_frames",
            frames=law.n_frames,
            largest=law.curvature[-1],
            residual=1e6 * law.residual,
            floor=law.floor,
        )
    note = Finding.of(
        "results.moment_curvature",
        "shape",
        points=cloud.curvature.size,
        frames=cloud.frames_per_mean,
        places=len(cloud.arc_length),
        law=law_text,
    )
    return bending, [*notes, note]


def _make_tip_pull(
    test: ReducedTest, curve: Curve, shape: Shape, first: Branch, is_at_rest: Flags
) -> tuple[TipPull, float | None, list[Finding]]:
    """Return the pull at the tip, another possible tension at rest, and a finding."""
    # The last point of a power series in arc length / length is the sum of its coefficients.
    tip = float(np.nanmean(shape.coefficients[is_at_rest], axis=0)[0].sum())
    string = test.setup.string
    self_weight = GRAVITY * (test.setup.mass_per_length or 0.0)
    own_weight = compute_prop_force(self_weight, shape.length)
    if string is None:
        note = Finding.of("results.force_taken_normal", "rig.string")
        return TipPull(None, 0.0, own_weight, tip, self_weight), None, [note]
    weight = GRAVITY * string.counterweight
    if weight + own_weight == 0.0:
        return TipPull(string.length, 0.0, 0.0, tip), None, []
    if string.at_rest != "by-data":
        state = make_stated_state(string.at_rest, weight, own_weight)
    else:
        state = decide_string_state(
            collect_rest_evidence(test.aligned, shape, curve, first, weight, own_weight=own_weight)
        )
    pull = TipPull(string.length, state.weight, state.tension, tip, self_weight)
    return pull, state.alternative_tension, [Finding(state.note)]
