"""Infer test sheets from exports, names and other tests, and list the values that are missing."""

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
from itertools import chain
from math import isclose
from pathlib import Path
from typing import TypeAlias

from labpipe.errors import LabpipeError, ReadError
from labpipe.messages import format_sentence
from labpipe.process.checking import find_missing_sizes
from labpipe.process.reading import convert_channels, is_empty, join_exports
from labpipe.protocol.grammar import (
    MAX_NAME_BYTES,
    has_control_characters,
    is_test_name,
    try_parse_quantity,
)
from labpipe.protocol.load import find_protocol, list_protocols, load_protocol, load_test_sheet
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.protocol.source import MARKER_READERS, ROLES, Source
from labpipe.readers import describe_unknown, read_export, recognise_export
from labpipe.records.recording import Recording

FOLDER_NAME_SOURCE = "the name of the folder"
"""Source of a value that is inferred from the name of the folder of a test."""
_SIZE_UNITS = dict.fromkeys(("length", "width", "thickness", "gauge_length"), "m")
_SIZE_UNITS |= {"section.area": "m^2"}
"""SI unit of each size of the specimen."""
_COPIED_FACTS = ("date", "operator", "type", "sample", *_SIZE_UNITS)
"""Facts that become values of a test sheet, in this order."""
_IGNORED_SUFFIXES = frozenset({".yaml", ".yml", ".md", ".ini"})
"""Suffixes of files in a test folder that are not exports."""
_YEAR_FIRST_DATE = re.compile(r"(?<!\d)(\d{4})[-./](\d{1,2})[-./](\d{1,2})(?!\d)")
_YEAR_LAST_DATE = re.compile(r"(?<!\d)(\d{1,2})([-./])(\d{1,2})\2(\d{4})(?!\d)")
_COMPACT_DATE = re.compile(r"(?<!\d)(20\d\d)(\d\d)(\d\d)(?!\d)")
"""Dates such as 2026-03-04, 4.3.2026 and 20260304; other digits may not adjoin them."""
_US_TIME = re.compile(r"\s+\d{1,2}:\d\d(?::\d\d)?\s*(?:AM|PM)\b")
"""Time with AM or PM in capitals, as after the US dates of Windows, in which the month is first."""
_FOLDER_NAME_PATTERN = re.compile(
    r"(?P<type>.+?)(?:-(?P<length>(?!000)\d{3})(?=-))?[-_](?P<sample>\d{1,3}[a-z]?)"
)
"""Name of a test folder that consists of specimen type, length in mm if stated, and sample."""
Exports: TypeAlias = Mapping[Path, Recording]
"""Exports of a test, keyed by path."""
Files: TypeAlias = Mapping[str, tuple[str, ...]]
"""Names of exports, keyed by role."""
CampaignTests: TypeAlias = dict[Path, tuple[str, str]]
"""Specimen type and protocol of each test of a campaign, keyed by folder; each empty if unknown."""
Facts: TypeAlias = Mapping[str, Mapping[str, Sequence[str]]]
"""Sources of each value, keyed by column of a campaign table and then by value.

If a column has several values, the sources contradict each other.
"""


@cache
def _read_fact_keys() -> dict[str, dict[str, list[str]]]:
    """Read ``sheet_facts.toml``: metadata keys of each fact, placeholders, and ignored lists."""
    text = (package_files("labpipe.process") / "sheet_facts.toml").read_text(encoding="utf-8")
    return tomllib.loads(text)


def collect_facts(folder: str, exports: Mapping[str, Recording]) -> Facts:
    """Collect the facts about a test from the name of its folder and from its exports.

    Parameters
    ----------
    folder : name of the folder, whose facts have priority because the lab chose it
    exports : recordings of the exports, keyed by the name of the file

    Returns
    -------
    The facts. A date in the name of a file is used if the metadata of the file have no date. The
    modification time of a file is not used, because copying changes it.
    """
    folder_facts = parse_folder_name(folder)
    facts: dict[str, dict[str, list[str]]] = {
        key: {value: [FOLDER_NAME_SOURCE]} for key, value in folder_facts.items()
    }
    for name, recording in exports.items():
        # If several entries have the same key, the first one is used.
        entries = dict(reversed([*_list_entries(recording.metadata)]))
        for key, entry_names in _read_fact_keys()["keys"].items():
            values = (_parse_fact(key, entries.get(entry_name, "")) for entry_name in entry_names)
            value, source = next(filter(None, values), ""), name
            if key == "date" and not value:
                value, source = parse_date(name), f"the name of {name}"
            if value and key not in folder_facts:
                facts.setdefault(key, {}).setdefault(value, []).append(source)
    return facts


def _list_entries(metadata: Mapping[str, object]) -> Iterator[tuple[str, str]]:
    """Yield the last part of the key and the text of each metadata entry, also of nested ones."""
    for key, value in metadata.items():
        if isinstance(value, Mapping) and key not in _read_fact_keys()["entries"]["lists"]:
            yield from _list_entries(value)
        yield key.rpartition(" : ")[2].strip(), str(value).strip()


def _parse_fact(key: str, text: str) -> str:
    """Convert a metadata entry to a value; empty if it is a placeholder or is not valid."""
    if key == "date":
        return parse_date(text)
    if key in _SIZE_UNITS:
        return text if (try_parse_quantity(text, _SIZE_UNITS[key]) or 0.0) > 0.0 else ""
    return "" if text.casefold() in _read_fact_keys()["entries"]["empty"] else text


def parse_folder_name(name: str) -> dict[str, str]:
    """Parse a folder name such as ``A2-085-1`` into specimen type, length in mm and sample.

    Parameters
    ----------
    name : name of the folder of a test

    Returns
    -------
    The values, keyed by column; empty if the name has another form or contains a date.

    Examples
    --------
    >>> parse_folder_name("A2-085-1")
    {'type': 'A2', 'length': '85 mm', 'sample': '1'}
    >>> parse_folder_name("CWB-2a-3")
    {'type': 'CWB-2a', 'sample': '3'}
    >>> parse_folder_name("Test Run 4 10-23-2023 6 43 09 PM")
    {}
    """
    match = _FOLDER_NAME_PATTERN.fullmatch(name)
    if match is None or parse_date(name) or _YEAR_LAST_DATE.search(name):
        return {}
    values = match.groupdict("")
    values["length"] = values["length"] and f"{int(values['length'])} mm"
    return {key: value for key, value in values.items() if value}


def parse_date(text: str) -> str:
    """Parse the first valid date in a text; a date with the year first has priority.

    Parameters
    ----------
    text : any text, such as ``27.02.2015`` or ``10/26/2022 1:02:25 PM``

    Returns
    -------
    The ISO date; empty if there is no valid date, or if the first one has an ambiguous order of day
    and month. In a date with dots the day is first. Before a time with AM or PM in capitals the
    month is first.

    Examples
    --------
    >>> parse_date("27.02.2015"), parse_date("10/26/2022 13:02")
    ('2015-02-27', '2022-10-26')
    >>> parse_date("3/11/2026 10:05:00 AM")
    '2026-03-11'
    >>> parse_date("03/09/2026 10:05:00")
    ''
    """
    for year_first_match in chain(_YEAR_FIRST_DATE.finditer(text), _COMPACT_DATE.finditer(text)):
        if iso_date := _format_date(*year_first_match.groups()):
            return iso_date
    for match in _YEAR_LAST_DATE.finditer(text):
        first_number, separator, second_number, year = match.groups()
        month_first_date = _format_date(year, first_number, second_number)
        dates = {_format_date(year, second_number, first_number)}  # the day is first
        if separator != "." and month_first_date:
            is_month_first = _US_TIME.match(text, match.end()) is not None
            dates = {month_first_date} if is_month_first else {*dates, month_first_date}
        if dates := dates - {""}:
            return dates.pop() if len(dates) == 1 else ""
    return ""


def _format_date(year: str, month: str, day: str) -> str:
    """Format an ISO date; empty if the date is invalid."""
    with suppress(ValueError):
        return date(int(year), int(month), int(day)).isoformat()
    return ""


@dataclass(frozen=True, slots=True, eq=False)
class ProtocolMatch:
    """Protocol that fits the exports of a folder, with the exports of its roles.

    Parameters
    ----------
    protocol : protocol without the overrides of a test
    files : names of the exports, keyed by role
    choices : names of the exports that are possible for a role and cannot be joined, keyed by role
    score : whether the exports are complete, and the number of exports that the protocol reads,
        plus 1 if the camera recording has the clamp that the protocol names. Exports are complete
        if they can be read and joined, and no camera recording lacks this clamp
    reason : reason for which this protocol was chosen from several; empty if no criterion chose it
    """

    protocol: Protocol
    files: Files
    choices: Files
    score: tuple[bool, int]
    reason: str = ""


def load_all_protocols() -> list[Protocol]:
    """Load all valid protocols; `labpipe check` reports invalid ones."""
    protocols = []
    for path in list_protocols().values():
        with suppress(LabpipeError):
            protocols.append(load_protocol(path))
    return protocols


def match_protocols(
    exports: Exports,
    protocols: Sequence[Protocol],
    *,
    names: Sequence[str] = (),
    length: float | None = None,
    protocol_counts: Sequence[Mapping[str, int]] = (),
    stated_files: Files | None = None,
) -> list[ProtocolMatch]:
    """Find the protocols that fit the exports best.

    Parameters
    ----------
    exports : exports of one test
    protocols : protocols to compare
    names : names of the folder, of its exports and of the specimen type
    length : free length of the specimen, m; None if unknown
    protocol_counts : counts of other tests, keyed by protocol: first the tests of specimens of the
        same type, then the tests of the whole campaign; the key of tests without a protocol is
        empty
    stated_files : files that the user named, keyed by role

    Returns
    -------
    The protocol that fits better than all others, or several that fit equally, sorted by name. The
    list is empty if every protocol needs an export that is missing, or lacks a role of
    `stated_files`.

    Notes
    -----
    Protocols with the best `ProtocolMatch.score` are compared by the following criteria. The first
    criterion that exactly one protocol meets selects this protocol.

    1. One of `names` contains the name of the protocol.
    2. The metadata of an export name the standard after which the protocol is named.
    3. The protocol states this `length` within 5 %.
    4. More than half of the other tests in a count of `protocol_counts` have the protocol.
    """
    candidates = (_match_protocol(exports, protocol, stated_files or {}) for protocol in protocols)
    matches = [match for match in candidates if match is not None]
    best_score = max((match.score for match in matches), default=None)
    best_matches = {match.protocol.name: match for match in matches if match.score == best_score}
    texts = [str(text) for export in exports.values() for text in export.metadata.values()]
    # A name with at least three digits contains the number of a standard.
    standards = [name for name in best_matches if re.search(r"\d{3,}", name)]
    names_of_equal_length = [
        name
        for name, match in best_matches.items()
        if length and isclose(length, match.protocol.specimen.length or 0.0, rel_tol=0.05)
    ]
    criteria = [
        (format_sentence("process.reason_namesake"), _find_named_protocols(names, best_matches)),
        (format_sentence("process.reason_standard"), _find_named_protocols(texts, standards)),
        (format_sentence("process.reason_length"), names_of_equal_length),
    ]
    for counts in protocol_counts:
        name = find_majority(counts)
        facts = {"count": counts.get(name, 0), "total": sum(counts.values())}
        sentence = format_sentence("process.reason_siblings", **facts)
        criteria.append((sentence, [name] if name in best_matches else []))
    for reason, chosen_names in criteria if len(best_matches) > 1 else ():
        if len(chosen_names) == 1:
            return [replace(best_matches[chosen_names[0]], reason=reason)]
    return [best_matches[name] for name in sorted(best_matches)]


def _find_named_protocols(texts: Iterable[str], protocols: Iterable[str]) -> list[str]:
    """Find the protocols whose name occurs in one of the texts as whole words."""
    joined_texts = "\n".join(map(_join_words, texts))
    return [name for name in protocols if _join_words(name) in joined_texts]


def _join_words(text: str) -> str:
    """Join the words of a text in lower case by hyphens, with a hyphen at both ends."""
    return "-".join(["", *re.findall(r"[^\W_]+", text.casefold()), ""])


def find_majority(counts: Mapping[str, int]) -> str:
    """Find the protocol that more than half of the tests have; empty if there is none.

    Parameters
    ----------
    counts : numbers of tests, keyed by protocol; the key of tests without a protocol is empty

    Examples
    --------
    >>> find_majority({"tensile": 3, "pet-tape": 1, "": 1})
    'tensile'
    >>> find_majority({"tensile": 6, "": 15})
    ''
    """
    return next((name for name in counts if 2 * counts[name] > sum(counts.values())), "")


def _match_protocol(
    exports: Exports, protocol: Protocol, stated_files: Files
) -> ProtocolMatch | None:
    """Assign the exports to the roles of a protocol.

    Return None if no export fits a required role, or if the protocol lacks a stated role.
    """
    if set(stated_files) - set(protocol.sources):
        return None
    files, choices = dict[str, tuple[str, ...]](), dict[str, tuple[str, ...]]()
    free_names = {path.name for path in exports}.difference(*stated_files.values())
    unused_exports, recordings, is_complete = dict(exports), list[Recording](), True
    for role, source in protocol.sources.items():
        parts = {
            path: _read_channels(path, recording, source)
            for path, recording in unused_exports.items()
            if recording.reader in source.reader
            and path.name in stated_files.get(role, free_names)
            and (source.dialect is None or recording.metadata.get("dialect") in source.dialect)
        }
        valid_parts = {path: part for path, part in parts.items() if part is not None}
        names = tuple(path.name for path in valid_parts or parts)
        if not names and not source.optional:
            return None
        for path in valid_parts or parts:
            del unused_exports[path]
        try:
            recordings += [join_exports([*valid_parts.values()], names, Path())] if names else []
            is_joined = True
        except ReadError:
            is_joined = is_complete = False
        if role in stated_files or (names and (is_joined or len(names) == 1)):
            files[role] = stated_files.get(role, names)
        elif names:
            choices[role] = names
    clamp = None if protocol.markers is None else protocol.markers.clamp
    takes = [recording.markers for recording in recordings if recording.markers is not None]
    has_clamp = any(body.name == clamp for take in takes for body in take.bodies)
    is_complete = is_complete and (clamp is None or not takes or has_clamp)
    score = is_complete, len(exports) - len(unused_exports) + has_clamp
    return ProtocolMatch(protocol, files, choices, score)


def _read_channels(path: Path, recording: Recording, source: Source) -> Recording | None:
    """Read the channels of a protocol from an export; None if this fails."""
    with suppress(ReadError):
        if source.part is not None:
            recording = read_export(path, source.reader, part=source.part)
        return recording if is_empty(recording) else convert_channels(recording, source, path)
    return None


def list_possible_exports(folder: Path) -> list[Path]:
    """List the files of a folder that may be exports, sorted by name; hidden files are left out.

    Parameters
    ----------
    folder : folder of a test; a folder that does not exist has no files
    """
    return [
        path
        for path in (sorted(folder.iterdir()) if folder.is_dir() else [])
        if path.suffix not in _IGNORED_SUFFIXES and not path.name.startswith(".") and path.is_file()
    ]


def list_test_folders(folder: Path) -> list[Path]:
    """List the test folders of a campaign that may contain exports, sorted by name.

    Parameters
    ----------
    folder : folder of a campaign

    Returns
    -------
    The test folders; empty if the folder itself contains a test sheet, or does not exist.
    """
    if (folder / SHEET_NAME).exists() or not folder.is_dir():
        return []
    return [
        path
        for path in sorted(folder.iterdir())
        if path.is_dir() and not path.name.startswith(".") and list_possible_exports(path)
    ]


def read_campaign_tests(campaign: Path) -> CampaignTests:
    """Read the specimen types and protocols of the tests of a campaign.

    Parameters
    ----------
    campaign : resolved path of the folder that contains the test folders

    Returns
    -------
    Types and protocols, keyed by folder. Without a valid test sheet, the type is that of the folder
    name, and the protocol is empty.
    """
    campaign_tests: CampaignTests = {}
    for folder in list_test_folders(campaign):
        campaign_tests[folder] = (parse_folder_name(folder.name).get("type", ""), "")
        with suppress(LabpipeError, OSError):
            sheet = load_test_sheet(folder / SHEET_NAME)
            campaign_tests[folder] = (sheet.specimen.type, sheet.protocol)
    return campaign_tests


def count_protocols(
    campaign_tests: CampaignTests, folder: Path, specimen_type: str | None = None
) -> Counter[str]:
    """Count the protocols of the other tests of a campaign.

    Parameters
    ----------
    campaign_tests : tests of the campaign
    folder : folder of the test itself, which is not counted
    specimen_type : specimen type of the counted tests; None for all types

    Returns
    -------
    Numbers of tests, keyed by protocol; the key of tests without a protocol is empty.
    """
    return Counter(
        protocol
        for other_folder, (other_type, protocol) in campaign_tests.items()
        if other_folder != folder.resolve() and specimen_type in (None, other_type)
    )


@dataclass(frozen=True, slots=True)
class InferredTest:
    """Inferred content of a test sheet.

    Parameters
    ----------
    folder : folder of the test
    values : texts of the values, keyed by column of a campaign table
    files : names of exports, keyed by role
    open_keys : keys whose values the user must fill in: required columns without a value, ambiguous
        roles, and ``files`` if no role has or may have a file
    remarks : sentences on the protocol, the sources of the values, contradictions, and files that
        are not used or are missing
    read_errors : reason why an export of a known format cannot be read, keyed by its name
    blocks : blocks of the test sheet for which a campaign table has no column, keyed by name
    """

    folder: Path
    values: Mapping[str, str]
    files: Files
    open_keys: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    read_errors: Mapping[str, str] = field(default_factory=dict)
    blocks: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


def infer_tests(
    folders: Sequence[Path], stated_values: Mapping[str, str]
) -> Iterator[InferredTest]:
    """Infer several tests of one campaign.

    Parameters
    ----------
    folders : folders of the tests
    stated_values : values, keyed by column, as for `infer_test`

    Yields
    ------
    The inferred tests. Tests whose protocol is certain come first. The protocols of the other tests
    are then inferred again, now also from those of the first tests. Only the recordings of one test
    are in memory at a time.
    """
    campaign_tests = read_campaign_tests(folders[0].resolve().parent) if folders else {}
    folders_without_protocol = []
    for folder in folders:
        test = infer_test(folder, stated_values, campaign_tests=campaign_tests)
        if "protocol" in test.open_keys:
            folders_without_protocol.append(folder)
        else:
            specimen_type, protocol = test.values.get("type", ""), test.values["protocol"]
            campaign_tests[folder.resolve()] = (specimen_type, protocol)
            yield test
    for folder in folders_without_protocol:
        yield infer_test(folder, stated_values, campaign_tests=campaign_tests)


def infer_test(
    folder: Path, stated_values: Mapping[str, str], *, campaign_tests: CampaignTests | None = None
) -> InferredTest:
    """Infer the test sheet of a folder from its exports.

    Parameters
    ----------
    folder : folder of the test
    stated_values : values that the user states, keyed by column; they replace inferred values
    campaign_tests : tests of the campaign; if None, they are read from the parent folder

    Returns
    -------
    The inferred test. Exports that cannot be read raise no error, but are listed in `read_errors`.
    """
    if campaign_tests is None:
        campaign_tests = read_campaign_tests(folder.resolve().parent)
    exports, kinds, read_errors = read_folder(folder)
    stated_files = {
        role: split_file_names(stated_values[role]) for role in ROLES if role in stated_values
    }
    matches = _match_folder(folder, exports, stated_values, stated_files, campaign_tests)
    protocol = matches[0].protocol if len(matches) == 1 else None
    files = _assign_files(exports, matches, stated_files)
    inferred_files = {role: names for role, names in files.items() if role not in stated_files}
    choices = {role: names for match in matches for role, names in match.choices.items()}
    ambiguous_names = set(chain.from_iterable(choices.values()))
    certain_exports = {
        path.name: export for path, export in exports.items() if path.name not in ambiguous_names
    }
    all_facts = collect_facts(folder.name, certain_exports)
    facts = {key: fact for key, fact in all_facts.items() if key not in stated_values}
    copied_facts = {key: facts[key] for key in _COPIED_FACTS if len(facts.get(key, ())) == 1}
    values = {"test": make_test_name(folder.resolve().name)}
    values |= {} if protocol is None else {"protocol": protocol.name}
    values |= {key: next(iter(fact)) for key, fact in copied_facts.items()} | dict(stated_values)
    sizes = {} if protocol is None else find_missing_sizes(protocol, values)
    if "section.area" in sizes and {"width", "thickness"} <= values.keys():
        values |= {f"section.{key}": values[key] for key in ("width", "thickness")}
        del sizes["section.area"]
    required_keys = ["protocol", "type", "spool", "sample", *sizes]
    open_keys = [key for key in required_keys if not values.get(key)]
    open_keys += sorted(choices) or ([] if files else ["files"])
    remarks = [
        *([] if "protocol" in stated_values else [_describe_matches(exports, matches)]),
        *_describe_files(inferred_files, choices, kinds),
        *_describe_facts(copied_facts, facts),
        *_describe_unused(folder, kinds, ambiguous_names.union(*files.values())),
    ]
    return InferredTest(folder, values, files, tuple(open_keys), tuple(remarks), read_errors)


def read_folder(folder: Path) -> tuple[dict[Path, Recording], dict[str, str], dict[str, str]]:
    """Read the exports in the folder of a test; formats are recognised by content.

    Parameters
    ----------
    folder : folder of the test; a folder that does not exist has no files

    Returns
    -------
    exports : recordings of the exports that can be read, keyed by path
    kinds : reader of each export, likely kind of any other file, or the fault of a file, keyed by
        the name of the file
    read_errors : reason why an export cannot be read (damaged, truncated, locked), keyed by its
        name
    """
    exports, kinds, read_errors = dict[Path, Recording](), dict[str, str](), dict[str, str]()
    for path in list_possible_exports(folder):
        if has_control_characters(path.name):
            kinds[path.name] = format_sentence("process.control_characters")
            continue
        try:
            path.open("rb").close()  # a file that cannot be opened raises OSError here
            try:
                reader = recognise_export(path)
            except ReadError:
                kinds[path.name] = describe_unknown(path).kind
            else:
                exports[path] = reader.read(path)
                kinds[path.name] = exports[path].reader
        except (LabpipeError, OSError) as error:
            message = str(error).removeprefix(f"{path}").lstrip(":, ")
            kinds[path.name] = read_errors[path.name] = message
    return exports, kinds, read_errors


def _match_folder(
    folder: Path,
    exports: Exports,
    stated_values: Mapping[str, str],
    stated_files: Files,
    campaign_tests: CampaignTests,
) -> list[ProtocolMatch]:
    """Find the protocols that fit the exports, the names and the other tests best."""
    values = parse_folder_name(folder.name) | dict(stated_values)
    specimen_type = values.get("type", "")
    types = [specimen_type, None] if specimen_type else [None]
    candidates = list[Protocol]()
    if "protocol" not in stated_values:
        candidates = load_all_protocols()
    elif isinstance(path := find_protocol(stated_values["protocol"], sheet_folder=folder), Path):
        with suppress(LabpipeError):  # the error is reported with the sheet
            candidates = [load_protocol(path)]
    return match_protocols(
        exports,
        candidates,
        names=(folder.name, specimen_type, *(path.stem for path in exports)),
        length=try_parse_quantity(values.get("length"), "m"),
        protocol_counts=[count_protocols(campaign_tests, folder, name) for name in types],
        stated_files=stated_files,
    )


def _assign_files(
    exports: Exports, matches: Sequence[ProtocolMatch], stated_files: Files
) -> dict[str, tuple[str, ...]]:
    """Assign exports to roles if all matches agree or, without matches, by the exports' formats."""
    if matches:
        files, *other_files = (match.files for match in matches)
        return {x: files[x] for x in files if all(y.get(x) == files[x] for y in other_files)}
    files_by_format: dict[str, tuple[str, ...]] = {}
    stated_names = set(chain.from_iterable(stated_files.values()))
    for path, export in exports.items():
        role = "frame" if export.reader == "load-frame" else "force"
        role = "markers" if export.reader in MARKER_READERS else role
        if path.name not in stated_names:
            files_by_format[role] = (*files_by_format.get(role, ()), path.name)
    return files_by_format | dict(stated_files)


def _describe_matches(exports: Exports, matches: Sequence[ProtocolMatch]) -> str:
    """Describe which protocol was chosen and why, or why none was chosen."""
    if not matches:
        return format_sentence("process.protocol_none" if exports else "process.no_exports")
    if len(matches) > 1:
        names = "\n    ".join(f"{match.protocol.name}: {match.protocol.about}" for match in matches)
        return format_sentence("process.protocols_alike", count=len(matches), names=names)
    reason = matches[0].reason or format_sentence("process.reason_only_one")
    name = matches[0].protocol.name
    return format_sentence("process.protocol_chosen", name=name, reason=reason)


def _describe_files(files: Files, choices: Files, kinds: Mapping[str, str]) -> Iterator[str]:
    """Describe the exports of each role, and the roles with several possible exports."""
    exports = {name: f"{_escape(name)} ({kind})" for name, kind in kinds.items()}
    texts = [f"{role}: {', '.join(exports[x] for x in names)}" for role, names in files.items()]
    if texts:
        yield "; ".join(texts)
    for role, candidates in sorted(choices.items()):
        listed_names = ", ".join(map(_escape, candidates))
        yield format_sentence("process.role_ambiguous", role=role, names=listed_names)


def _describe_facts(copied_facts: Facts, facts: Facts) -> Iterator[str]:
    """Describe the sources of copied facts, and facts that contradict each other."""
    texts: dict[str, list[str]] = {}
    for key, fact in copied_facts.items():
        ((value, sources),) = fact.items()
        texts.setdefault(" and ".join(sources), []).append(f"{key} {value}")
    for source, facts_of_source in texts.items():
        yield format_sentence("process.facts_from", facts=", ".join(facts_of_source), source=source)
    for key, fact in facts.items():
        if len(fact) > 1:
            statements = [f"{value} in {' and '.join(sources)}" for value, sources in fact.items()]
            yield format_sentence("process.facts_differ", key=key, statements=", ".join(statements))


def _describe_unused(folder: Path, kinds: Mapping[str, str], used_names: set[str]) -> Iterator[str]:
    """Describe each file that is not used, and each export that is named but missing."""
    for name, kind in kinds.items():
        if name not in used_names:
            yield format_sentence(
                "process.not_used", name=_escape(name), kind=kind.partition("\n")[0]
            )
    for name in sorted(used_names):
        if not (folder / name).exists():
            yield format_sentence("process.not_there_yet", names=_escape(name))


def split_file_names(text: str) -> tuple[str, ...]:
    """Split a list of file names from a table or an option of `labpipe new`.

    Parameters
    ----------
    text : file names separated by semicolons; empty for no file

    Examples
    --------
    >>> split_file_names("a.csv; b.csv;"), split_file_names("")
    (('a.csv', 'b.csv'), ())
    """
    return tuple(filter(None, map(str.strip, text.split(";"))))


def make_test_name(name: str) -> str:
    """Convert a name to a valid name of a test.

    Parameters
    ----------
    name : any name, such as that of a folder

    Examples
    --------
    >>> make_test_name("Run 4, (2)"), make_test_name("A2-085-1"), make_test_name("con")
    ('Run-4-2', 'A2-085-1', 'test-con')
    """
    plain_name = re.sub(r"[^\w.+-]+", "-", name).strip("-.+")
    short_name = f"test-{plain_name}".encode()[:MAX_NAME_BYTES].decode(errors="ignore")
    return next(filter(is_test_name, (name, plain_name, short_name.rstrip("-.+"))))


def _escape(name: str) -> str:
    """Escape the characters of a file name that cannot be printed."""
    return name if name.isprintable() else repr(name)[1:-1]
