"""Pairing exports to tests: one folder per test, or by the patterns of their names."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.errors import LabpipeError, ProtocolError, StoreError, error_text
from labpipe.process.protocol_match import all_protocols, majority
from labpipe.process.sheet_inference import InferredTest, infer_test, neighbours_in, safe_name
from labpipe.process.sheet_writing import write_seen
from labpipe.protocol.campaign_plan import PLAN_NAME, ByFolder, ByName, CampaignPlan
from labpipe.protocol.load import (
    find_protocol,
    load_campaign_plan,
    load_protocol,
    load_test_sheet,
)
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import Role, Source
from labpipe.protocol.values import has_control_characters
from labpipe.store.replace import replacing, storing

_COLUMNS = ("type", "spool", "sample", "length", "span", "width", "thickness", "diameter")
"""Keys of a specimen that are columns of a campaign's table, too."""
_OTHER = (".yaml", ".yml", ".md", ".ini")


@dataclass(frozen=True, slots=True)
class Candidate:
    """Exports that may be those of one test.

    Parameters
    ----------
    folder : of the test, below that of the campaign; need not be there yet
    files : where each export lies now; by role where the plan says the roles, else by name
    values : what the names say, by column of a campaign's table
    by_role : whether the keys of `files` are roles
    """

    folder: Path
    files: Mapping[str, Path]
    values: Mapping[str, str] = field(default_factory=dict)
    by_role: bool = False

    @property
    def name(self) -> str:
        """Of the folder."""
        return self.folder.name

    @property
    def sheet(self) -> Path:
        """Where its test sheet is, or will be."""
        return self.folder / SHEET_NAME


@dataclass(frozen=True, slots=True)
class RawListing:
    """What lies where exports come to.

    Parameters
    ----------
    candidates : tests, by name
    strangers : files that no rule takes, with the reason
    """

    candidates: tuple[Candidate, ...]
    strangers: Mapping[Path, str]


@dataclass(frozen=True, slots=True)
class Written:
    """What became of a test that was to get its sheet.

    Parameters
    ----------
    sheet : that was written, or was there; None where it is waited for more
    said : sentences on what the sheet is made of, or on what is odd
    is_new : whether the sheet was written now
    open : keys that a person must fill in before the test can be processed
    missing : roles that are waited for
    unread : exports that cannot be read as they are, with the reason
    """

    sheet: Path | None
    said: tuple[str, ...] = ()
    is_new: bool = False
    open: tuple[str, ...] = ()
    missing: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)


def plan_of(folder: Path) -> CampaignPlan:
    """Read the campaign YAML of a folder; one folder per test where there is none.

    Parameters
    ----------
    folder : of the campaign's exports

    Raises
    ------
    ProtocolError
        If anything is wrong with it.
    """
    path = folder / PLAN_NAME
    return load_campaign_plan(path) if path.exists() else CampaignPlan(version=1)


def list_candidates(
    folder: Path, plan: CampaignPlan, *, rests: Callable[[Path], bool] = lambda _: False
) -> RawListing:
    """List the tests of a campaign by its rules, without opening a file.

    Parameters
    ----------
    folder : of the campaign's exports
    plan : its rules
    rests : whether the test of a folder is left out this time

    Raises
    ------
    OSError
        If a folder cannot be listed, as when a network drive is gone.
    """
    if isinstance(plan.pair, ByName):
        listed = _by_name(folder, plan.pair)
        kept = tuple(candidate for candidate in listed.candidates if not rests(candidate.folder))
        return RawListing(kept, listed.strangers)
    return _by_folder(folder, plan.pair, rests)


def _by_folder(folder: Path, pair: ByFolder, rests: Callable[[Path], bool]) -> RawListing:
    candidates, strangers = list[Candidate](), dict[Path, str]()
    for place in _test_folders(folder, rests):
        files = {name: place / name for name in _names(place) if _may_be_export(name)}
        for name in [file for file in files if has_control_characters(file)]:
            strangers[files.pop(name)] = "its name has control characters; rename it"
        values = _folder_values(place, pair)
        if values is None:
            strangers |= dict.fromkeys(files.values(), f"its folder is not called {pair.name!r}")
        elif files or (place / SHEET_NAME).exists():
            candidates.append(Candidate(place, files, values))
    loose = [folder / name for name in _names(folder) if _may_be_export(name)]
    strangers |= dict.fromkeys(loose, "it is in no folder of a test")
    return RawListing(tuple(candidates), strangers)


def _test_folders(folder: Path, rests: Callable[[Path], bool]) -> Iterator[Path]:
    """Folders below one that hold files, but none below those."""
    for place in _folders(folder):
        if rests(place):
            continue
        if _names(place):
            yield place
        else:
            yield from _test_folders(place, rests)


def _folder_values(place: Path, pair: ByFolder) -> dict[str, str] | None:
    """What the name of a folder says; None where it is not of the plan's pattern."""
    return {} if pair.pattern is None else pair.pattern.match(place.name)


def _by_name(folder: Path, pair: ByName) -> RawListing:
    top = folder / pair.source
    patterns = pair.patterns
    found: dict[tuple[str, ...], dict[str, Path]] = {}
    names: dict[tuple[str, ...], tuple[str, dict[str, str]]] = {}
    strangers: dict[Path, str] = {}
    for name in _below(
        top, depth=1 + max(pattern.text.count("/") for pattern in patterns.values())
    ):
        roles = {role: pattern.match(name) for role, pattern in patterns.items()}
        fits = {role: values for role, values in roles.items() if values is not None}
        if has_control_characters(name):
            strangers[top / name] = "its name has control characters; rename it"
        elif not fits:
            strangers[top / name] = "its name is of no pattern in campaign.yaml"
        elif len(fits) > 1:
            strangers[top / name] = f"its name is of several patterns: {', '.join(fits)}"
        else:
            ((role, values),) = fits.items()
            key = tuple(f"{key}={values[key].casefold()}" for key in sorted(values))
            if role in found.setdefault(key, {}):
                other = found[key][role].name
                strangers[top / name] = f"{other} is the {role} of the same test already"
                continue
            found[key][role] = top / name
            test = values.get("test") or patterns[role].stem(name)
            names.setdefault(key, (safe_name(test), values))
    candidates = [
        Candidate(folder / names[key][0], files, names[key][1], by_role=True)
        for key, files in found.items()
    ]
    return RawListing(tuple(sorted(candidates, key=lambda candidate: candidate.name)), strangers)


def _names(folder: Path) -> list[str]:
    """Files of a folder by name, none that are hidden."""
    with os.scandir(folder) as entries:
        return sorted(x.name for x in entries if x.is_file() and not x.name.startswith("."))


def _folders(folder: Path) -> list[Path]:
    with os.scandir(folder) as entries:
        names = [x.name for x in entries if x.is_dir() and not x.name.startswith(".")]
    return [folder / name for name in sorted(names)]


def _below(top: Path, depth: int, prefix: str = "") -> Iterator[str]:
    """Files down to a depth, with slashes; none in a folder that is a test already."""
    if prefix and (top / SHEET_NAME).exists():
        return
    yield from (f"{prefix}{name}" for name in _names(top) if _may_be_export(name))
    if depth > 1:
        for place in _folders(top):
            yield from _below(place, depth - 1, f"{prefix}{place.name}/")


def _may_be_export(name: str) -> bool:
    return not name.casefold().endswith(_OTHER)


def given_by(plan: CampaignPlan, candidate: Candidate) -> dict[str, str]:
    """Collect what the plan and the names say about a test, by column of a campaign's table.

    Parameters
    ----------
    plan : of the campaign
    candidate : the test
    """
    given = {key: str(plan.specimen[key]) for key in _COLUMNS if key in plan.specimen}
    given |= {"operator": plan.operator} if plan.operator else {}
    given |= {"protocol": plan.protocol} if plan.protocol else {}
    given |= {key: value for key, value in candidate.values.items() if key != "test"}
    named = dict(candidate.files) if candidate.by_role else {}
    return (
        given
        | {"test": safe_name(candidate.name)}
        | {role: path.name for role, path in named.items()}
    )


def pair_test(candidate: Candidate, plan: CampaignPlan, *, waited: float = 0.0) -> Written:
    """Write the sheet of a test, once all its exports are there and can be read.

    Parameters
    ----------
    candidate : the test, its files standing still
    plan : of the campaign
    waited : s, since the last of its files came

    Returns
    -------
    The sheet, or what is waited for. A sheet that is there already is never written over.

    Raises
    ------
    LabpipeError
        If a file cannot be copied or written, or names and plan say something wrong.
    """
    if candidate.sheet.exists():
        return _with_sheet(candidate)
    early = _missing_by_name(candidate, plan)
    if early:
        return Written(None, missing=early)
    copies = _bring_together(candidate)
    around = neighbours_in(candidate.folder.resolve().parent)
    seen = infer_test(candidate.folder, given_by(plan, candidate), neighbours=around)
    missing = _missing(seen, plan, around.beside(candidate.folder), waited)
    if seen.unread or missing:
        _take_back(copies, candidate.folder)
        return Written(None, missing=missing, unread=seen.unread)
    sheet = write_seen(with_blocks(seen, plan))
    return Written(sheet.path, sheet.said, is_new=True, open=sheet.open)


def _with_sheet(candidate: Candidate) -> Written:
    """Say what a test with a sheet waits for: exports that the sheet names."""
    try:
        sheet = load_test_sheet(candidate.sheet)
    except ProtocolError:
        return Written(candidate.sheet)  # processing says what is wrong with it
    names = [name for several in sheet.files.values() for name in several]
    absent = tuple(name for name in names if not (candidate.folder / name).exists())
    if absent:
        return Written(None, missing=absent)
    elsewhere = [path for path in candidate.files.values() if path.parent != candidate.folder]
    newer = [path.name for path in elsewhere if _differs(path, candidate.folder / path.name)]
    said = [f"{name} is another one than its copy in the folder of the test" for name in newer]
    return Written(
        candidate.sheet, tuple(f"look: {sentence}; the copy counts" for sentence in said)
    )


def _differs(path: Path, copy: Path) -> bool:
    """Whether an export was written again after it was copied; by size and time."""
    if not copy.exists():
        return False
    one, other = path.stat(), copy.stat()
    return (one.st_size, int(one.st_mtime)) != (other.st_size, int(other.st_mtime))


def with_blocks(seen: InferredTest, plan: CampaignPlan) -> InferredTest:
    """Add what the plan says of every test and no column holds: labels, bundle, overrides.

    Parameters
    ----------
    seen : a test
    plan : of the campaign
    """
    rest = {key: value for key, value in plan.specimen.items() if key not in _COLUMNS}
    overrides = {key: override.model_dump() for key, override in plan.overrides.items()}
    return replace(seen, blocks={"specimen": rest, "overrides": overrides})


def _missing_by_name(candidate: Candidate, plan: CampaignPlan) -> tuple[str, ...]:
    """Roles that the patterns name, are needed, and have no file yet."""
    if not candidate.by_role:
        return ()
    return tuple(role for role in _needed(plan, candidate) if role not in candidate.files)


def _needed(plan: CampaignPlan, candidate: Candidate) -> Sequence[str]:
    if plan.wait_for is not None:
        return plan.wait_for
    return list(plan.pair.exports) if isinstance(plan.pair, ByName) else list(candidate.files)


def _missing(
    seen: InferredTest, plan: CampaignPlan, others: Mapping[str, int], waited: float
) -> tuple[str, ...]:
    """Roles that are waited for, by what was seen in the folder and what other tests are."""
    if plan.wait_for is not None:
        return tuple(role for role in plan.wait_for if role not in seen.files)
    needed, optional = _roles(seen, plan, others)
    missing = [role for role in needed if role not in seen.files]
    late = [role for role in optional if role not in seen.files]
    return tuple(missing or (late if waited < plan.patience else []))


def _roles(
    seen: InferredTest, plan: CampaignPlan, others: Mapping[str, int]
) -> tuple[list[str], list[str]]:
    """Roles that a test needs, and those that it may lack and that are waited for a while.

    Where the plan names no protocol, the test is taken for one like most others as long as its
    exports may be of such a one; and an export that it may lack is waited for only if another
    protocol that takes those exports needs it: one of the other tests, or, if none takes them, any.
    """
    if plan.protocol:
        own = _sources(plan.protocol, seen.folder)
        needed = _needed_of(own)
        return needed, [role for role in own if role not in needed]
    of_others = [_sources(name, seen.folder) for name in others if name]
    of_any = (protocol.sources for protocol in all_protocols())
    may_be = _that_take(seen, of_others) or _that_take(seen, of_any)
    usual = _sources(majority(others), seen.folder)
    own = usual if usual in may_be else _sources(seen.values.get("protocol", ""), seen.folder)
    needed = _needed_of(own)
    wanted = {role for sources in may_be for role in _needed_of(sources)}
    return needed, [role for role in own if role in wanted and role not in needed]


def _that_take(
    seen: InferredTest, several: Iterable[Mapping[Role, Source]]
) -> list[Mapping[Role, Source]]:
    return [sources for sources in several if sources.keys() >= seen.files.keys()]


def _sources(name: str, folder: Path) -> Mapping[Role, Source]:
    """Exports of a protocol by role; none where it is not known, or wrong."""
    found = find_protocol(name, beside=folder) if name else None
    with suppress(LabpipeError):
        return load_protocol(found).sources if isinstance(found, Path) else {}
    return {}


def _needed_of(sources: Mapping[Role, Source]) -> list[str]:
    return [role for role, source in sources.items() if not source.optional]


def _bring_together(candidate: Candidate) -> list[Path]:
    """Copy exports that lie elsewhere into the folder of their test; the originals stay."""
    made = []
    for path in candidate.files.values():
        goal = candidate.folder / path.name
        if path == goal:
            continue
        if goal.exists():
            if _differs(path, goal):
                remedy = "Take away the one that is wrong."
                found = "another file of that name"
                raise StoreError(
                    error_text(goal, "", expected=f"a copy of {path}", found=found, remedy=remedy)
                )
            continue
        with storing(goal):
            candidate.folder.mkdir(parents=True, exist_ok=True)
            with replacing(goal) as part:
                shutil.copyfile(path, part)
                shutil.copystat(path, part)
        made.append(goal)
    return made


def _take_back(copies: Sequence[Path], folder: Path) -> None:
    """Take away copies of exports that may still be written."""
    for path in copies:
        path.unlink(missing_ok=True)
    with suppress(OSError):  # where there is more in it
        if copies:
            folder.rmdir()
