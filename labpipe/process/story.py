"""The story of one test, from its recordings to its results, without touching a file.

Read this page first. Each step is a pure function that takes a frozen record and gives the next one
and what it found:

recordings -> signals -> prepared (steps: zeros, filters, shape) -> branches and clocks -> curve ->
corrected curve -> results

`ReducedTest` is the last record; every result is computed from it alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date

from labpipe.process.calibrated_signals import Prepared, calibrated, check_channels
from labpipe.process.certificates import check_due
from labpipe.process.clock_joining import join_clocks
from labpipe.process.consistency import check_consistency
from labpipe.process.curve_corrections import (
    aligned,
    correct_curve,
    put_together,
    without_outliers,
)
from labpipe.process.motion import Motion, branches_between, strokes_of
from labpipe.process.sanity_checks import (
    check_mid_span,
    check_rest,
    check_rig,
    check_signs,
    cut_at,
    file_is_cut,
    holds,
    is_full_stroke,
)
from labpipe.process.steps import all_steps
from labpipe.process.zeros import check_begin, check_break, check_zeros, use_rest_there_is
from labpipe.protocol.schema import Branches, CurveBlock, Protocol
from labpipe.records.curve import FittedLine
from labpipe.records.declarations import FitShape
from labpipe.records.limits import Limits
from labpipe.records.quality import Finding, Findings
from labpipe.records.recording import Recording
from labpipe.records.result import Result, Status
from labpipe.records.signals import Clocks
from labpipe.results.beam import BendingStiffness
from labpipe.results.kinds import to_result
from labpipe.results.reduced_test import LoadString, ReducedTest, Setup
from labpipe.results.shapes import MomentCurvature
from labpipe.uncertainty.intervals import Measured


@dataclass(frozen=True, slots=True, eq=False)
class ReductionOfTest:
    """What a test comes to.

    Parameters
    ----------
    reduced_test : with every stage that was reached, and all findings
    results : in the protocol's order
    lines : the straight lines that stiffnesses were read from
    """

    reduced_test: ReducedTest
    results: tuple[Result, ...]
    lines: tuple[FittedLine, ...]


def reduce_recordings(
    recordings: Mapping[str, Recording], protocol: Protocol, *, tested: date | None = None
) -> ReductionOfTest:
    """Reduce the recordings of one test to stages and results.

    Parameters
    ----------
    recordings : by role, their channels named and in SI units as the protocol says
    protocol : resolved
    tested : day of the test, for the certificates of its instruments; None where it is not known

    Raises
    ------
    ProcessingError
        If a recording lacks what a step cannot do without, such as the clamp's rigid body.
    """
    prepared, found = calibrated(recordings, protocol)
    findings = Findings() + found + check_channels(prepared.signals, protocol)
    findings += check_due(protocol, tested)
    prepared, found = all_steps(prepared, protocol)
    findings += found
    if protocol.curve is None or protocol.branches is None:
        return with_results(_reduced_test(prepared, Clocks(), protocol, findings), protocol)
    seed = seed_of(recordings)
    prepared, motion, found = split_motion(prepared, protocol, protocol.branches)
    findings += found
    prepared, found = at_rest(prepared, motion, protocol.limits)
    findings += found
    findings = checked(prepared, motion, protocol, findings)
    test = replace(_reduced_test(prepared, motion.clocks, protocol, findings), seed=seed)
    return with_results(with_curve(test, motion, protocol, protocol.curve), protocol)


def seed_of(recordings: Mapping[str, Recording]) -> bytes:
    """Make a seed from what was recorded, so that the same files are drawn alike everywhere.

    Parameters
    ----------
    recordings : by role; a thousand samples of each channel count, as they were read
    """
    digest = hashlib.sha256()
    for role in sorted(recordings):
        recording = recordings[role]
        values = [channel.values for channel in recording.channels]
        values += [] if recording.markers is None else [recording.markers.positions]
        for value in values:
            digest.update(value[:: max(1, len(value) // 1000)].tobytes())
    return digest.digest()


def split_motion(
    prepared: Prepared, protocol: Protocol, block: Branches
) -> tuple[Prepared, Motion, list[Finding]]:
    """Split the motion where it turns, and join the clocks there.

    Parameters
    ----------
    prepared : by all steps
    protocol : how clocks are joined
    block : which channel is the motion, and what a stroke is
    """
    signals = prepared.signals
    motion = signals.raw[block.channel]
    strokes, found = strokes_of(motion, block)
    fit, turns, more = join_clocks(signals, protocol.align, motion, strokes)
    clocks = Clocks(signals.raw[signals.displacement].clock, force=fit)
    branches = branches_between(motion, strokes, turns)
    found += more
    if prepared.span is not None:
        from labpipe.process.span_steps import align_cameras  # loaded by these tests alone

        least = block.min_stroke
        prepared, others, more = align_cameras(prepared, motion, strokes, min_stroke=least)
        clocks = replace(clocks, others=others)
        found += more
    return prepared, Motion(motion, branches, clocks), found


def at_rest(prepared: Prepared, motion: Motion, limits: Limits) -> tuple[Prepared, list[Finding]]:
    """Look at what was taken at rest again, now that it is known when the machine rests."""
    prepared, found = check_mid_span(prepared, motion, limits)
    signals, more = use_rest_there_is(prepared.signals, motion)
    return replace(prepared, signals=signals), [*found, *more]


def checked(prepared: Prepared, motion: Motion, protocol: Protocol, findings: Findings) -> Findings:
    """Add what a careful person would see before any number is read.

    Parameters
    ----------
    prepared, motion : of the test
    protocol : what is expected of rig and specimen
    findings : so far
    """
    signals, is_blocked = prepared.signals, findings.blocked is not None
    findings += check_rig(signals, prepared.shape, protocol, motion.branches, is_blocked=is_blocked)
    findings += holds(signals.displacement, motion, protocol.limits)
    findings += check_rest(signals, motion, protocol.limits)
    reversed_signs = [] if is_blocked else check_signs(signals, motion, protocol)
    if any(reversed_sign.code == "force_reversed" for reversed_sign in reversed_signs):
        findings = findings.without("force_negative")  # its cause is found
    return findings + reversed_signs


def with_curve(
    test: ReducedTest, motion: Motion, protocol: Protocol, block: CurveBlock
) -> ReducedTest:
    """Put force and displacement on one clock, and correct what they show.

    Parameters
    ----------
    test : without a curve
    motion : its branches
    protocol : for the stroke of the rig
    block : the corrections
    """
    ends = cut_at(
        test.signals,
        motion,
        is_full_stroke=is_full_stroke(motion.signal, protocol.rig.stroke),
        is_cut_file=file_is_cut(test.findings),
        limits=protocol.limits,
    )
    test = replace(test, cut_at=ends)
    if test.findings.blocked:
        return test
    unfiltered, found = without_outliers(test.signals)
    test = replace(test, aligned=aligned(test), unfiltered=unfiltered)
    curve, more = put_together(test, unfiltered, motion)
    findings = test.findings + found + more
    if curve is None:
        return replace(test, findings=findings)
    findings += check_zeros(test.signals, test.clocks, curve, findings, protocol.limits)
    findings += check_consistency(test.signals.force, curve, protocol.limits)
    test, found = correct_curve(replace(test, curve=curve), block)
    findings += found
    has_slack = isinstance(test.slack, Measured)
    findings += check_begin(test.signals, motion, has_slack=has_slack)
    if test.curve is not None:
        findings += check_break(test.signals.force, test.curve, test.failure, protocol.limits)
    return replace(test, findings=findings)


def _reduced_test(
    prepared: Prepared, clocks: Clocks, protocol: Protocol, findings: Findings
) -> ReducedTest:
    specimen, words, string = protocol.specimen, protocol.markers, protocol.rig.string
    sizes = {} if specimen.section is None else vars(specimen.section)
    setup = Setup(
        length=specimen.length,
        span=specimen.span,
        mass_per_length=specimen.mass_per_length,
        section={name: size for name, size in sizes.items() if size is not None},
        uncertainties=_uncertainties(protocol),
        string=None
        if string is None
        else LoadString(string.length, string.counterweight, string.at_rest),
        has_markers=words is not None,
        centre_offset=0.0 if words is None else words.centre_offset,
        offset_uncertainty=0.0 if words is None else words.offset_uncertainty,
        centre_uncertainty=0.0 if words is None else words.centre_uncertainty,
        compliance_stated=protocol.curve is not None and protocol.curve.compliance is not None,
        limits=protocol.limits,
        free_tip=any(isinstance(x, FitShape) and x.tip == "free" for x in protocol.steps),
    )
    return ReducedTest(
        signals=prepared.signals,
        clocks=clocks,
        setup=setup,
        shape=prepared.shape,
        span=prepared.span,
        findings=findings,
    )


def _uncertainties(protocol: Protocol) -> dict[str, float]:
    """Of the sizes of the specimen; as a bending stiffness says, where the specimen does not."""
    said = protocol.specimen.uncertainty
    of_results = {
        entry.length: entry.length_uncertainty
        for entry in protocol.results
        if isinstance(entry, BendingStiffness) and entry.length_uncertainty is not None
    }
    return of_results | (said.stated if said is not None else {})


def with_results(test: ReducedTest, protocol: Protocol) -> ReductionOfTest:
    """Compute the results that a protocol asks for.

    Parameters
    ----------
    test : with all that was found
    protocol : its results, in order
    """
    if any(isinstance(entry, MomentCurvature) for entry in protocol.results):
        from labpipe.results.moment_curvature import measured  # loaded by these tests alone

        bending, found = measured(test)
        test = replace(test, bending=bending, findings=test.findings + found)
    results, lines = list[Result](), list[FittedLine]()
    for entry in protocol.results:
        computed = entry.compute(test)
        made = [to_result(test, number) for number in computed.numbers]
        if any(each.status is Status.FAILED for each in made):
            from labpipe.process.remedies import with_remedy  # most tests do without

            made = [with_remedy(each, entry, test, protocol) for each in made]
        results += made
        lines += computed.lines
        test = replace(
            test,
            stiffnesses={**test.stiffnesses, **computed.stiffnesses},
            findings=test.findings + computed.findings,
        )
    return ReductionOfTest(test, tuple(results), tuple(lines))
