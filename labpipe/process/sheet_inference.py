"""Infer a test sheet from the exports, from names, and from the other tests of the campaign."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import date
from functools import cache
from importlib.resources import files as package_files
from pathlib import Path
from typing import NamedTuple, TypeAlias

from labpipe.errors import Fault, LabpipeError, ReadError
from labpipe.messages import format_sentence
from labpipe.process.checking import results_needing_span
from labpipe.process.protocol_match import ProtocolMatch, load_all_protocols, match_protocols
from labpipe.protocol.grammar import has_control_characters, is_test_name
from labpipe.protocol.load import find_protocol, load_protocol, load_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import MARKER_READERS, ROLES
from labpipe.readers import recognise_export
from labpipe.readers.unknown_files import describe_unknown
from labpipe.records.recording import Recording
from labpipe.units import parse_quantity

_COPIED_FACTS = ("date", "operator", "type", "sample", "length", "width", "thickness")
"""Facts that become values of a test sheet."""
_IGNORED_SUFFIXES = frozenset({".yaml", ".yml", ".md", ".ini"})
FOLDER_NAME = "the name of the folder"
_YEAR_FIRST = re.compile(r"(?<!\d)(\d{4})[-./](\d{1,2})[-./](\d{1,2})(?!\d)")
_YEAR_LAST = re.compile(r"(?<!\d)(\d{1,2})([-./])(\d{1,2})\2(\d{4})(?!\d)(.*)", re.DOTALL)
_COMPACT_DATE = re.compile(r"(?<!\d)(20\d\d)(\d\d)(\d\d)(?!\d)")
_US_CLOCK = re.compile(r"\s+\d{1,2}:\d\d(?::\d\d)?\s*(?:AM|PM)\b")
"""12-hour clock in capitals, the US format of Windows, which puts the month first."""
_FOLDER_NAME = re.compile(r"(?P<type>.+?)(?:-(?P<length>\d{3})(?=-))?[-_](?P<sample>\d{1,3}[a-z]?)")


class Fact(NamedTuple):
    """One fact about a test and its source.

    Parameters
    ----------
    key : column of a campaign table: ``date``, ``operator``, ``type``, ``sample``, ``length`` ...
    value : as a test sheet writes it
    source : such as ``force.mat``
    """

    key: str
    value: str
    source: str


@cache
def _fact_keys() -> dict[str, dict[str, list[str]]]:
    text = (package_files("labpipe.process") / "sheet_facts.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def collect_export_facts(name: str, recording: Recording) -> tuple[Fact, ...]:
    """Collect the facts about the test that the metadata of an export state.

    Parameters
    ----------
    name : of the file; a date in it is used if the metadata have none
    recording : from its reader

    Returns
    -------
    The facts. The modification time of the file is not one of them, because copying changes it.
    """
    entries = dict[str, str]()
    for entry, text in _metadata_entries(recording.metadata):
        entries.setdefault(entry, text)
    facts = list[Fact]()
    for key, names in _fact_keys()["keys"].items():
        values = filter(None, (_parse_fact(key, entries.get(entry, "")) for entry in names))
        facts += [Fact(key, value, name) for value in list(values)[:1]]
    if all(fact.key != "date" for fact in facts) and (day := parse_day(name)):
        facts.append(Fact("date", day, f"the name of {name}"))
    return tuple(facts)


def _metadata_entries(metadata: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield metadata entries by the last part of their key."""
    for key, value in metadata.items():
        if isinstance(value, Mapping) and key not in _fact_keys()["entries"]["lists"]:
            yield from _metadata_entries(value)
        yield key.rpartition(" : ")[2].strip(), str(value).strip()


def _parse_fact(key: str, text: str) -> str:
    """Return the value of a metadata entry; empty if it was not filled in or does not fit."""
    if key == "date":
        return parse_day(text)
    if key in ("length", "width", "thickness"):
        return text if (_parse_metres(text) or 0.0) > 0.0 else ""
    return "" if text.casefold() in _fact_keys()["entries"]["empty"] else text


def parse_folder_name(name: str) -> tuple[Fact, ...]:
    """Parse a folder name such as ``A2-085-1``: type, length in mm, sample.

    Parameters
    ----------
    name : of the folder of a test

    Returns
    -------
    The facts; none if the name has another form, or holds a date.

    Examples
    --------
    >>> [(fact.key, fact.value) for fact in parse_folder_name("A2-085-1")]
    [('type', 'A2'), ('length', '85 mm'), ('sample', '1')]
    >>> [(fact.key, fact.value) for fact in parse_folder_name("CWB-2a-3")]
    [('type', 'CWB-2a'), ('sample', '3')]
    >>> parse_folder_name("Test Run 4 10-23-2023 6 43 09 PM")
    ()
    """
    if parse_day(name) or _YEAR_LAST.search(name):
        return ()
    match = _FOLDER_NAME.fullmatch(name)
    parts = match.groupdict("") if match else {}
    if parts.get("length"):
        parts["length"] = f"{int(parts['length'])} mm"
    return tuple(Fact(key, value, FOLDER_NAME) for key, value in parts.items() if value)


def parse_day(text: str) -> str:
    """Parse the first date in a text.

    Parameters
    ----------
    text : such as ``27.02.2015`` or ``10/26/2022 1:02:25 PM``

    Returns
    -------
    ISO date; empty if there is none, or if the order of day and month is ambiguous.

    Examples
    --------
    >>> parse_day("27.02.2015"), parse_day("10/26/2022 13:02"), parse_day("3/11/2026 10:05:00 AM")
    ('2015-02-27', '2022-10-26', '2026-03-11')
    >>> parse_day("03/09/2026 10:05:00")
    ''
    """
    if match := _YEAR_FIRST.search(text) or _COMPACT_DATE.search(text):
        return _iso_date(*match.groups())
    if not (match := _YEAR_LAST.search(text)):
        return ""
    first, separator, second, year, remainder = match.groups()
    day_first, month_first = _iso_date(year, second, first), _iso_date(year, first, second)
    if separator == "." or not month_first:
        return day_first
    is_unambiguous = _US_CLOCK.match(remainder) or day_first in ("", month_first)
    return month_first if is_unambiguous else ""


def _iso_date(year: str, month: str, day: str) -> str:
    with suppress(ValueError):
        return date(int(year), int(month), int(day)).isoformat()
    return ""


def combine_facts(facts: Iterable[Fact]) -> tuple[dict[str, Fact], dict[str, str]]:
    """Combine the facts of several sources about one test.

    Parameters
    ----------
    facts : of its exports and of its folder

    Returns
    -------
    agreed : by key, the facts on which all sources agree; `Fact.source` names all of them
    contradictions : by key, a sentence on the different values
    """
    sources: dict[str, dict[str, list[str]]] = {}
    for key, value, source in facts:
        sources.setdefault(key, {}).setdefault(value, []).append(source)
    agreed, contradictions = dict[str, Fact](), dict[str, str]()
    for key, by_value in sources.items():
        stated = {value: " and ".join(dict.fromkeys(names)) for value, names in by_value.items()}
        if len(stated) == 1:
            agreed[key] = Fact(key, *next(iter(stated.items())))
        else:
            listed = ", ".join(f"{value} in {names}" for value, names in stated.items())
            text = format_sentence("process.facts_differ", key=key, statements=listed)
            contradictions[key] = text
    return agreed, contradictions


@dataclass(frozen=True, slots=True, eq=False)
class FolderContents:
    """The files of a folder.

    Parameters
    ----------
    exports : those that can be read
    others : what each other file appears to be, by name
    unread : why an export cannot be read (damaged, truncated, locked), by name
    """

    exports: dict[Path, Recording] = field(default_factory=dict)
    others: dict[str, str] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)


def read_folder(folder: Path) -> FolderContents:
    """Read the exports in the folder of a test; formats are recognised by content.

    Parameters
    ----------
    folder : of the test; a missing folder is empty
    """
    contents = FolderContents()
    for path in list_possible_exports(folder):
        if has_control_characters(path.name):
            contents.others[path.name] = format_sentence("process.control_characters")
            continue
        try:
            path.open("rb").close()  # raises OSError before the format is recognised
            try:
                reader = recognise_export(path)
            except ReadError:
                contents.others[path.name] = describe_unknown(path).kind
            else:
                contents.exports[path] = reader.read(path)
        except (LabpipeError, OSError) as error:
            contents.unread[path.name] = str(error).removeprefix(f"{path}").lstrip(":, ")
    return contents


def list_possible_exports(folder: Path) -> list[Path]:
    """List the files of a folder that may be exports, by name, without hidden ones.

    Parameters
    ----------
    folder : of a test; a missing folder is empty
    """
    return [
        path
        for path in (sorted(folder.iterdir()) if folder.is_dir() else [])
        if path.suffix not in _IGNORED_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]


def list_test_folders(folder: Path) -> list[Path]:
    """List the test folders of a campaign that may hold exports, by name.

    Parameters
    ----------
    folder : of a campaign

    Returns
    -------
    The folders; none if the folder itself holds a test sheet, or does not exist.
    """
    if (folder / SHEET_NAME).exists() or not folder.is_dir():
        return []
    below = [path for path in sorted(folder.iterdir()) if path.is_dir()]
    return [path for path in below if not path.name.startswith(".") and list_possible_exports(path)]


Neighbours: TypeAlias = dict[Path, tuple[str, str]]
"""Specimen type and protocol of each test of a campaign, by folder; empty if unknown."""


def read_neighbours(campaign: Path) -> Neighbours:
    """Read the specimen types and protocols of the tests of a campaign.

    Parameters
    ----------
    campaign : folder with the folders of the tests
    """
    neighbours: Neighbours = {}
    for folder in list_test_folders(campaign):
        neighbours[folder] = (_values_in_name(folder).get("type", ""), "")
        with suppress(LabpipeError, OSError):
            sheet = load_test_sheet(folder / SHEET_NAME)
            neighbours[folder] = (sheet.specimen.type, sheet.protocol)
    return neighbours


def count_protocols(
    neighbours: Neighbours, folder: Path, specimen_type: str | None = None
) -> Counter[str]:
    """Count the protocols of the other tests of a campaign.

    Parameters
    ----------
    neighbours : tests of the campaign
    folder : of the test itself, which is not counted
    specimen_type : type of the counted specimens; None for all

    Returns
    -------
    Number of tests by protocol; under an empty name, those without one.
    """
    return Counter(
        protocol
        for other, (other_type, protocol) in neighbours.items()
        if other != folder.resolve() and specimen_type in (None, other_type)
    )


def _values_in_name(folder: Path) -> dict[str, str]:
    return {fact.key: fact.value for fact in parse_folder_name(folder.name)}


@dataclass(frozen=True, slots=True)
class InferredTest:
    """The inferred content of a test sheet.

    Parameters
    ----------
    folder : of the test
    values : text by column of a campaign table
    files : names of exports by role
    open : required columns and roles without a value, which the user fills in
    remarks : sentences on the sources of the values, and on contradictions
    unread : why an export of a known format cannot be read, by name
    blocks : content without a column, by key of the test sheet
    """

    folder: Path
    values: Mapping[str, str]
    files: Mapping[str, tuple[str, ...]]
    open: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    unread: Mapping[str, str] = field(default_factory=dict)
    blocks: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


def infer_tests(folders: Sequence[Path], stated: Mapping[str, str]) -> Iterator[InferredTest]:
    """Infer several tests of one campaign.

    Parameters
    ----------
    folders : of the tests
    stated : see `infer_test`

    Yields
    ------
    Each test: first those whose exports decide the protocol, then the others, for which the
    protocols of the first ones count. Only the recordings of one test are in memory at a time.
    """
    neighbours = read_neighbours(folders[0].resolve().parent) if folders else {}
    undecided = []
    for folder in folders:
        test = infer_test(folder, stated, neighbours=neighbours)
        if "protocol" in test.open:
            undecided.append(folder)
            continue
        specimen_type, protocol = test.values.get("type", ""), test.values["protocol"]
        neighbours[folder.resolve()] = (specimen_type, protocol)
        yield test
    for folder in undecided:
        yield infer_test(folder, stated, neighbours=neighbours)


def infer_test(
    folder: Path, stated: Mapping[str, str], *, neighbours: Neighbours | None = None
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
    if neighbours is None:
        neighbours = read_neighbours(folder.resolve().parent)
    contents = read_folder(folder)
    matches = _match(folder, contents, stated, neighbours)
    match = matches[0] if len(matches) == 1 else None
    stated_files = {role: split_file_names(stated[role]) for role in ROLES if role in stated}
    ambiguous = {
        role: candidate.files[role]
        for candidate in matches
        for role in sorted(candidate.ambiguous_roles - stated_files.keys())
    }
    unclear = {name for names in ambiguous.values() for name in names}
    exports = {path: x for path, x in contents.exports.items() if path.name not in unclear}
    agreed, contradictions = combine_facts(_collect_facts(folder, exports))
    facts = [agreed[key] for key in _COPIED_FACTS if key in agreed and key not in stated]
    values = {"test": safe_name(folder.resolve().name)}
    values |= {"protocol": match.protocol.name} if match else {}
    values |= {fact.key: fact.value for fact in facts} | dict(stated)
    inferred_files = _assign_files(contents, matches)
    files = inferred_files | stated_files
    required = ["protocol", "type", "spool", "sample"]
    required += ["span"] if match and results_needing_span(match.protocol) else []
    open_keys = [key for key in required if not values.get(key)]
    open_keys += sorted(ambiguous) or ([] if files else ["files"])
    own_files = {role: x for role, x in inferred_files.items() if role not in stated_files}
    used = unclear.union(*files.values())
    remarks = [
        *([] if "protocol" in stated else [_describe_match(contents, matches)]),
        *_describe_files(contents, own_files, ambiguous),
        *_describe_facts(facts),
        *(text for key, text in contradictions.items() if key not in stated),
        *_describe_unused(folder, contents, used),
    ]
    return InferredTest(folder, values, files, tuple(open_keys), tuple(remarks), contents.unread)


def _match(
    folder: Path, contents: FolderContents, stated: Mapping[str, str], neighbours: Neighbours
) -> list[ProtocolMatch]:
    """Find the protocols that fit best, by exports, names and the other tests."""
    values = _values_in_name(folder) | dict(stated)
    specimen_type = values.get("type", "")
    counts = [count_protocols(neighbours, folder, specimen_type)] if specimen_type else []
    candidates = load_all_protocols() if "protocol" not in stated else list[Protocol]()
    if "protocol" in stated:
        path = find_protocol(stated["protocol"], beside=folder)
        with suppress(LabpipeError):  # a wrong or missing one is reported with the sheet
            candidates += [] if isinstance(path, Fault) else [load_protocol(path)]
    return match_protocols(
        contents.exports,
        candidates,
        names=(folder.name, specimen_type, *(path.stem for path in contents.exports)),
        length=_parse_metres(values.get("length", "")),
        siblings=[*counts, count_protocols(neighbours, folder)],
        stated_files={role: split_file_names(stated[role]) for role in ROLES if role in stated},
    )


def _collect_facts(folder: Path, exports: Mapping[Path, Recording]) -> list[Fact]:
    """Collect facts; the lab chose the name of the folder, which has priority over exports."""
    facts = list(parse_folder_name(folder.name))
    named = {fact.key for fact in facts}
    stated = (
        x for path, export in exports.items() for x in collect_export_facts(path.name, export)
    )
    return [*facts, *(fact for fact in stated if fact.key not in named)]


def _assign_files(
    contents: FolderContents, matches: Sequence[ProtocolMatch]
) -> dict[str, tuple[str, ...]]:
    """Return exports by role: those on which all matching protocols agree, or else by format."""
    if matches:
        return {
            role: names
            for role, names in matches[0].files.items()
            if all(x.files.get(role) == names and role not in x.ambiguous_roles for x in matches)
        }
    files: dict[str, tuple[str, ...]] = {}
    for path, export in contents.exports.items():
        role = "frame" if export.reader == "load-frame" else "force"
        role = "markers" if export.reader in MARKER_READERS else role
        files[role] = (*files.get(role, ()), path.name)
    return files


def _describe_match(contents: FolderContents, matches: Sequence[ProtocolMatch]) -> str:
    if not matches:
        return format_sentence(
            "process.protocol_none" if contents.exports else "process.no_exports"
        )
    if len(matches) > 1:
        names = "\n    ".join(f"{x.protocol.name}: {x.protocol.about}" for x in matches)
        return format_sentence("process.protocols_alike", count=len(matches), names=names)
    name, reason = matches[0].protocol.name, matches[0].reason
    reason = reason or format_sentence("process.reason_only_one")
    return format_sentence("process.protocol_chosen", name=name, reason=reason)


def _describe_files(
    contents: FolderContents,
    files: Mapping[str, tuple[str, ...]],
    ambiguous: Mapping[str, tuple[str, ...]],
) -> Iterator[str]:
    """Yield sentences on the exports by role, and on roles with several possible exports."""
    readers = {path.name: export.reader for path, export in contents.exports.items()}
    if files:
        listed = {role: [f"{_escape(x)} ({readers[x]})" for x in files[role]] for role in files}
        yield "; ".join(f"{role}: {', '.join(names)}" for role, names in listed.items())
    for role, candidates in sorted(ambiguous.items()):
        names = ", ".join(map(_escape, candidates))
        yield format_sentence("process.role_ambiguous", role=role, names=names)


def _describe_facts(facts: Sequence[Fact]) -> Iterator[str]:
    for source in dict.fromkeys(fact.source for fact in facts):
        listed = ", ".join(f"{x.key} {x.value}" for x in facts if x.source == source)
        yield format_sentence("process.facts_from", facts=listed, source=source)


def _describe_unused(folder: Path, contents: FolderContents, used: set[str]) -> Iterator[str]:
    """Yield a sentence for each file that is not used, or that is named but missing."""
    kinds = {path.name: export.reader for path, export in contents.exports.items()}
    for name, kind in (kinds | contents.unread | contents.others).items():
        if name not in used:
            yield format_sentence("process.not_used", name=_escape(name), kind=kind.splitlines()[0])
    for name in sorted(used):
        if not (folder / name).exists():
            yield format_sentence("process.not_there_yet", names=_escape(name))


def split_file_names(text: str) -> tuple[str, ...]:
    """Split the exports of a role, as a table or an option writes them.

    Parameters
    ----------
    text : names, separated by semicolons; empty for none

    Examples
    --------
    >>> split_file_names("a.csv; b.csv"), split_file_names("")
    (('a.csv', 'b.csv'), ())
    """
    return tuple(part.strip() for part in text.split(";")) if text else ()


def _parse_metres(text: str) -> float | None:
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
    if is_test_name(name):
        return name
    plain = re.sub(r"[^\w.+-]+", "-", name).strip("-.+") or "test"
    return plain if is_test_name(plain) else f"test-{plain}"[:100]


def _escape(name: str) -> str:
    """Escape the characters of a file name that cannot be printed."""
    return name if name.isprintable() else repr(name)[1:-1]
