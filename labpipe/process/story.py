"""Reduce one test from recordings to results, without access to files.

Read this module first. Each stage is a function without side effects, which returns an immutable
record and findings:

recordings -> signals -> prepared test (zeros, filters, shape) -> branches and clocks -> curve ->
corrected curve -> results

`ReducedTest` is the last record. Every result is computed from it alone.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from datetime import date

from labpipe.errors import format_overrides
from labpipe.messages import format_sentence
from labpipe.process.consistency import CheckedRecord, check_consistency, check_force_after_break
from labpipe.process.curve_corrections import (
    align_signals,
    bridge_outliers,
    build_curve,
    correct_curve,
)
from labpipe.process.motion import Motion, align_clocks, find_motion_strokes, split_at_turns
from labpipe.process.sanity_checks import (
    check_answers,
    check_calibration_due,
    check_mid_span,
    check_signals,
    check_start,
    find_cut_ends,
)
from labpipe.process.steps import PreparedTest, calibrate, check_channels, rezero_at_rest, run_step
from labpipe.protocol.schema import Branches, CurveBlock, Protocol
from labpipe.records.curve import FittedLine
from labpipe.records.declarations import FitShape
from labpipe.records.quality import Finding, Findings
from labpipe.records.recording import Recording
from labpipe.records.result import Result, Specimen, Status
from labpipe.records.signals import Clocks
from labpipe.results.bending import BendingStiffness, MomentCurvature
from labpipe.results.kinds import Kind, LoadString, ReducedTest, Setup, Stiffness
from labpipe.uncertainty.intervals import MeasuredNumber


@dataclass(frozen=True, slots=True, eq=False)
class Reduction:
    """Reduced test with its results.

    Parameters
    ----------
    reduced_test : test with all stages that could be computed, and with all findings
    results : results in the order of the protocol
    lines : straight lines that were fitted for stiffnesses
    """

    reduced_test: ReducedTest
    results: tuple[Result, ...]
    lines: tuple[FittedLine, ...]


def reduce_recordings(
    recordings: Mapping[str, Recording],
    protocol: Protocol,
    *,
    test_date: date | None = None,
    specimen: Specimen | None = None,
) -> Reduction:
    """Reduce the recordings of one test to results.

    Parameters
    ----------
    recordings : recordings in SI units with the channel names of the protocol, keyed by role
    protocol : resolved protocol
    test_date : day of the test, for the certificates of instruments; None if it is not known
    specimen : specimen with the labels and answers of the test sheet; None without a test sheet

    Raises
    ------
    ProcessingError
        If a recording lacks data that a step requires, such as the rigid body of the clamp.
    """
    prepared, new_findings = calibrate(recordings, protocol)
    findings = Findings() + new_findings + check_channels(prepared.signals, protocol)
    findings += check_calibration_due(protocol, test_date)
    findings += check_answers(protocol, {} if specimen is None else specimen.observed)
    labels = {} if specimen is None else specimen.labels
    for step in protocol.steps:
        prepared, new_findings = run_step(prepared, step, protocol)
        findings += new_findings
    if protocol.curve is None or protocol.branches is None:
        test = _build_reduced_test(prepared, Clocks(), protocol, findings, labels)
        return compute_results(test, protocol)
    seed = make_seed(recordings)
    prepared, motion, new_findings = split_motion(prepared, protocol, protocol.branches)
    findings += new_findings
    prepared, new_findings = check_mid_span(prepared, motion, protocol.limits)
    findings += new_findings
    signals, new_findings = rezero_at_rest(prepared.signals, motion)
    prepared, findings = replace(prepared, signals=signals), findings + new_findings
    findings = check_signals(prepared, motion, protocol, findings)
    test = _build_reduced_test(prepared, motion.clocks, protocol, findings, labels)
    test = add_curve(replace(test, seed=seed), motion, protocol, protocol.curve)
    return compute_results(test, protocol)


def make_seed(recordings: Mapping[str, Recording]) -> bytes:
    """Make a random seed from the recordings, so that results are reproducible.

    Parameters
    ----------
    recordings : recordings, keyed by role; at most 2000 evenly spaced samples of each channel and
        of the markers are used
    """
    digest = hashlib.sha256()
    for role in sorted(recordings):
        recording = recordings[role]
        arrays = [channel.values for channel in recording.channels]
        arrays += [] if recording.markers is None else [recording.markers.positions]
        for values in arrays:
            digest.update(values[:: max(1, len(values) // 1000)].tobytes())
    return digest.digest()


def split_motion(
    prepared: PreparedTest, protocol: Protocol, settings: Branches
) -> tuple[PreparedTest, Motion, list[Finding]]:
    """Split the motion into branches at its turns, and align the clocks there.

    Parameters
    ----------
    prepared : test after all steps
    protocol : protocol with the method by which the clocks are aligned
    settings : block ``branches`` of the protocol, with the channel of the motion and the minimum
        stroke

    Returns
    -------
    prepared : test; if the clock of the cameras cannot be aligned, its bent axis is replaced by the
        reason
    motion : motion with its branches and clocks
    findings : findings of the motion and of the clocks
    """
    signals = prepared.signals
    motion, findings = find_motion_strokes(signals.raw[settings.channel], settings)
    force_fit, motion, new_findings = align_clocks(signals, protocol.align, motion)
    clocks = Clocks(signals.raw[signals.displacement].clock, force_fit=force_fit)
    motion = replace(motion, branches=split_at_turns(motion), clocks=clocks)
    findings += new_findings
    if prepared.span is not None:
        # The import is slow, and only tests with cameras need it.
        from labpipe.process.camera_steps import align_cameras

        prepared, camera_fits, new_findings = align_cameras(
            prepared, motion, min_stroke=settings.min_stroke
        )
        motion = replace(motion, clocks=replace(clocks, other_fits=camera_fits))
        findings += new_findings
    return prepared, motion, findings


def add_curve(
    test: ReducedTest, motion: Motion, protocol: Protocol, settings: CurveBlock
) -> ReducedTest:
    """Build the curve of a test and correct it.

    Parameters
    ----------
    test : test without a curve
    motion : motion of the test with its branches and clocks
    protocol : protocol with the stroke of the rig and the limits
    settings : block ``curve`` of the protocol
    """
    test = replace(test, cut_times=find_cut_ends(test.signals, motion, protocol, test.findings))
    if test.findings.blocking_reason:
        return test
    unfiltered_force, new_findings = bridge_outliers(test.signals)
    test = replace(test, aligned=align_signals(test), unfiltered_force=unfiltered_force)
    curve, curve_findings = build_curve(test, unfiltered_force, motion)
    findings = test.findings + new_findings + curve_findings
    if curve is None:
        return replace(test, findings=findings)
    findings += check_consistency(CheckedRecord(test.signals, curve, protocol.limits, findings))
    test, new_findings = correct_curve(replace(test, curve=curve), settings)
    findings += new_findings
    has_slack = isinstance(test.slack, MeasuredNumber)
    findings += check_start(test.signals, motion, has_slack=has_slack)
    if test.curve is not None:
        record = CheckedRecord(test.signals, test.curve, protocol.limits, findings)
        findings += check_force_after_break(record, test.failure)
    return replace(test, findings=findings)


def _build_reduced_test(
    prepared: PreparedTest,
    clocks: Clocks,
    protocol: Protocol,
    findings: Findings,
    labels: Mapping[str, str],
) -> ReducedTest:
    """Build a reduced test without a curve, with the settings from which results are computed."""
    specimen, markers, string = protocol.specimen, protocol.markers, protocol.rig.string
    section = {} if specimen.section is None else vars(specimen.section)
    sizes = {"length": specimen.length, "gauge_length": specimen.gauge_length}
    sizes |= {"span": specimen.span, **section}
    # An uncertainty in the block `specimen` has priority over that of a result.
    uncertainties = {
        entry.length_key: entry.length_uncertainty
        for entry in protocol.results
        if isinstance(entry, BendingStiffness) and entry.length_uncertainty is not None
    }
    uncertainties |= {} if specimen.uncertainty is None else specimen.uncertainty.by_key
    setup = Setup(
        sizes={name: size for name, size in sizes.items() if size is not None},
        mass_per_length=specimen.mass_per_length,
        uncertainties=uncertainties,
        string=None if string is None else LoadString(**dict(string)),
        has_markers=markers is not None,
        centre_offset=0.0 if markers is None else markers.centre_offset,
        offset_uncertainty=0.0 if markers is None else markers.offset_uncertainty,
        centre_uncertainty=0.0 if markers is None else markers.centre_uncertainty,
        is_compliance_stated=protocol.curve is not None and protocol.curve.compliance is not None,
        limits=protocol.limits,
        labels=labels,
        free_tip=any(isinstance(step, FitShape) and step.tip == "free" for step in protocol.steps),
    )
    return ReducedTest(
        signals=prepared.signals,
        clocks=clocks,
        setup=setup,
        shape=prepared.shape,
        span=prepared.span,
        findings=findings,
    )


def compute_results(test: ReducedTest, protocol: Protocol) -> Reduction:
    """Compute the results that a protocol declares.

    Parameters
    ----------
    test : reduced test with all findings of the earlier stages
    protocol : protocol with the declarations of its results
    """
    if any(isinstance(entry, MomentCurvature) for entry in protocol.results):
        # The import is slow, and only tests with this result need it.
        from labpipe.results.moment_curvature import measure_moment_curvature

        bending, bending_findings = measure_moment_curvature(test)
        test = replace(test, bending=bending, findings=test.findings + bending_findings)
    results, lines = list[Result](), list[FittedLine]()
    for entry in protocol.results:
        outcome = entry.compute(test)
        results += [_add_remedy(x, entry, protocol) for x in outcome if isinstance(x, Result)]
        lines += [x for x in outcome if isinstance(x, FittedLine)]
        stiffnesses = {x.name: x for x in outcome if isinstance(x, Stiffness)}
        findings = test.findings + [x for x in outcome if isinstance(x, Finding)]
        test = replace(test, stiffnesses={**test.stiffnesses, **stiffnesses}, findings=findings)
    return Reduction(test, tuple(results), tuple(lines))


def _add_remedy(result: Result, entry: Kind, protocol: Protocol) -> Result:
    """Add a remedy to the reasons of a result for which the record is too short.

    The remedy is an override of the protocol that leaves out the result.
    """
    short_record_codes = {"not_reached", "too_few_samples", "no_break"}
    if result.status is not Status.FAILED:
        return result
    names = [getattr(kind, "name", kind.result) for kind in protocol.results]
    index = protocol.results.index(entry)
    key = names[index] if names.count(names[index]) == 1 else index
    remedy = format_sentence("process.remedy", override=format_overrides(f"results.{key}", "null"))
    reasons = [
        replace(x, message=x.message + remedy) if x.code in short_record_codes else x
        for x in result.reasons
    ]
    return replace(result, reasons=tuple(reasons))
