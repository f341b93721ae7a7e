"""Assign exports to tests by folder or by patterns of file names, and write the test sheets."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.errors import LabpipeError, ProtocolError, StoreError
from labpipe.messages import format_sentence
from labpipe.process.sheet_inference import (
    InferredTest,
    count_protocols,
    find_majority,
    infer_test,
    load_all_protocols,
    make_test_name,
    read_neighbours,
)
from labpipe.process.sheet_writing import write_inferred_sheet
from labpipe.protocol.grammar import has_control_characters
from labpipe.protocol.load import find_protocol, load_campaign_plan, load_protocol, load_test_sheet
from labpipe.protocol.sheet_grammar import PLAN_NAME, SHEET_NAME, ByFolder, ByName, CampaignPlan
from labpipe.protocol.source import Role, Source
from labpipe.store.replace import replacing, storing

_SPECIMEN_COLUMNS = ("type", "spool", "sample", "length", "span", "width", "thickness", "diameter")
"""Keys of a specimen that are also columns of a campaign sheet."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Exports that may belong to one test.

    Parameters
    ----------
    folder : of the test, below the folder of the campaign; may be missing
    files : path of each export, by role if the plan states roles, else by name
    values : facts from the names, by column of a campaign sheet
    by_role : whether the keys of `files` are roles
    """

    folder: Path
    files: dict[str, Path]
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
class CandidateListing:
    """Exports of a campaign, assigned to tests by the rules of its plan.

    Parameters
    ----------
    candidates : tests, sorted by folder
    unmatched : files that fit no rule, with the reason
    """

    candidates: tuple[Candidate, ...]
    unmatched: Mapping[Path, str]


@dataclass(frozen=True, slots=True)
class PairingOutcome:
    """Result of pairing a test.

    Parameters
    ----------
    sheet : path of the new or existing test sheet; None while exports are missing or unreadable
    messages : remarks on the content of the sheet, or on changed exports
    is_new : whether the sheet was written
    open_keys : keys to fill in before the test can be processed
    missing : roles without an export, or exports of an existing sheet that are missing
    unreadable : exports that cannot be read, with the reason
    """

    sheet: Path | None
    messages: tuple[str, ...] = ()
    is_new: bool = False
    open_keys: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    unreadable: Mapping[str, str] = field(default_factory=dict)


def read_plan(folder: Path) -> CampaignPlan:
    """Read the campaign YAML of a folder.

    Parameters
    ----------
    folder : of the campaign's exports

    Returns
    -------
    The plan; if there is no file, the plan of a campaign with one folder per test.

    Raises
    ------
    ProtocolError
        If the file has a fault.
    """
    path = folder / PLAN_NAME
    return load_campaign_plan(path) if path.exists() else CampaignPlan(version=1)


def list_candidates(
    folder: Path, plan: CampaignPlan, *, is_skipped: Callable[[Path], bool] = lambda _: False
) -> CandidateListing:
    """List the tests of a campaign by its rules, without opening any file.

    Parameters
    ----------
    folder : of the campaign's exports
    plan : its rules
    is_skipped : returns whether the test of a folder is skipped

    Raises
    ------
    OSError
        If a folder cannot be listed, such as on a lost network drive.
    """
    if isinstance(plan.pair, ByFolder):
        return _list_by_folder(folder, plan.pair, is_skipped)
    return _list_by_name(folder, plan.pair, is_skipped)


_CONTROL_CHARACTERS_IN_NAME = "its name has control characters; rename it"


def _list_by_folder(
    folder: Path, pair: ByFolder, is_skipped: Callable[[Path], bool]
) -> CandidateListing:
    top_files = filter(_could_be_export, _scan(folder)[1])
    unmatched = {folder / name: "it is not in the folder of a test" for name in top_files}
    candidates = []
    for place, names in _walk_test_folders(folder, is_skipped):
        files = {name: place / name for name in names if _could_be_export(name)}
        for name in filter(has_control_characters, list(files)):
            unmatched[files.pop(name)] = _CONTROL_CHARACTERS_IN_NAME
        values = {} if pair.name is None else pair.name.match(place.name)
        if pair.name is not None and values is None:
            reason = f"the name of its folder does not fit {pair.name.text!r}"
            unmatched |= dict.fromkeys(files.values(), reason)
        elif files or SHEET_NAME in names:
            candidates.append(Candidate(place, files, values or {}))
    return CandidateListing(tuple(candidates), unmatched)


def _walk_test_folders(
    folder: Path, is_skipped: Callable[[Path], bool]
) -> Iterator[tuple[Path, list[str]]]:
    """Yield the topmost folders with files below a folder, and the names of these files."""
    for place in _scan(folder)[0]:
        if is_skipped(place):
            continue
        if names := _scan(place)[1]:
            yield place, names
        else:
            yield from _walk_test_folders(place, is_skipped)


def _list_by_name(
    folder: Path, pair: ByName, is_skipped: Callable[[Path], bool]
) -> CandidateListing:
    top, patterns = folder / pair.source, pair.exports
    candidates: dict[tuple[str, ...], Candidate] = {}
    unmatched: dict[Path, str] = {}
    depth = 1 + max(pattern.text.count("/") for pattern in patterns.values())
    for name in _walk_exports(top, depth=depth):
        matches = {role: pattern.match(name) for role, pattern in patterns.items()}
        fits = {role: values for role, values in matches.items() if values is not None}
        if has_control_characters(name):
            unmatched[top / name] = _CONTROL_CHARACTERS_IN_NAME
        elif not fits:
            unmatched[top / name] = "its name fits no pattern in campaign.yaml"
        elif len(fits) > 1:
            unmatched[top / name] = f"its name fits several patterns: {', '.join(fits)}"
        else:
            ((role, values),) = fits.items()
            key = tuple(f"{key}={values[key].casefold()}" for key in sorted(values))
            test = make_test_name(values.get("test") or patterns[role].stem(name))
            files = candidates.setdefault(key, Candidate(folder / test, {}, values, True)).files
            if files.setdefault(role, top / name) != top / name:
                reason = f"{files[role].name} is already the {role} of the same test"
                unmatched[top / name] = reason
    ordered = sorted(candidates.values(), key=lambda candidate: candidate.name)
    return CandidateListing(
        tuple(candidate for candidate in ordered if not is_skipped(candidate.folder)), unmatched
    )


def _walk_exports(top: Path, depth: int, prefix: str = "") -> Iterator[str]:
    """Yield names of possible exports below `top`, except in subfolders with a test sheet."""
    folders, names = _scan(top)
    if prefix and SHEET_NAME in names:
        return
    yield from (f"{prefix}{name}" for name in names if _could_be_export(name))
    for place in folders if depth > 1 else ():
        yield from _walk_exports(place, depth - 1, f"{prefix}{place.name}/")


def _scan(folder: Path) -> tuple[list[Path], list[str]]:
    """List the folders and the names of files in a folder, sorted and without hidden ones."""
    with os.scandir(folder) as entries:
        shown = (entry for entry in entries if not entry.name.startswith("."))
        visible = sorted((entry.name, entry.is_dir(), entry.is_file()) for entry in shown)
    folders = [folder / name for name, is_folder, _ in visible if is_folder]
    return folders, [name for name, _, is_file in visible if is_file]


def _could_be_export(name: str) -> bool:
    return not name.casefold().endswith((".yaml", ".yml", ".md", ".ini"))


def collect_columns(plan: CampaignPlan, candidate: Candidate) -> dict[str, str]:
    """Collect facts about a test from the plan and the names of its folder and files.

    Parameters
    ----------
    plan : of the campaign
    candidate : the test

    Returns
    -------
    Text by column of a campaign sheet.
    """
    columns = {key: str(plan.specimen[key]) for key in _SPECIMEN_COLUMNS if key in plan.specimen}
    columns |= {"operator": plan.operator} if plan.operator else {}
    columns |= {"protocol": plan.protocol} if plan.protocol else {}
    columns |= {key: value for key, value in candidate.values.items() if key != "test"}
    columns["test"] = make_test_name(candidate.name)
    files = candidate.files.items() if candidate.by_role else ()
    return columns | {role: path.name for role, path in files}


def pair_test(candidate: Candidate, plan: CampaignPlan, *, waited: float = 0.0) -> PairingOutcome:
    """Write the sheet of a test once all its exports exist and can be read.

    Parameters
    ----------
    candidate : the test; its files no longer change
    plan : of the campaign
    waited : s since a change of its files was last seen

    Returns
    -------
    The sheet, or the missing roles or unreadable exports. An existing sheet is never overwritten.

    Raises
    ------
    LabpipeError
        If a file cannot be copied or written, or names or plan have a fault.
    """
    if candidate.sheet.exists():
        return _check_sheet(candidate)
    if candidate.by_role and isinstance(plan.pair, ByName):
        roles = plan.pair.exports if plan.wait_for is None else plan.wait_for
        if missing_roles := tuple(role for role in roles if role not in candidate.files):
            return PairingOutcome(None, missing=missing_roles)
    copies = _copy_exports(candidate)
    neighbours = read_neighbours(candidate.folder.resolve().parent)
    inferred = infer_test(candidate.folder, collect_columns(plan, candidate), neighbours=neighbours)
    n_protocols = count_protocols(neighbours, candidate.folder)
    missing = _find_missing_roles(inferred, plan, n_protocols, waited)
    if inferred.read_errors or missing:
        _remove_copies(copies, candidate.folder)
        return PairingOutcome(None, missing=missing, unreadable=inferred.read_errors)
    # facts of the plan for which a campaign sheet has no column
    blocks = {key: value for key, value in plan.specimen.items() if key not in _SPECIMEN_COLUMNS}
    overrides = {key: override.model_dump() for key, override in plan.overrides.items()}
    planned = replace(inferred, blocks={"specimen": blocks, "overrides": overrides})
    sheet = write_inferred_sheet(planned)
    return PairingOutcome(sheet.path, sheet.remarks, is_new=True, open_keys=sheet.open_keys)


def _check_sheet(candidate: Candidate) -> PairingOutcome:
    """Find missing and changed exports of a test that has a sheet."""
    try:
        sheet = load_test_sheet(candidate.sheet)
    except ProtocolError:
        return PairingOutcome(candidate.sheet)  # processing reports the fault
    names = [name for names_of_role in sheet.files.values() for name in names_of_role]
    missing = tuple(name for name in names if not (candidate.folder / name).exists())
    if missing:
        return PairingOutcome(None, missing=missing)
    originals = [path for path in candidate.files.values() if path.parent != candidate.folder]
    changed = [path for path in originals if _differs(path, candidate.folder / path.name)]
    messages = [format_sentence("campaign.newer_export", file=path.name) for path in changed]
    return PairingOutcome(candidate.sheet, tuple(messages))


def _differs(path: Path, copy: Path) -> bool:
    """Return whether an export has changed since it was copied, by size and time."""
    if not copy.exists():
        return False
    states = [(status.st_size, int(status.st_mtime)) for status in (path.stat(), copy.stat())]
    return states[0] != states[1]


def _find_missing_roles(
    inferred: InferredTest, plan: CampaignPlan, protocol_counts: Mapping[str, int], waited: float
) -> tuple[str, ...]:
    """Find the missing roles, from the inferred test and the protocols of other tests.

    If the plan states `wait_for`, only these roles are needed. If it names no protocol, the most
    frequent one of the other tests is assumed if its roles include the exports, else the inferred
    one. An optional export counts as missing for the `patience` of the plan if
    the plan names the protocol, or if another protocol with these exports requires it: a protocol
    of the other tests or, if none has these exports, any protocol.
    """
    needed: list[str] = [*(plan.wait_for or ())]
    optional: list[str] = []
    if plan.wait_for is None and plan.protocol:
        sources = _find_sources(plan.protocol, inferred.folder)
        needed, optional = _list_required_roles(sources), [*sources]
    elif plan.wait_for is None:
        possible_sources = _filter_sources(
            inferred, (_find_sources(name, inferred.folder) for name in protocol_counts)
        ) or _filter_sources(inferred, (protocol.sources for protocol in load_all_protocols()))
        sources = _find_sources(find_majority(protocol_counts), inferred.folder)
        if sources not in possible_sources:
            sources = _find_sources(inferred.values.get("protocol", ""), inferred.folder)
        required_elsewhere = {
            role for alternative in possible_sources for role in _list_required_roles(alternative)
        }
        needed = _list_required_roles(sources)
        optional = [role for role in sources if role in required_elsewhere]
    missing = [role for role in needed if role not in inferred.files]
    optional = [role for role in optional if role not in inferred.files and waited < plan.patience]
    return tuple(missing or optional)


def _filter_sources(
    inferred: InferredTest, candidates: Iterable[Mapping[Role, Source]]
) -> list[Mapping[Role, Source]]:
    """Return the sources of those protocols that have all roles of the exports of a test."""
    return [
        sources for sources in candidates if sources and sources.keys() >= inferred.files.keys()
    ]


def _find_sources(name: str, folder: Path) -> Mapping[Role, Source]:
    """Find the sources of a protocol by role; none for an unknown or faulty protocol."""
    with suppress(LabpipeError):
        file = find_protocol(name, sheet_folder=folder) if name else None
        return load_protocol(file).sources if isinstance(file, Path) else {}
    return {}


def _list_required_roles(sources: Mapping[Role, Source]) -> list[str]:
    return [role for role, source in sources.items() if not source.optional]


def _copy_exports(candidate: Candidate) -> list[Path]:
    """Copy exports into the folder of their test; return the new copies."""
    copies = []
    for path in candidate.files.values():
        copy = candidate.folder / path.name
        if path == copy:
            continue
        if copy.exists():
            if _differs(path, copy):
                raise StoreError.about("campaign.other_copy", copy, source=path)
            continue
        with storing(copy):
            candidate.folder.mkdir(parents=True, exist_ok=True)
            with replacing(copy) as part:
                shutil.copy2(path, part)
        copies.append(copy)
    return copies


def _remove_copies(copies: Sequence[Path], folder: Path) -> None:
    """Remove copies of exports, since the originals may still be written."""
    for path in copies:
        path.unlink(missing_ok=True)
    with suppress(OSError):  # not empty
        if copies:
            folder.rmdir()
