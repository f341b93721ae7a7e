"""Exports that a test sheet names: links out of its folder, and what falls away without one."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Final

from labpipe.errors import Fault
from labpipe.protocol.results import ResultEntry, result_names
from labpipe.protocol.schema import AlignNone, Protocol
from labpipe.protocol.sheet_grammar import COPY_IT, TestSheet
from labpipe.protocol.yaml_text import Document
from labpipe.records.step_settings import Step, TravelFromSpeed

FOLLOW: Final = "follow_links"
"""Key of a protocol whose exports may be links into a store elsewhere."""
_OR_FOLLOW = (
    f" Or let links be followed: with --follow-links on the command line, or '{FOLLOW}: true' in"
    " the protocol."
)


def are_followed(protocol: Document) -> bool:
    """Tell whether a protocol, as written, lets exports be links out of the folder of the test.

    Parameters
    ----------
    protocol : without what a test changes in it: a test folder from elsewhere must not decide this
    """
    data = protocol.data if isinstance(protocol.data, Mapping) else {}
    return str(data.get(FOLLOW)).lower() == "true"


def link_faults(sheet: TestSheet, folder: Path, *, followed: bool) -> Iterator[Fault]:
    """Find exports that a link takes out of the folder of the test, or nowhere.

    Parameters
    ----------
    sheet : names the exports
    folder : of the test
    followed : whether links may lead out of it

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    home = folder.resolve()
    for role, names in sheet.files.items():
        for name in names:
            try:
                is_inside = (folder / name).resolve().is_relative_to(home)
            except (OSError, RuntimeError):  # Python 3.12 and before call a loop a RuntimeError
                found = f"{name!r}, a link that leads back to itself"
                yield Fault(("files", role), "a file", found, "Make the link anew.")
                continue
            if not (is_inside or followed):
                expected = "a file inside the folder of the test"
                found = f"{name!r}, a link out of it"
                yield Fault(("files", role), expected, found, f"{COPY_IT}{_OR_FOLLOW}")


_MARKER_FIGURES: Final = frozenset({"wire-shapes", "moment-curvature", "marker-quality"})
"""Figures that need a source of marker tracks."""


def without_absent(protocol: Protocol, roles: Collection[str]) -> Protocol:
    """Take out of a protocol what a test without an optional export cannot have.

    Parameters
    ----------
    protocol : as loaded
    roles : of the files that the test has

    Returns
    -------
    The protocol of this test: without the sources that are optional and absent, without the steps,
    results and figures that only these make possible, and without a ``travel-from-speed`` whose
    channel a source of the test measures.
    """
    sources = {
        role: source
        for role, source in protocol.sources.items()
        if role in roles or not source.optional
    }
    kept = protocol.model_copy(update={"sources": sources})
    no_markers = "markers" in protocol.sources and "markers" not in sources
    one_clock = _is_made_from_speed(kept)
    results = tuple(
        each
        for each in kept.results
        if not (each.needs.shape and no_markers) and not (each.needs.clocks and one_clock)
    )
    left = _names(protocol.results) - _names(results)
    main = tuple(name for name in kept.groups.main if name not in left)
    update: dict[str, object] = {
        "steps": tuple(_kept_steps(kept, set(protocol.channels) - set(kept.channels))),
        "results": results,
        "groups": kept.groups.model_copy(update={"main": main}),
    }
    if one_clock:
        update["align"] = AlignNone()
    if no_markers:
        drawn = tuple(x for x in kept.report.figures if x not in _MARKER_FIGURES)
        update["report"] = kept.report.model_copy(update={"figures": drawn})
        update["markers"] = None
    return kept.model_copy(update=update)


def absent_faults(protocol: Protocol, whole: Protocol) -> Iterator[Fault]:
    """Find what a test cannot do without, although its source is optional.

    Parameters
    ----------
    protocol : as `without_absent` gives it
    whole : the same with all its sources

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    made = {step.channel for step in protocol.steps if isinstance(step, TravelFromSpeed)}
    for role, source in whole.sources.items():
        if role in protocol.sources:
            continue
        for name in sorted(set(source.all_channels) & _needed(protocol) - made):
            expected = f"a file in the role {role!r}, which gives {name!r}"
            remedy = "Add it to 'files', or add the step 'travel-from-speed' to the protocol."
            yield Fault(("files",), expected, "none", remedy)
        for name in sorted(set(source.all_channels) & made):
            yield from _speed_faults(protocol, role, name)


def _speed_faults(protocol: Protocol, role: str, name: str) -> Iterator[Fault]:
    """Find a displacement that neither an export nor speed and stroke give."""
    for key in ("crosshead_speed", "stroke"):
        if getattr(protocol.rig, key) is None:
            expected = f"a file in the role {role!r}, or 'rig.{key}' to make {name!r} from"
            remedy = f"Add the file to 'files', or 'rig.{key}' to the protocol."
            yield Fault(("files",), expected, "neither", remedy)


def _needed(protocol: Protocol) -> set[str]:
    """Channels without which there is no curve."""
    names = set()
    if protocol.curve is not None:
        names |= {protocol.curve.force, protocol.curve.displacement}
    if protocol.branches is not None:
        names.add(protocol.branches.channel)
    if not isinstance(protocol.align, AlignNone) and protocol.align.channel is not None:
        names.add(protocol.align.channel)
    return names


def _kept_steps(kept: Protocol, lost: set[str]) -> Iterator[Step]:
    """Steps that still have a channel; one that is made from speed exists behind its step."""
    for step in kept.steps:
        if "markers" not in kept.sources and step.on_markers:
            continue
        if isinstance(step, TravelFromSpeed):
            if step.channel not in kept.channels:
                lost = lost - {step.channel}
                yield step
        elif getattr(step, "channel", None) not in lost:
            yield step


def _is_made_from_speed(kept: Protocol) -> bool:
    """Whether the displacement of the curve is made on the clock of the force."""
    if kept.curve is None or kept.curve.displacement in kept.channels:
        return False
    made = {step.channel for step in kept.steps if isinstance(step, TravelFromSpeed)}
    return kept.curve.displacement in made


def _names(entries: tuple[ResultEntry, ...]) -> set[str]:
    return {name for each in entries for name in result_names(each.result, asdict(each))}
