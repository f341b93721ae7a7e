"""Infer a test sheet: what files and names say, what siblings say, what is left for a person."""

from __future__ import annotations

import re
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import date
from functools import cache
from importlib.resources import files as package_files
from pathlib import Path

from labpipe.errors import Fault, LabpipeError, ReadError
from labpipe.messages import format_sentence
from labpipe.process.checking import needs_span
from labpipe.process.protocol_match import Fit, all_protocols, match_protocols
from labpipe.protocol.load import find_protocol, load_protocol, load_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import MARKER_READERS, ROLES
from labpipe.protocol.values import has_control_characters, is_test_name
from labpipe.readers import recognise_export
from labpipe.readers.unknown_files import describe_unknown
from labpipe.records.recording import Recording
from labpipe.units import parse_quantity

_FACT_KEYS = ("date", "operator", "type", "sample", "length", "width", "thickness")
_IGNORED_SUFFIXES = frozenset({".yaml", ".yml", ".md", ".ini"})
FOLDER = "the name of the folder"
_YEAR_FIRST = re.compile(r"(?<!\d)(\d{4})[-./](\d{1,2})[-./](\d{1,2})(?!\d)")
_YEAR_LAST = re.compile(r"(?<!\d)(\d{1,2})([-./])(\d{1,2})\2(\d{4})(?!\d)(.*)", re.DOTALL)
_COMPACT_DATE = re.compile(r"(?<!\d)(20\d\d)(\d\d)(\d\d)(?!\d)")
_US_CLOCK = re.compile(r"\s+\d{1,2}:\d\d(?::\d\d)?\s*(?:AM|PM)\b")
"""12-hour clock in capitals, the US format of Windows, which puts the month first."""
_NAME = re.compile(r"(?P<type>.+?)(?:-(?P<length>\d{3})(?=-))?[-_](?P<sample>\d{1,3}[a-z]?)")


@dataclass(frozen=True, slots=True)
class Fact:
    """One fact about a test and its source.

    Parameters
    ----------
    key : column of a campaign's table: ``date``, ``operator``, ``type``, ``sample``, ``length``
        ...; ``take`` for the name of the test in a program
    value : as a test sheet writes it; empty if ambiguous
    where : its source, such as ``force.mat``
    written : as it is written there
    """

    key: str
    value: str
    where: str
    written: str = ""


@cache
def _fact_keys() -> dict[str, dict[str, list[str]]]:
    text = (package_files("labpipe.process") / "sheet_facts.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def facts_of_export(name: str, recording: Recording) -> tuple[Fact, ...]:
    """Collect the facts that an export holds about its test.

    Parameters
    ----------
    name : of the file; its date is used if the export has none
    recording : from its reader

    Returns
    -------
    Its facts. The modification time of the file is not one of them: copying changes it.
    """
    entries, facts = dict[str, str](), list[Fact]()
    for word, text in _entries(recording.metadata):
        entries.setdefault(word, text)
    for key, names in _fact_keys()["keys"].items():
        texts = [entries[entry] for entry in names if _is_filled(key, entries.get(entry, ""))]
        facts += [
            Fact(key, day_in(text) if key == "date" else text, name, text) for text in texts[:1]
        ]
    if not any(fact.key == "date" for fact in facts):
        facts += [Fact("date", day, f"the name of {name}", name) for day in _days_in_name(name)]
    return tuple(facts)


def _entries(metadata: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield metadata entries by the last part of their key."""
    for key, value in metadata.items():
        if isinstance(value, Mapping) and key not in _fact_keys()["entries"]["lists"]:
            yield from _entries(value)
        yield key.rpartition(" : ")[2].strip(), str(value).strip()


def _is_filled(key: str, text: str) -> bool:
    """Check whether an entry was filled in, and can be what its key says."""
    if key in ("length", "width", "thickness"):
        return (_metres(text) or 0.0) > 0.0
    if key == "date":
        return bool(_YEAR_FIRST.search(text) or _YEAR_LAST.search(text))
    return text.casefold() not in _fact_keys()["entries"]["empty"]


def facts_of_folder(name: str) -> tuple[Fact, ...]:
    """Parse a folder name such as ``A2-085-1``: type, length in mm, sample.

    Parameters
    ----------
    name : of the folder of a test

    Examples
    --------
    >>> [(fact.key, fact.value) for fact in facts_of_folder("A2-085-1")]
    [('type', 'A2'), ('length', '85 mm'), ('sample', '1')]
    >>> [(fact.key, fact.value) for fact in facts_of_folder("CWB-2a-3")]
    [('type', 'CWB-2a'), ('sample', '3')]
    >>> facts_of_folder("Test Run 4 10-23-2023 6 43 09 PM")
    ()
    """
    if _days_in_name(name) or _YEAR_LAST.search(name):
        return ()
    match = _NAME.fullmatch(name)
    parts = match.groupdict("") if match else {}
    if parts.get("length"):
        parts["length"] = f"{int(parts['length'])} mm"
    return tuple(Fact(key, value, FOLDER, name) for key, value in parts.items() if value)


def _days_in_name(name: str) -> list[str]:
    """Find dates in the name of a file or folder that begin with the year."""
    written = [*_YEAR_FIRST.findall(name), *_COMPACT_DATE.findall(name)]
    return list(dict.fromkeys(day for parts in written if (day := _iso_date(*parts))))


def day_in(text: str) -> str:
    """Parse a date in the format of some program.

    Parameters
    ----------
    text : such as ``27.02.2015`` or ``10/26/2022 1:02:25 PM``

    Returns
    -------
    ISO date; empty if there is none, or if the order of day and month is ambiguous.

    Examples
    --------
    >>> day_in("27.02.2015"), day_in("10/26/2022 13:02"), day_in("3/11/2026 10:05:00 AM")
    ('2015-02-27', '2022-10-26', '2026-03-11')
    >>> day_in("03/09/2026 10:05:00")
    ''
    """
    if match := _YEAR_FIRST.search(text):
        return _iso_date(*match.groups())
    if not (match := _YEAR_LAST.search(text)):
        return ""
    first, mark, second, year, rest = match.groups()
    day_first, month_first = _iso_date(year, second, first), _iso_date(year, first, second)
    if mark == "." or not month_first:
        return day_first
    is_clear = _US_CLOCK.match(rest) or day_first in ("", month_first)
    return month_first if is_clear else ""


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
    agreed : by key, those on which all sources agree; `where` names all of them
    left_open : by key, a sentence on contradictory or ambiguous facts
    """
    by_key: dict[str, list[Fact]] = {}
    for fact in facts:
        by_key.setdefault(fact.key, []).append(fact)
    agreed, left_open = dict[str, Fact](), dict[str, str]()
    for key, facts_of_key in by_key.items():
        clear = [fact for fact in facts_of_key if fact.value]
        if len({fact.value for fact in clear}) == 1:
            sources = " and ".join(dict.fromkeys(fact.where for fact in clear))
            agreed[key] = replace(clear[0], where=sources)
            continue
        statements = ", ".join(
            f"{fact.value or repr(fact.written)} in {fact.where}" for fact in clear or facts_of_key
        )
        left_open[key] = format_sentence(
            "process.facts_differ" if clear else "process.facts_ambiguous",
            key=key,
            statements=statements,
        )
    return agreed, left_open


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
    return {fact.key: fact.value for fact in facts_of_folder(folder.name)}


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
    contents, name = read_folder(folder), safe_name(folder.resolve().name)
    neighbours = neighbours or neighbours_in(folder.resolve().parent)
    named = {role: file_names(stated[role]) for role in ROLES if role in stated}
    fits = _fits(folder, contents, stated, named, neighbours)
    fit = fits[0] if len(fits) == 1 else None
    unclear = {role: fit.files[role] for fit in fits for role in fit.unclear - named.keys()}
    exports = {x: y for x, y in contents.exports.items() if x.name not in sum(unclear.values(), ())}
    facts, contradictory = combine_facts(_facts(folder, exports))
    facts = {key: facts[key] for key in _FACT_KEYS if key in facts and key not in stated}
    values = {"test": name} | ({"protocol": fit.protocol.name} if fit else {})
    values |= {key: fact.value for key, fact in facts.items()} | dict(stated)
    inferred = _files(contents, fits)
    files = inferred | named
    needed = ["protocol", "type", "spool", "sample"]
    needed += ["span"] if fit and needs_span(fit.protocol) else []
    open_roles = sorted(fits[0].unclear - files.keys()) if fits else []
    open_keys = [key for key in needed if not values.get(key)]
    open_keys += open_roles or ([] if files else ["files"])

    remarks = [*_about_protocol(contents, fits)] if "protocol" not in stated else []
    readers = {path.name: export.reader for path, export in contents.exports.items()}
    roles = [
        f"{role}: {', '.join(f'{_printable(x)} ({readers[x]})' for x in names)}"
        for role, names in inferred.items()
        if role not in named
    ]
    remarks += ["; ".join(roles)] if roles else []
    for role in open_roles:
        possible = ", ".join(map(_printable, unclear[role]))
        remarks.append(format_sentence("process.role_unclear", role=role, names=possible))
    for where in dict.fromkeys(fact.where for fact in facts.values()):
        statements = [_statement(fact) for fact in facts.values() if fact.where == where]
        remarks.append(
            format_sentence("process.facts_from", facts=", ".join(statements), where=where)
        )
    if "test" not in stated and name != folder.resolve().name:
        remarks.append(format_sentence("process.test_renamed", name=name))
    remarks += [text for key, text in contradictory.items() if key not in stated]
    if fit is not None and not fit.unclear and "protocol" not in stated:
        remarks += [format_sentence("process.look", fault=fault) for fault in fit.faults[:3]]
    remarks += _other_names(folder.resolve().name, exports)
    used = {x for names in (*files.values(), *(unclear[r] for r in open_roles)) for x in names}
    remarks += _unused(folder, contents, used)
    return InferredTest(folder, values, files, tuple(open_keys), tuple(remarks), contents.unread)


def _fits(
    folder: Path,
    contents: FolderContents,
    stated: Mapping[str, str],
    named: Mapping[str, tuple[str, ...]],
    neighbours: Neighbours,
) -> list[Fit]:
    """Find the protocols that fit best, by exports, names and the other tests."""
    of_folder = _named(folder) | dict(stated)
    kind = of_folder.get("type", "")
    of_type = [neighbours.protocols_beside(folder, kind)] if kind else []
    return match_protocols(
        contents.exports,
        _candidates(stated, folder),
        names=(folder.name, kind, *(path.stem for path in contents.exports)),
        length=_metres(of_folder.get("length", "")),
        siblings=[*of_type, neighbours.protocols_beside(folder)],
        roles=named,
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
    known = {*(fact.key for fact in facts), "take"}
    for path, recording in exports.items():
        for fact in facts_of_export(path.name, recording):
            key = "sample" if fact.key == "specimen" else fact.key
            facts += [] if key in known else [replace(fact, key=key)]
    return facts


def _files(contents: FolderContents, fits: Sequence[Fit]) -> dict[str, tuple[str, ...]]:
    """Return exports by role: those on which all protocols that fit agree, or by format."""
    if fits:
        return {
            role: names
            for role, names in fits[0].files.items()
            if all(fit.files.get(role) == names and role not in fit.unclear for fit in fits)
        }
    files: dict[str, tuple[str, ...]] = {}
    for path, export in contents.exports.items():
        role = "frame" if export.reader == "load-frame" else "force"
        role = "markers" if export.reader in MARKER_READERS else role
        files[role] = (*files.get(role, ()), path.name)
    return files


def _about_protocol(contents: FolderContents, fits: Sequence[Fit]) -> Iterator[str]:
    if len(fits) == 1:
        name = fits[0].protocol.name
        signs = "; ".join(text for text, weight in fits[0].signs if weight > 0)
        signs = signs or "no other one takes these exports as well"
        yield format_sentence("process.protocol_chosen", name=name, signs=signs)
    elif fits:
        listed = [f"{fit.protocol.name}: {fit.protocol.about}" for fit in fits]
        yield format_sentence(
            "process.protocols_alike", count=len(fits), names="\n    ".join(listed)
        )
    else:
        yield format_sentence("process.protocol_none" if contents.exports else "process.no_exports")


def _statement(fact: Fact) -> str:
    is_named = fact.where.startswith((FOLDER, "the name of"))
    is_plain = fact.written.startswith(fact.value) or not fact.written or is_named
    return f"{fact.key} {fact.value}" + ("" if is_plain else f" ({fact.written!r})")


def _other_names(name: str, exports: Mapping[Path, Recording]) -> Iterator[str]:
    """Yield a sentence for each export that was recorded under the name of another test."""
    for path, export in exports.items():
        for fact in facts_of_export(path.name, export):
            if fact.key == "take" and fact.value != name and facts_of_folder(fact.value):
                other = fact.value
                yield format_sentence(
                    "process.look_other_name", file=path.name, name=other, folder=name
                )


def _unused(folder: Path, contents: FolderContents, used: set[str]) -> Iterator[str]:
    """Yield a sentence for each file that is not used, or is not there."""
    kinds = {path.name: export.reader for path, export in contents.exports.items()}
    for name, kind in (kinds | contents.unread | contents.others).items():
        if name not in used:
            yield format_sentence(
                "process.not_used", name=_printable(name), kind=kind.splitlines()[0]
            )
    for name in sorted(used):
        if not (folder / name).exists():
            yield format_sentence("process.not_there_yet", names=_printable(name))


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
    if is_test_name(name):
        return name
    plain = re.sub(r"[^\w.+-]+", "-", name).strip("-.+") or "test"
    return plain if is_test_name(plain) else f"test-{plain}"[:100]


def _printable(name: str) -> str:
    return name if name.isprintable() else repr(name)[1:-1]
