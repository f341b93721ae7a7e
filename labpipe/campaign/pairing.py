"""Pair exports into tests: one folder per test, or by patterns of file names."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.errors import LabpipeError, ProtocolError, StoreError
from labpipe.messages import format_sentence
from labpipe.process.protocol_match import find_majority, load_all_protocols
from labpipe.process.sheet_inference import (
    InferredTest,
    count_protocols,
    infer_test,
    read_neighbours,
    safe_name,
)
from labpipe.process.sheet_writing import write_inferred_sheet
from labpipe.protocol.load import find_protocol, load_campaign_plan, load_protocol, load_test_sheet
from labpipe.protocol.plans import PLAN_NAME, ByFolder, ByName, CampaignPlan
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import Role, Source
from labpipe.protocol.values import has_control_characters
from labpipe.store.replace import replacing, storing

_COLUMNS = ("type", "spool", "sample", "length", "span", "width", "thickness", "diameter")
"""Keys of a specimen that are also columns of a campaign sheet."""
_NOT_EXPORTS = (".yaml", ".yml", ".md", ".ini")


@dataclass(frozen=True, slots=True)
class Candidate:
    """Exports that may belong to one test.

    Parameters
    ----------
    folder : of the test, below that of the campaign; may be missing
    files : path of each export, by role if the plan states roles, else by name
    values : from the names, by column of a campaign sheet
    by_role : whether the keys of `files` are roles
    """

    folder: Path
    files: Mapping[str, Path]
    values: Mapping[str, str] = field(default_factory=dict)
    by_role: bool = False

    @property
    def name(self) -> str:
        """Return the name of the folder."""
        return self.folder.name

    @property
    def sheet(self) -> Path:
        """Return the path of its test sheet, which may be missing."""
        return self.folder / SHEET_NAME

    @property
    def paths(self) -> list[Path]:
        """Return the exports and the test sheet."""
        return [*sorted(self.files.values()), self.sheet]


@dataclass(frozen=True, slots=True)
class RawListing:
    """Content of the folder of exports.

    Parameters
    ----------
    candidates : tests, by name
    unmatched : files that fit no rule, with the reason
    """

    candidates: tuple[Candidate, ...]
    unmatched: Mapping[Path, str]


@dataclass(frozen=True, slots=True)
class PairingOutcome:
    """Result of pairing a test.

    Parameters
    ----------
    sheet : new or existing; None while exports are missing
    messages : on the content of the sheet, or on problems
    is_new : whether the sheet was written
    open : keys to fill in before the test can be processed
    missing : roles without an export yet
    unread : exports that cannot be read, with the reason
    """

    sheet: Path | None
    messages: tuple[str, ...] = ()
    is_new: bool = False
    open: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)


def plan_of(folder: Path) -> CampaignPlan:
    """Read the campaign YAML of a folder; without one, there is one folder per test.

    Parameters
    ----------
    folder : of the campaign's exports

    Raises
    ------
    ProtocolError
        If it has a fault.
    """
    path = folder / PLAN_NAME
    return load_campaign_plan(path) if path.exists() else CampaignPlan(version=1)


def list_candidates(
    folder: Path, plan: CampaignPlan, *, is_skipped: Callable[[Path], bool] = lambda _: False
) -> RawListing:
    """List the tests of a campaign by its rules, without opening any file.

    Parameters
    ----------
    folder : of the campaign's exports
    plan : its rules
    is_skipped : whether the test of a folder is skipped

    Raises
    ------
    OSError
        If a folder cannot be listed, such as on a lost network drive.
    """
    if isinstance(plan.pair, ByFolder):
        return _by_folder(folder, plan.pair, is_skipped)
    listed = _by_name(folder, plan.pair)
    kept = (candidate for candidate in listed.candidates if not is_skipped(candidate.folder))
    return replace(listed, candidates=tuple(kept))


_CONTROL_CHARACTERS = "its name has control characters; rename it"


def _by_folder(folder: Path, pair: ByFolder, is_skipped: Callable[[Path], bool]) -> RawListing:
    candidates, unmatched = list[Candidate](), dict[Path, str]()
    for place in _test_folders(folder, is_skipped):
        files = {name: place / name for name in _names(place) if _may_be_export(name)}
        for name in [file for file in files if has_control_characters(file)]:
            unmatched[files.pop(name)] = _CONTROL_CHARACTERS
        values = {} if pair.pattern is None else pair.pattern.match(place.name)
        if values is None:
            why = f"the name of its folder does not fit {pair.name!r}"
            unmatched |= dict.fromkeys(files.values(), why)
        elif files or (place / SHEET_NAME).exists():
            candidates.append(Candidate(place, files, values))
    loose = [folder / name for name in _names(folder) if _may_be_export(name)]
    unmatched |= dict.fromkeys(loose, "it is not in the folder of a test")
    return RawListing(tuple(candidates), unmatched)


def _test_folders(folder: Path, is_skipped: Callable[[Path], bool]) -> Iterator[Path]:
    """Yield the topmost folders with files below a folder."""
    for place in _folders(folder):
        if is_skipped(place):
            continue
        if _names(place):
            yield place
        else:
            yield from _test_folders(place, is_skipped)


def _by_name(folder: Path, pair: ByName) -> RawListing:
    top, patterns = folder / pair.source, pair.patterns
    candidates: dict[tuple[str, ...], Candidate] = {}
    unmatched: dict[Path, str] = {}
    depth = 1 + max(pattern.text.count("/") for pattern in patterns.values())
    for name in _below(top, depth=depth):
        roles = {role: pattern.match(name) for role, pattern in patterns.items()}
        fits = {role: values for role, values in roles.items() if values is not None}
        if has_control_characters(name):
            unmatched[top / name] = _CONTROL_CHARACTERS
        elif not fits:
            unmatched[top / name] = "its name fits no pattern in campaign.yaml"
        elif len(fits) > 1:
            unmatched[top / name] = f"its name fits several patterns: {', '.join(fits)}"
        else:
            ((role, values),) = fits.items()
            key = tuple(f"{key}={values[key].casefold()}" for key in sorted(values))
            test = safe_name(values.get("test") or patterns[role].stem(name))
            new = Candidate(folder / test, {}, values, by_role=True)
            known = candidates.setdefault(key, new)
            if role in known.files:
                other = known.files[role].name
                unmatched[top / name] = f"{other} is already the {role} of the same test"
            else:
                candidates[key] = replace(known, files={**known.files, role: top / name})
    ordered = sorted(candidates.values(), key=lambda candidate: candidate.name)
    return RawListing(tuple(ordered), unmatched)


def _names(folder: Path) -> list[str]:
    """List the files of a folder by name, without hidden ones."""
    with os.scandir(folder) as entries:
        return sorted(
            entry.name for entry in entries if entry.is_file() and not entry.name.startswith(".")
        )


def _folders(folder: Path) -> list[Path]:
    with os.scandir(folder) as entries:
        names = [
            entry.name for entry in entries if entry.is_dir() and not entry.name.startswith(".")
        ]
    return [folder / name for name in sorted(names)]


def _below(top: Path, depth: int, prefix: str = "") -> Iterator[str]:
    """Yield files down to a depth, with slashes, but none in a folder with a test sheet."""
    if prefix and (top / SHEET_NAME).exists():
        return
    yield from (f"{prefix}{name}" for name in _names(top) if _may_be_export(name))
    if depth > 1:
        for place in _folders(top):
            yield from _below(place, depth - 1, f"{prefix}{place.name}/")


def _may_be_export(name: str) -> bool:
    return not name.casefold().endswith(_NOT_EXPORTS)


def stated_columns(plan: CampaignPlan, candidate: Candidate) -> dict[str, str]:
    """Collect the facts on a test from plan and names, by column of a campaign sheet.

    Parameters
    ----------
    plan : of the campaign
    candidate : the test
    """
    columns = {key: str(plan.specimen[key]) for key in _COLUMNS if key in plan.specimen}
    columns |= {"operator": plan.operator} if plan.operator else {}
    columns |= {"protocol": plan.protocol} if plan.protocol else {}
    columns |= {key: value for key, value in candidate.values.items() if key != "test"}
    columns["test"] = safe_name(candidate.name)
    named = candidate.files.items() if candidate.by_role else ()
    return columns | {role: path.name for role, path in named}


def pair_test(candidate: Candidate, plan: CampaignPlan, *, waited: float = 0.0) -> PairingOutcome:
    """Write the sheet of a test once all its exports exist and can be read.

    Parameters
    ----------
    candidate : the test; its files no longer change
    plan : of the campaign
    waited : s since its last file appeared

    Returns
    -------
    The sheet, or the missing roles. An existing sheet is never overwritten.

    Raises
    ------
    LabpipeError
        If a file cannot be copied or written, or names or plan have a fault.
    """
    if candidate.sheet.exists():
        return _with_sheet(candidate)
    if candidate.by_role:
        by_name = [role for role in _needed(plan, candidate) if role not in candidate.files]
        if by_name:
            return PairingOutcome(None, missing=tuple(by_name))
    copies = _copy_exports(candidate)
    neighbours = read_neighbours(candidate.folder.resolve().parent)
    seen = infer_test(candidate.folder, stated_columns(plan, candidate), neighbours=neighbours)
    missing = _missing(seen, plan, count_protocols(neighbours, candidate.folder), waited)
    if seen.unread or missing:
        _remove_copies(copies, candidate.folder)
        return PairingOutcome(None, missing=missing, unread=seen.unread)
    sheet = write_inferred_sheet(add_plan_blocks(seen, plan))
    return PairingOutcome(sheet.path, sheet.remarks, is_new=True, open=sheet.open)


def _with_sheet(candidate: Candidate) -> PairingOutcome:
    """Find the exports that the sheet of a test names and that are missing."""
    try:
        sheet = load_test_sheet(candidate.sheet)
    except ProtocolError:
        return PairingOutcome(candidate.sheet)  # processing reports the fault
    names = [name for several in sheet.files.values() for name in several]
    absent = tuple(name for name in names if not (candidate.folder / name).exists())
    if absent:
        return PairingOutcome(None, missing=absent)
    elsewhere = [path for path in candidate.files.values() if path.parent != candidate.folder]
    messages = [
        format_sentence("campaign.newer_export", file=path.name)
        for path in elsewhere
        if _differs(path, candidate.folder / path.name)
    ]
    return PairingOutcome(candidate.sheet, tuple(messages))


def _differs(path: Path, copy: Path) -> bool:
    """Return whether an export has changed since it was copied, by size and time."""
    if not copy.exists():
        return False
    one, other = path.stat(), copy.stat()
    return (one.st_size, int(one.st_mtime)) != (other.st_size, int(other.st_mtime))


def add_plan_blocks(seen: InferredTest, plan: CampaignPlan) -> InferredTest:
    """Add the facts of the plan without a column: labels, bundle, overrides.

    Parameters
    ----------
    seen : a test
    plan : of the campaign
    """
    rest = {key: value for key, value in plan.specimen.items() if key not in _COLUMNS}
    overrides = {key: override.model_dump() for key, override in plan.overrides.items()}
    return replace(seen, blocks={"specimen": rest, "overrides": overrides})


def _needed(plan: CampaignPlan, candidate: Candidate) -> Sequence[str]:
    if plan.wait_for is not None:
        return plan.wait_for
    return list(plan.pair.exports) if isinstance(plan.pair, ByName) else list(candidate.files)


def _missing(
    seen: InferredTest, plan: CampaignPlan, others: Mapping[str, int], waited: float
) -> tuple[str, ...]:
    """Return the missing roles, from the inferred test and the protocols of other tests."""
    if plan.wait_for is not None:
        return tuple(role for role in plan.wait_for if role not in seen.files)
    needed, optional = _required_and_awaited(seen, plan, others)
    missing = [role for role in needed if role not in seen.files]
    late = [role for role in optional if role not in seen.files]
    return tuple(missing or (late if waited < plan.patience else []))


def _required_and_awaited(
    seen: InferredTest, plan: CampaignPlan, others: Mapping[str, int]
) -> tuple[list[str], list[str]]:
    """Return the required roles of a test, and optional roles that are awaited for a while.

    If the plan names no protocol, the most frequent one of the other tests is assumed if its roles
    include the exports. An optional export is awaited only if another protocol with these exports
    requires it: one of the other tests, or, if none fits, any protocol.
    """
    if plan.protocol:
        sources = _sources(plan.protocol, seen.folder)
        needed = _required_roles(sources)
        return needed, [role for role in sources if role not in needed]
    of_others = [_sources(name, seen.folder) for name in others if name]
    of_any = (protocol.sources for protocol in load_all_protocols())
    may_be = _accepting(seen, of_others) or _accepting(seen, of_any)
    usual = _sources(find_majority(others), seen.folder)
    sources = usual if usual in may_be else _sources(seen.values.get("protocol", ""), seen.folder)
    needed = _required_roles(sources)
    wanted = {role for sources in may_be for role in _required_roles(sources)}
    return needed, [role for role in sources if role in wanted and role not in needed]


def _accepting(
    seen: InferredTest, several: Iterable[Mapping[Role, Source]]
) -> list[Mapping[Role, Source]]:
    return [sources for sources in several if sources.keys() >= seen.files.keys()]


def _sources(name: str, folder: Path) -> Mapping[Role, Source]:
    """Return the exports of a protocol by role; none for an unknown or faulty protocol."""
    file = find_protocol(name, beside=folder) if name else None
    with suppress(LabpipeError):
        return load_protocol(file).sources if isinstance(file, Path) else {}
    return {}


def _required_roles(sources: Mapping[Role, Source]) -> list[str]:
    return [role for role, source in sources.items() if not source.optional]


def _copy_exports(candidate: Candidate) -> list[Path]:
    """Copy exports from elsewhere into the folder of their test."""
    copies = []
    for path in candidate.files.values():
        goal = candidate.folder / path.name
        if path == goal:
            continue
        if goal.exists():
            if _differs(path, goal):
                raise StoreError.about("campaign.other_copy", goal, source=path)
            continue
        with storing(goal):
            candidate.folder.mkdir(parents=True, exist_ok=True)
            with replacing(goal) as part:
                shutil.copyfile(path, part)
                shutil.copystat(path, part)
        copies.append(goal)
    return copies


def _remove_copies(copies: Sequence[Path], folder: Path) -> None:
    """Remove copies of exports that may still be incomplete."""
    for path in copies:
        path.unlink(missing_ok=True)
    with suppress(OSError):  # not empty
        if copies:
            folder.rmdir()
