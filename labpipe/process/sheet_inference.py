"""Infer a test sheet: what exports and names state, what siblings share, what is left open."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

from labpipe.errors import Fault, LabpipeError, ReadError
from labpipe.process.checking import needs_span
from labpipe.process.export_metadata import (
    FOLDER,
    Fact,
    combine_facts,
    facts_of_export,
    facts_of_folder,
)
from labpipe.process.protocol_match import Fit, all_protocols, marked_length, match_protocols
from labpipe.protocol.load import find_protocol, load_protocol, load_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import MARKER_READERS, ROLES
from labpipe.protocol.values import has_control_characters, is_name_of_a_test
from labpipe.readers import recognise_export
from labpipe.readers.unknown_files import describe_unknown
from labpipe.records.recording import Recording
from labpipe.units import parse_quantity

_FACT_KEYS = ("date", "operator", "type", "sample", "length", "width", "thickness")
_HOW_TO_DECIDE = (
    "what would decide: a folder, export or type called like one of them, or a protocol that most"
    " tests beside it have"
)
_IGNORED_SUFFIXES = frozenset({".yaml", ".yml", ".md", ".ini"})


@dataclass(frozen=True, slots=True, eq=False)
class FolderContents:
    """The files of a folder.

    Parameters
    ----------
    exports : those that can be read
    others : names of other files, and what each appears to be
    unread : names of exports that cannot be read, and the reason: damaged, truncated, locked
    """

    exports: dict[Path, Recording] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)


def read_folder(folder: Path) -> FolderContents:
    """Read the files in the folder of a test; formats are recognised by content.

    Parameters
    ----------
    folder : of the test; a missing folder is empty
    """
    contents = FolderContents()
    for path in files_in(folder):
        if has_control_characters(path.name):
            contents.others[path.name] = "its name has control characters; rename it"
            continue
        try:
            path.open("rb").close()  # raises OSError before the format is recognised
            try:
                reader = recognise_export(path)
            except ReadError:
                contents.others[path.name] = describe_unknown(path).what
            else:
                contents.exports[path] = reader.read(path)
        except (LabpipeError, OSError) as error:
            contents.unread[path.name] = str(error).removeprefix(f"{path}").lstrip(":, ")
    return contents


def files_in(folder: Path) -> list[Path]:
    """List the files of a folder that may be exports, by name, without hidden ones.

    Parameters
    ----------
    folder : of a test
    """
    return [
        path
        for path in (sorted(folder.iterdir()) if folder.is_dir() else [])
        if path.suffix not in _IGNORED_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]


def folders_of_tests(folder: Path) -> list[Path]:
    """List the test folders of a campaign that hold files, by name.

    Parameters
    ----------
    folder : of a campaign

    Returns
    -------
    The folders; none if the folder is that of a test: it has a test sheet, or no folder with files.
    """
    if (folder / SHEET_NAME).exists() or not folder.is_dir():
        return []
    below = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    return [path for path in below if not path.name.startswith(".") and files_in(path)]


@dataclass(frozen=True, slots=True)
class InferredTest:
    """The inferred content of a test sheet.

    Parameters
    ----------
    folder : of the test
    values : text by column of a campaign's table
    files : names of exports by role
    open : required columns without a value, which the user fills in
    remarks : sentences on the sources of the values, and on contradictions
    unread : exports of a known format that cannot be read, with the reason
    blocks : content without a column, by key of the test sheet
    """

    folder: Path
    values: Mapping[str, str]
    files: Mapping[str, tuple[str, ...]]
    open: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)
    blocks: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


@dataclass(slots=True)
class Neighbours:
    """Protocols of the tests of a campaign by folder; empty for a test without one.

    Parameters
    ----------
    tests : type of the specimen and protocol of each test
    """

    tests: dict[Path, tuple[str, str]] = field(default_factory=dict)

    def protocols_beside(self, folder: Path, specimen_type: str | None = None) -> Counter[str]:
        """Count the protocols of the other tests, of all types or of one.

        Parameters
        ----------
        folder : of the test itself
        specimen_type : type of the specimen; None for all
        """
        return Counter(
            protocol
            for other, (other_type, protocol) in self.tests.items()
            if other != folder.resolve() and specimen_type in (None, other_type)
        )


def neighbours_in(campaign: Path) -> Neighbours:
    """Read the protocols of the tests of a campaign.

    Parameters
    ----------
    campaign : folder with the folders of the tests
    """
    neighbours = Neighbours()
    for folder in folders_of_tests(campaign):
        neighbours.tests[folder] = (_named(folder).get("type", ""), "")
        with suppress(LabpipeError, OSError):
            sheet = load_test_sheet(folder / SHEET_NAME)
            neighbours.tests[folder] = (sheet.specimen.type, sheet.protocol)
    return neighbours


def _named(folder: Path) -> dict[str, str]:
    """Return the facts in the name of a folder."""
    return {fact.key: fact.value for fact in facts_of_folder(folder.name)}


def infer_tests(folders: Sequence[Path], stated: Mapping[str, str]) -> Iterator[InferredTest]:
    """Infer several tests of one campaign; the others may decide what one leaves open.

    Parameters
    ----------
    folders : of the tests
    stated : see `infer_test`

    Yields
    ------
    Each test: first those with a definite protocol, then the others. Only the recordings of one
    test are in memory at a time.
    """
    neighbours = neighbours_in(folders[0].resolve().parent) if folders else Neighbours()
    waiting = []
    for folder in folders:
        test = infer_test(folder, stated, neighbours=neighbours)
        if "protocol" in test.open:
            waiting.append(folder)
            continue
        kind, protocol = test.values.get("type", ""), test.values["protocol"]
        neighbours.tests[folder.resolve()] = (kind, protocol)
        yield test
    for folder in waiting:
        yield infer_test(folder, stated, neighbours=neighbours)


def infer_test(
    folder: Path,
    stated: Mapping[str, str],
    *,
    neighbours: Neighbours | None = None,
) -> InferredTest:
    """Infer the test sheet of a folder from its exports.

    Parameters
    ----------
    folder : of the test
    stated : values by column, which have priority over inferred ones
    neighbours : the tests of the campaign; those of the parent folder if None

    Returns
    -------
    The inferred test. Exports that cannot be read are in the remarks and raise nothing.
    """
    contents = read_folder(folder)
    fits = _fits(folder, contents, stated, neighbours or neighbours_in(folder.resolve().parent))
    fit = fits[0] if len(fits) == 1 else None
    unclear = {(role, fit) for fit in fits for role in fit.unclear if role not in stated}
    doubtful = {name for role, fit in unclear for name in fit.files[role]}
    exports = {path: x for path, x in contents.exports.items() if path.name not in doubtful}
    facts, contradictory = combine_facts(_facts(folder, exports))
    facts = {key: facts[key] for key in _FACT_KEYS if key in facts and key not in stated}

    name = safe_name(folder.resolve().name)
    values = {"test": name} | ({"protocol": fit.protocol.name} if fit else {})
    values |= {key: fact.value for key, fact in facts.items()} | dict(stated)
    files = _files(contents, fits) | _stated_files(stated)
    needed = ["protocol", "type", "spool", "sample"]
    needed += ["span"] if fit and needs_span(fit.protocol) else []
    open_keys = [key for key in needed if not values.get(key)]
    open_roles = sorted(fits[0].unclear - {*files}) if fits else []
    open_keys += open_roles or ([] if files else ["files"])

    remarks = [
        *_about_protocol(contents, fits, stated),
        *_about_files(contents, {role: x for role, x in files.items() if role not in stated}),
    ]
    for role in open_roles:
        possible = ", ".join(map(_printable, fits[0].files[role]))
        remarks.append(
            f"{role}: {possible} are all possible, and are not parts of one recording; name one "
            f"with --{role}, and use a folder for each test"
        )
    for where in dict.fromkeys(fact.where for fact in facts.values()):
        parts = [_statement(fact) for fact in facts.values() if fact.where == where]
        remarks.append(f"{', '.join(parts)}: from {where}")
    if "test" not in stated and name != folder.resolve().name:
        remarks.append(f"test: {name}, as a name of a test has no blanks or other signs")
    remarks += [sentence for key, sentence in contradictory.items() if key not in stated]
    remarks += _contradictions(folder, exports, fit, values.get("length", ""))
    used = {name for names in files.values() for name in names}
    remarks += _unused(folder, contents, used | {x for r in open_roles for x in fits[0].files[r]})
    return InferredTest(folder, values, files, tuple(open_keys), tuple(remarks), contents.unread)


def _stated_files(stated: Mapping[str, str]) -> dict[str, tuple[str, ...]]:
    """Return the exports by role that the user named."""
    return {role: file_names(stated[role]) for role in ROLES if role in stated}


def _fits(
    folder: Path, contents: FolderContents, stated: Mapping[str, str], neighbours: Neighbours
) -> list[Fit]:
    """Find the protocols that fit best, by exports, names and the other tests."""
    named = _named(folder)
    kind = stated.get("type") or named.get("type", "")
    of_type = [neighbours.protocols_beside(folder, kind)] if kind else []
    return match_protocols(
        contents.exports,
        _candidates(stated, folder),
        names=(folder.name, kind, *(path.stem for path in contents.exports)),
        length=_metres(stated.get("length") or named.get("length", "")),
        siblings=[*of_type, neighbours.protocols_beside(folder)],
        roles=_stated_files(stated),
    )


def _candidates(stated: Mapping[str, str], folder: Path) -> list[Protocol]:
    """Return the candidate protocols: all, or the one that the user named."""
    if "protocol" not in stated:
        return all_protocols()
    path = find_protocol(stated["protocol"], beside=folder)
    with suppress(LabpipeError):  # a wrong or missing one is reported when the sheet is written
        return [] if isinstance(path, Fault) else [load_protocol(path)]
    return []


def _facts(folder: Path, exports: Mapping[Path, Recording]) -> list[Fact]:
    """Collect facts; the lab chose the name of the folder, which has priority over exports."""
    facts = list(facts_of_folder(folder.name))
    named = {fact.key for fact in facts}
    for path, recording in exports.items():
        for fact in facts_of_export(path.name, recording):
            key = "sample" if fact.key == "specimen" else fact.key
            if key not in {*named, "take"}:
                facts.append(replace(fact, key=key))
    return facts


def _files(contents: FolderContents, fits: Sequence[Fit]) -> dict[str, tuple[str, ...]]:
    """Return exports by role: those on which all protocols that fit agree, or by format."""
    files: dict[str, tuple[str, ...]] = {}
    for path, export in contents.exports.items() if not fits else ():
        role = "frame" if export.reader == "load-frame" else "force"
        role = "markers" if export.reader in MARKER_READERS else role
        files[role] = (*files.get(role, ()), path.name)
    for role, names in fits[0].files.items() if fits else ():
        if all(fit.files.get(role) == names and role not in fit.unclear for fit in fits):
            files[role] = names
    return files


def _about_files(contents: FolderContents, files: Mapping[str, Sequence[str]]) -> Iterator[str]:
    """Yield one sentence on the exports by role that were inferred."""
    readers = {path.name: export.reader for path, export in contents.exports.items()}
    roles = [
        f"{role}: {', '.join(f'{_printable(name)} ({readers[name]})' for name in names)}"
        for role, names in files.items()
    ]
    if roles:
        yield "; ".join(roles)


def _about_protocol(
    contents: FolderContents, fits: Sequence[Fit], stated: Mapping[str, str]
) -> Iterator[str]:
    max_faults = 3
    if "protocol" in stated:
        pass
    elif len(fits) == 1:
        reasons = "; ".join(text for text, weight in fits[0].signs if weight > 0)
        yield f"protocol: {fits[0].protocol.name}" + (f", as {reasons}" if reasons else "")
    elif fits:
        yield "\n    ".join(
            [
                f"protocol: {len(fits)} fit alike; name one with --protocol, or in the sheet",
                *(_described(fit.protocol) for fit in fits),
                _HOW_TO_DECIDE,
            ]
        )
    elif contents.exports:
        yield "protocol: none of those here takes these exports; name one, or write one"
    else:
        is_other = contents.others or contents.unread
        missing = "no export that labpipe can read is" if is_other else "no exports are"
        yield f"protocol: {missing} in this folder; copy the exports there, or use --protocol"
    for fit in fits if len(fits) == 1 else ():
        yield from (f"look: {fault}" for fault in fit.faults[:max_faults] if not fit.unclear)


def _described(protocol: Protocol) -> str:
    """Describe the purpose of a protocol and the sizes that it states."""
    length, rig = protocol.specimen.length, protocol.rig
    sizes = [f"length {length * 1e3:g} mm"] if length else []
    sizes += [f"stroke {rig.stroke * 1e3:g} mm"] if rig.stroke else []
    sizes += [f"speed {rig.crosshead_speed * 1e3:g} mm/s"] if rig.crosshead_speed else []
    return f"{protocol.name}: {'; '.join(filter(None, (protocol.about, ', '.join(sizes))))}"


def _statement(fact: Fact) -> str:
    is_named = fact.where.startswith((FOLDER, "the name of"))
    is_plain = fact.written.startswith(fact.value) or not fact.written or is_named
    return f"{fact.key} {fact.value}" + ("" if is_plain else f" ({fact.written!r})")


def _contradictions(
    folder: Path, exports: Mapping[Path, Recording], fit: Fit | None, length: str
) -> Iterator[str]:
    """Yield contradictions that do not leave a value open."""
    max_length_deviation = 0.05
    name, stated = folder.resolve().name, _metres(length)
    for path, export in exports.items():
        for fact in facts_of_export(path.name, export):
            if fact.key == "take" and fact.value != name and facts_of_folder(fact.value):
                yield f"look: {path.name} is of {fact.value!r}, the folder is called {name!r}"
    if fit is None or not stated:
        return
    for path, export in exports.items():
        reach = marked_length(fit.protocol, export.markers) if export.markers else None
        if reach is not None and abs(reach / stated - 1.0) > max_length_deviation:
            lengths = f"{reach * 1e3:.3g} mm, {length} is stated"
            yield f"look: the markers of {path.name} show a length of about {lengths}"


def _unused(folder: Path, contents: FolderContents, used: set[str]) -> Iterator[str]:
    """Yield a sentence for each file that is not used, or is not there."""
    for path, export in contents.exports.items():
        if path.name not in used:
            yield f"not used: {_printable(path.name)} ({export.reader})"
    for name, why in {**contents.unread, **contents.others}.items():
        if name not in used:
            yield f"not used: {_printable(name)}: {why.splitlines()[0]}"
    for name in sorted(used):
        if not (folder / name).exists():
            yield f"not there yet: {_printable(name)}"


def file_names(text: str) -> tuple[str, ...]:
    """Split the exports of a role, as a table or an option writes them.

    Parameters
    ----------
    text : names, separated by semicolons; empty for none

    Examples
    --------
    >>> file_names("a.csv; b.csv"), file_names("")
    (('a.csv', 'b.csv'), ())
    """
    return tuple(part.strip() for part in text.split(";")) if text else ()


def _metres(text: str) -> float | None:
    with suppress(ValueError):
        return parse_quantity(text, "m") if text else None
    return None


def safe_name(name: str) -> str:
    """Convert any name to a valid name of a test.

    Parameters
    ----------
    name : such as that of a folder

    Examples
    --------
    >>> safe_name("Run 4, (2)"), safe_name("A2-085-1")
    ('Run-4-2', 'A2-085-1')
    """
    if is_name_of_a_test(name):
        return name
    plain = re.sub(r"[^\w.+-]+", "-", name).strip("-.+") or "test"
    return plain if is_name_of_a_test(plain) else f"test-{plain}"[:100]


def _printable(name: str) -> str:
    """Return a printable form of a file name."""
    return name if name.isprintable() else repr(name)[1:-1]
