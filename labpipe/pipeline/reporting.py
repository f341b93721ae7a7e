"""From processed tests to the report of a campaign."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path

import numpy as np

from labpipe import __version__
from labpipe.errors import LabpipeError, UsageError
from labpipe.pipeline.settings import Settings, setting_notes, settings_of, unlike_words
from labpipe.pipeline.targets import find_results, shared_folder
from labpipe.protocol.load import parse_protocol
from labpipe.protocol.rig import Groups
from labpipe.records.arrays import Floats
from labpipe.records.curve import Branch, Direction
from labpipe.records.group import Campaign, Difference, Group, Sample, SampleCurve
from labpipe.records.result import TestResult
from labpipe.report.lab_report import write_report
from labpipe.report.numbers import is_main
from labpipe.statistics.bands import block_means
from labpipe.statistics.groups import PoolingLimits, build_group, compare_groups
from labpipe.statistics.methods import PROTOCOLS_DIFFER
from labpipe.store.lock import locked
from labpipe.store.read import read_outcome
from labpipe.store.replace import replacing_together

_POINTS = 2000
"""Points of a branch that a report keeps, each the mean of its samples: so many that a slip or a
corner is smeared over less than a line is thick."""


@dataclass(frozen=True, slots=True, eq=False)
class Reported:
    """A report and where it was written.

    Parameters
    ----------
    folder : holds report.html, tables.xlsx and figures
    campaign : what it shows
    files : all of them, the page first
    """

    folder: Path
    campaign: Campaign
    files: tuple[Path, ...]


def report_tests(
    targets: Sequence[Path],
    *,
    out: Path | None = None,
    title: str = "",
    say: Callable[[str], None] = lambda _: None,
) -> Reported:
    """Put processed tests together into one report.

    Parameters
    ----------
    targets : result.h5 files, or folders that hold some
    out : folder of the report; None for ``report`` in the folder that all tests share
    title : of the report; the name of that folder if empty
    say : told the name of each test as it is read

    Returns
    -------
    The report and its files.

    Raises
    ------
    LabpipeError
        If there is no processed test, none can be read, or the report cannot be written; an
        earlier report is then as it was.
    """
    files = find_results(targets)
    shared = shared_folder(files)
    campaign = make_campaign(files, title or shared.resolve().name, say)
    folder = shared / "report" if out is None else out
    with locked(folder), replacing_together(folder) as stage:
        say("report")
        written = write_report(campaign, stage)
    return Reported(folder, campaign, tuple(folder / path.relative_to(stage) for path in written))


def make_campaign(
    files: Sequence[Path], title: str, say: Callable[[str], None] = lambda _: None
) -> Campaign:
    """Read processed tests one after the other and put them into groups.

    Parameters
    ----------
    files : result.h5 files; one that cannot be read is left out, with the reason
    title : of the report
    say : told the name of each test as it is read

    Returns
    -------
    Groups of one specimen type and one protocol each, and how they differ.

    Raises
    ------
    LabpipeError
        If no file can be read.
    """
    members: dict[tuple[str, str], list[Sample]] = {}
    wishes: dict[str, Groups] = {}
    settings: dict[str, Settings] = {}
    left_out: dict[str, str] = {}
    for file in files:
        say(file.parent.name)
        try:
            result = read_outcome(file)
            # What concerns a group is said by its protocol, as each result stored it.
            protocol = parse_protocol(result.protocol_yaml, str(file))
        except LabpipeError as error:
            left_out[str(file)] = str(error)
            continue
        key = (result.specimen.type, result.protocol)
        wishes[result.protocol], settings[str(file)] = protocol.groups, settings_of(protocol)
        members.setdefault(key, []).append(sample_of(result, str(file)))
    if not members:
        raise UsageError("\n".join(left_out.values()))
    groups = {
        key: _noted(_group(key, members, wishes[key[1]]), settings) for key in sorted(members)
    }
    return Campaign(
        title=title,
        groups=tuple(groups.values()),
        differences=tuple(_differences(groups, wishes, settings)),
        left_out=left_out,
        labpipe_version=__version__,
    )


def sample_of(result: TestResult, source: str) -> Sample:
    """Keep of a processed test what a report needs.

    Parameters
    ----------
    result : with or without recordings
    source : file it was read from
    """
    return Sample(
        test=result.test,
        specimen=result.specimen,
        protocol=result.protocol,
        loading=_branches(result, Direction.LOADING),
        unloading=_branches(result, Direction.UNLOADING),
        results=result.results,
        slips=result.slips,
        lines=result.lines,
        quality=result.quality,
        display=dict(result.display),
        source=source,
    )


def _branches(result: TestResult, direction: Direction) -> tuple[SampleCurve, ...]:
    branches = result.curve.branches if result.curve is not None else ()
    return tuple(_thin(result, branch) for branch in branches if branch.direction is direction)


def _thin(result: TestResult, branch: Branch) -> SampleCurve:
    """A branch as means over equal numbers of samples, up to the failure."""
    curve = result.curve
    if curve is None:
        message = "a branch without a curve"
        raise ValueError(message)
    part = slice(branch.start, _stop_before_failure(result, branch, curve.displacement))
    force = curve.force[part]
    measured = result.aligned.series["force"].values[part] if result.aligned is not None else force
    order = slice(None) if branch.direction is Direction.LOADING else slice(None, None, -1)
    return SampleCurve(
        displacement=block_means(curve.displacement[part][order], _POINTS),
        force=block_means(force[order], _POINTS),
        as_measured=block_means(measured[order], _POINTS),
        cycle=branch.cycle,
    )


def _stop_before_failure(result: TestResult, branch: Branch, displacement: Floats) -> int:
    """Where a branch ends: at its last sample, or at the last one before the specimen broke."""
    at = next((each.value for each in result.results if each.name == "failure_displacement"), None)
    if at is None or branch.direction is not Direction.LOADING:
        return branch.stop
    beyond = np.flatnonzero(displacement[branch.start : branch.stop] > at)
    return branch.start + int(beyond[0]) if len(beyond) else branch.stop


def _group(
    key: tuple[str, str], members: dict[tuple[str, str], list[Sample]], settings: Groups
) -> Group:
    kind, protocol = key
    shared = sum(other == kind for other, _ in members) > 1
    group = build_group(
        f"{kind}, {protocol}" if shared else kind,
        protocol,
        [_of_specimen(sample) for sample in members[key]],
        limits=PoolingLimits(min_p=settings.min_p, max_spool_share=settings.max_spool_share),
        scaled=settings.scaled,
    )
    numbers = {number.name: number for number in group.numbers}
    first = [numbers.pop(name) for name in settings.main if name in numbers]
    whole = {sample.source: sample for sample in members[key]}
    samples = tuple(whole[sample.source] for sample in group.samples)
    return replace(group, samples=samples, numbers=(*first, *numbers.values()))


def _of_specimen(sample: Sample) -> Sample:
    """The sample with those results alone that say something about the specimen.

    A group has numbers of these only, so that no table or figure has to leave any out.
    """
    kept = [each for each in sample.results if is_main(each.name)]
    return replace(sample, results=tuple(kept))


def _differences(
    groups: dict[tuple[str, str], Group],
    wishes: dict[str, Groups],
    settings: dict[str, Settings],
) -> list[Difference]:
    """How groups of one protocol differ in the numbers that the protocol calls main."""
    found: list[Difference] = []
    for (first, one), (second, other) in combinations(groups.items(), 2):
        said = wishes[first[1]]
        if first[1] == second[1]:
            unlike = unlike_words(_settings((*one.samples, *other.samples), settings))
            compared = compare_groups(one, other, names=said.main, margin=said.margin)
            found += [replace(each, verdict=each.verdict + unlike) for each in compared]
    return found


def _noted(group: Group, settings: dict[str, Settings]) -> Group:
    """The group with a warning, before all others, for what was not set alike in its tests."""
    told = [note.where for note in group.notes if note.code == PROTOCOLS_DIFFER]
    return replace(
        group, notes=(*setting_notes(_settings(group.samples, settings), told), *group.notes)
    )


def _settings(samples: Sequence[Sample], settings: dict[str, Settings]) -> dict[str, Settings]:
    """Settings by test; of tests of one name, by file."""
    times = Counter(sample.test for sample in samples)
    return {
        sample.test if times[sample.test] == 1 else sample.source: settings[sample.source]
        for sample in samples
    }
