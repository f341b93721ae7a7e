"""Assign exports to tests by folder or by patterns of file names, and write the test sheets."""

from __future__ import annotations

import os
import shutil
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
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
    read_campaign_tests,
)
from labpipe.process.sheet_writing import write_inferred_sheet
from labpipe.protocol.grammar import has_control_characters
from labpipe.protocol.load import find_protocol, load_campaign_plan, load_protocol, load_test_sheet
from labpipe.protocol.sheet_grammar import PLAN_NAME, SHEET_NAME, CampaignPlan, FolderPair, NamePair
from labpipe.protocol.source import Role, Source
from labpipe.store.replace import map_errors, replace_file

_SPECIMEN_COLUMNS = ("type", "spool", "sample", "length", "span", "width", "thickness", "diameter")
"""Keys of a specimen that are also columns of a campaign sheet."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """Exports that may belong to one test.

    Parameters
    ----------
    folder : folder of the test, inside the folder of the campaign's exports; it may be missing
    files : path of each export, keyed by role if the plan pairs by name, otherwise by file name
    values : facts from the names of files and folders, keyed by column of a campaign sheet
    """

    folder: Path
    files: dict[str, Path]
    values: Mapping[str, str] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Name of the folder."""
        return self.folder.name

    @property
    def sheet(self) -> Path:
        """Path of the test sheet, which may be missing."""
        return self.folder / SHEET_NAME

    @property
    def paths(self) -> list[Path]:
        """Paths of the exports and of the test sheet."""
        return [*sorted(self.files.values()), self.sheet]


@dataclass(frozen=True, slots=True)
class CandidateListing:
    """Exports of a campaign, assigned to tests by the rules of its plan.

    Parameters
    ----------
    candidates : tests, sorted by folder
    unused_files : reason why each other file belongs to no test, keyed by file
    """

    candidates: tuple[Candidate, ...]
    unused_files: Mapping[Path, str]


@dataclass(frozen=True, slots=True)
class PairingOutcome:
    """Result of pairing the exports of a test.

    Parameters
    ----------
    sheet : path of the new or existing test sheet; None while exports are missing or unreadable
    messages : remarks on the content of the sheet, or on changed exports
    is_new : whether the sheet was written
    open_keys : keys of the sheet to fill in before the test can be processed
    missing_files : roles without an export, or names of missing exports of an existing sheet
    read_errors : reason why an export cannot be read, keyed by file name
    """

    sheet: Path | None
    messages: tuple[str, ...] = ()
    is_new: bool = False
    open_keys: tuple[str, ...] = ()
    missing_files: tuple[str, ...] = ()
    read_errors: Mapping[str, str] = field(default_factory=dict)


def read_plan(folder: Path) -> CampaignPlan:
    """Read the plan of a campaign from its campaign YAML.

    Parameters
    ----------
    folder : folder of the campaign's exports

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
    """List the tests of a campaign by the rules of its plan, without opening any file.

    Parameters
    ----------
    folder : folder of the campaign's exports
    plan : plan of the campaign
    is_skipped : function that returns whether the test of a folder is left out

    Raises
    ------
    OSError
        If a folder cannot be listed, such as on a lost network drive.
    """
    if isinstance(plan.pair, FolderPair):
        return _list_by_folder(folder, plan.pair, is_skipped)
    return _list_by_name(folder, plan.pair, is_skipped)


_CONTROL_CHARACTERS_IN_NAME = "its name has control characters; rename it"


def _list_by_folder(
    folder: Path, pair: FolderPair, is_skipped: Callable[[Path], bool]
) -> CandidateListing:
    """List each folder with files as a test."""
    top_files = filter(_could_be_export, _list_entries(folder)[1])
    unused_files = {folder / name: "it is not in the folder of a test" for name in top_files}
    candidates = []
    for test_folder, names in _walk_test_folders(folder, is_skipped):
        files = {name: test_folder / name for name in names if _could_be_export(name)}
        for name in filter(has_control_characters, list(files)):
            unused_files[files.pop(name)] = _CONTROL_CHARACTERS_IN_NAME
        values = {} if pair.name is None else pair.name.match(test_folder.name)
        if pair.name is not None and values is None:
            reason = f"the name of its folder does not fit {pair.name.text!r}"
            unused_files |= dict.fromkeys(files.values(), reason)
        elif files or SHEET_NAME in names:
            candidates.append(Candidate(test_folder, files, values or {}))
    return CandidateListing(tuple(candidates), unused_files)


def _walk_test_folders(
    folder: Path, is_skipped: Callable[[Path], bool]
) -> Iterator[tuple[Path, list[str]]]:
    """Yield the topmost folders with files below a folder, and the names of these files."""
    for subfolder in _list_entries(folder)[0]:
        if is_skipped(subfolder):
            continue
        if names := _list_entries(subfolder)[1]:
            yield subfolder, names
        else:
            yield from _walk_test_folders(subfolder, is_skipped)


def _list_by_name(
    folder: Path, pair: NamePair, is_skipped: Callable[[Path], bool]
) -> CandidateListing:
    """Assign exports to one test if their names have the same values in the patterns."""
    top, patterns = folder / pair.source, pair.exports
    candidates: dict[tuple[str, ...], Candidate] = {}
    unused_files: dict[Path, str] = {}
    depth = 1 + max(pattern.text.count("/") for pattern in patterns.values())
    for name in _walk_exports(top, depth=depth):
        path = top / name
        matches = {role: pattern.match(name) for role, pattern in patterns.items()}
        values_by_role = {role: values for role, values in matches.items() if values is not None}
        if has_control_characters(name):
            unused_files[path] = _CONTROL_CHARACTERS_IN_NAME
        elif not values_by_role:
            unused_files[path] = "its name fits no pattern in campaign.yaml"
        elif len(values_by_role) > 1:
            unused_files[path] = f"its name fits several patterns: {', '.join(values_by_role)}"
        else:
            ((role, values),) = values_by_role.items()
            key = tuple(f"{field}={values[field].casefold()}" for field in sorted(values))
            test = make_test_name(values.get("test") or patterns[role].get_stem(name))
            files = candidates.setdefault(key, Candidate(folder / test, {}, values)).files
            if files.setdefault(role, path) != path:
                unused_files[path] = f"{files[role].name} is already the {role} of the same test"
    tests = [candidate for candidate in candidates.values() if not is_skipped(candidate.folder)]
    tests.sort(key=lambda candidate: candidate.name)
    return CandidateListing(tuple(tests), unused_files)


def _walk_exports(top: Path, depth: int, prefix: str = "") -> Iterator[str]:
    """Yield the names of possible exports in a folder and its subfolders.

    Subfolders with a test sheet are left out.

    Parameters
    ----------
    top : folder
    depth : number of levels of folders, 1 for the folder alone
    prefix : path of the folder relative to the topmost one, with a slash at the end
    """
    folders, names = _list_entries(top)
    if prefix and SHEET_NAME in names:
        return
    yield from (f"{prefix}{name}" for name in names if _could_be_export(name))
    for folder in folders if depth > 1 else ():
        yield from _walk_exports(folder, depth - 1, f"{prefix}{folder.name}/")


def _list_entries(folder: Path) -> tuple[list[Path], list[str]]:
    """List the visible subfolders of a folder and the names of its visible files, sorted."""
    with os.scandir(folder) as entries:
        visible_entries = [entry for entry in entries if not entry.name.startswith(".")]
        folders = sorted(folder / entry.name for entry in visible_entries if entry.is_dir())
        return folders, sorted(entry.name for entry in visible_entries if entry.is_file())


def _could_be_export(name: str) -> bool:
    """Return whether the ending of a file name is not that of a sheet or of notes."""
    return not name.casefold().endswith((".yaml", ".yml", ".md", ".ini"))


def collect_columns(plan: CampaignPlan, candidate: Candidate) -> dict[str, str]:
    """Collect facts about a test from the plan and the names of its folder and files.

    Parameters
    ----------
    plan : plan of the campaign
    candidate : exports of the test

    Returns
    -------
    Texts, keyed by column of a campaign sheet.
    """
    columns = {key: str(plan.specimen[key]) for key in _SPECIMEN_COLUMNS if key in plan.specimen}
    columns |= {"operator": plan.operator} if plan.operator else {}
    columns |= {"protocol": plan.protocol} if plan.protocol else {}
    columns |= {key: value for key, value in candidate.values.items() if key != "test"}
    columns["test"] = make_test_name(candidate.name)
    if isinstance(plan.pair, NamePair):
        columns |= {role: path.name for role, path in candidate.files.items()}
    return columns


def pair_test(candidate: Candidate, plan: CampaignPlan, stable_time: float = 0.0) -> PairingOutcome:
    """Write the sheet of a test once all its exports exist and can be read.

    Parameters
    ----------
    candidate : exports of the test, which no longer change
    plan : plan of the campaign
    stable_time : time since a change of the exports was last seen, s

    Returns
    -------
    The sheet, or the missing roles or unreadable exports. An existing sheet is never overwritten.

    Raises
    ------
    LabpipeError
        If a file cannot be copied or written, or the names or the plan have a fault.
    """
    if candidate.sheet.exists():
        return _check_sheet(candidate)
    if isinstance(plan.pair, NamePair):
        roles = plan.pair.exports if plan.wait_for is None else plan.wait_for
        if absent_roles := tuple(role for role in roles if role not in candidate.files):
            return PairingOutcome(None, missing_files=absent_roles)
    copies = _copy_exports(candidate)
    other_tests = read_campaign_tests(candidate.folder.resolve().parent)
    test = infer_test(
        candidate.folder, collect_columns(plan, candidate), campaign_tests=other_tests
    )
    protocol_counts = count_protocols(other_tests, candidate.folder)
    missing_roles = _find_missing_roles(test, plan, protocol_counts, stable_time)
    if test.read_errors or missing_roles:
        # Another program may still write the originals, and the copies may be incomplete.
        for copy in copies:
            copy.unlink(missing_ok=True)
        with suppress(OSError):  # the folder is not empty
            if copies:
                candidate.folder.rmdir()
        return PairingOutcome(None, missing_files=missing_roles, read_errors=test.read_errors)
    # These facts of the plan have no column in a campaign sheet.
    specimen = {key: value for key, value in plan.specimen.items() if key not in _SPECIMEN_COLUMNS}
    overrides = {key: override.model_dump() for key, override in plan.overrides.items()}
    completed_test = replace(test, blocks={"specimen": specimen, "overrides": overrides})
    sheet = write_inferred_sheet(completed_test)
    return PairingOutcome(sheet.path, sheet.remarks, is_new=True, open_keys=sheet.open_keys)


def _check_sheet(candidate: Candidate) -> PairingOutcome:
    """Find missing and changed exports of a test that has a sheet."""
    try:
        sheet = load_test_sheet(candidate.sheet)
    except ProtocolError:
        return PairingOutcome(candidate.sheet)  # processing reports the fault
    names = chain.from_iterable(sheet.files.values())
    missing_files = tuple(name for name in names if not (candidate.folder / name).exists())
    if missing_files:
        return PairingOutcome(None, missing_files=missing_files)
    originals = [path for path in candidate.files.values() if path.parent != candidate.folder]
    changed_files = [path for path in originals if _differs(path, candidate.folder / path.name)]
    messages = [format_sentence("campaign.newer_export", file=path.name) for path in changed_files]
    return PairingOutcome(candidate.sheet, tuple(messages))


def _differs(path: Path, copy: Path) -> bool:
    """Return whether an export differs from its copy in size or modification time.

    A missing copy does not differ. Times are compared in whole seconds, since some drives store
    no fractions.
    """
    if not copy.exists():
        return False
    original, copied = path.stat(), copy.stat()
    return (original.st_size, int(original.st_mtime)) != (copied.st_size, int(copied.st_mtime))


def _find_missing_roles(
    test: InferredTest, plan: CampaignPlan, protocol_counts: Counter[str], stable_time: float
) -> tuple[str, ...]:
    """Find the missing roles, from the inferred test and the protocols of other tests.

    If the plan states `wait_for`, only these roles are required. If it names no protocol, the test
    has the most frequent protocol of the other tests if its roles include the exports, otherwise
    the inferred protocol. An optional export counts as missing for the `patience` of the plan if
    the plan names the protocol, or if another protocol with these exports requires it: a protocol
    of the other tests or, if none has these exports, any protocol.

    Parameters
    ----------
    test : facts of the test from its exports
    plan : plan of the campaign
    protocol_counts : number of other tests with each protocol, keyed by name of the protocol
    stable_time : time since a change of the exports was last seen, s
    """
    required_roles: list[str] = [*(plan.wait_for or ())]
    optional_roles: list[str] = []
    if plan.wait_for is None and plan.protocol:
        sources = _load_sources(plan.protocol, test.folder)
        required_roles, optional_roles = _list_required_roles(sources), [*sources]
    elif plan.wait_for is None:
        possible_sources = _filter_sources(
            test, (_load_sources(name, test.folder) for name in protocol_counts)
        ) or _filter_sources(test, (protocol.sources for protocol in load_all_protocols()))
        sources = _load_sources(find_majority(protocol_counts), test.folder)
        if sources not in possible_sources:
            sources = _load_sources(test.values.get("protocol", ""), test.folder)
        possible_roles = set(chain.from_iterable(map(_list_required_roles, possible_sources)))
        required_roles = _list_required_roles(sources)
        optional_roles = [role for role in sources if role in possible_roles]
    missing_roles = [role for role in required_roles if role not in test.files]
    if not missing_roles and stable_time < plan.patience:
        missing_roles = [role for role in optional_roles if role not in test.files]
    return tuple(missing_roles)


def _filter_sources(
    test: InferredTest, source_maps: Iterable[Mapping[Role, Source]]
) -> list[Mapping[Role, Source]]:
    """Return the sources of those protocols that have all roles of the exports of a test."""
    return [sources for sources in source_maps if sources and sources.keys() >= test.files.keys()]


def _load_sources(name: str, folder: Path) -> Mapping[Role, Source]:
    """Load the sources of a protocol, keyed by role; empty for an unknown or faulty protocol."""
    with suppress(LabpipeError):
        file = find_protocol(name, sheet_folder=folder) if name else None
        return load_protocol(file).sources if isinstance(file, Path) else {}
    return {}


def _list_required_roles(sources: Mapping[Role, Source]) -> list[str]:
    """List the roles whose sources are not optional."""
    return [role for role, source in sources.items() if not source.optional]


def _copy_exports(candidate: Candidate) -> list[Path]:
    """Copy exports into the folder of their test, and return the paths of new copies."""
    copies = []
    for path in candidate.files.values():
        copy = candidate.folder / path.name
        if path == copy:
            continue
        if copy.exists():
            if _differs(path, copy):
                raise StoreError.about("campaign.other_copy", copy, source=path)
            continue
        with map_errors(copy):
            candidate.folder.mkdir(parents=True, exist_ok=True)
            with replace_file(copy) as temporary_file:
                shutil.copy2(path, temporary_file)
        copies.append(copy)
    return copies
