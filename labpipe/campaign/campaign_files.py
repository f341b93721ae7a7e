"""Find the files of a campaign, and make the keys that show which results are outdated.

The key of the inputs of a test depends on the exports, the lab's dialect cards that apply, the test
sheet, the resolved protocol and the processing version (`labpipe.process.run.make_input_key`).
Results with another key are outdated. A file is hashed again if its size, timestamps or
inode have changed since the previous hash, or if these may not show every later change
(`FileStamp.is_reliable`).
"""

from __future__ import annotations

import hashlib
import itertools
import json
import os
import stat
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cache, cached_property
from pathlib import Path
from typing import NamedTuple

from labpipe import __version__
from labpipe.errors import Fault, LabpipeError, StoreError, UsageError, describe_system_error
from labpipe.process.output_paths import FIGURES_FOLDER, RESULT_FILE
from labpipe.protocol.load import find_protocol, format_protocol, load_test_sheet, resolve_protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.replace import TEMPORARY_FOLDERS, finish_moves, is_unfinished, lock, map_errors
from labpipe.store.summaries import FAILURE_FILE, SUMMARY_FILE

RAW, PROCESSED = "raw", "processed"
_OUTCOME_FILES = (SUMMARY_FILE, FAILURE_FILE, RESULT_FILE)


@dataclass(frozen=True, slots=True)
class CampaignFolders:
    """A campaign: a folder of exports and a folder of results with the same name.

    Parameters
    ----------
    name : path of each folder relative to ``raw`` and ``processed``, with slashes
    raw : path of the folder of exports and test sheets, with a folder per test; may be missing
    processed : path of the folder of results, with a folder per test; created with the first result
    """

    name: str
    raw: Path
    processed: Path


def find_campaign(folder: Path) -> CampaignFolders:
    """Find both folders of a campaign from one of them.

    Parameters
    ----------
    folder : path of one of the folders, ``.../raw/NAME`` or ``.../processed/NAME``

    Raises
    ------
    UsageError
        If the folder does not exist or is a file, is below neither ``raw`` nor ``processed``, or is
        the folder of a single test.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing of that name"
        raise UsageError.about("campaign.no_campaign", folder, found=found)
    path = folder.resolve()
    top_folders = [parent for parent in (path, *path.parents) if parent.name in {RAW, PROCESSED}]
    if not top_folders:
        raise UsageError.about("campaign.outside_campaigns", folder)
    relative_path = path.relative_to(top_folders[0])
    cwd = Path.cwd().resolve()
    paths = (top_folders[0].parent / top / relative_path for top in (RAW, PROCESSED))
    raw, processed = (path.relative_to(cwd) if path.is_relative_to(cwd) else path for path in paths)
    if (raw / SHEET_NAME).is_file():
        raise UsageError.about("campaign.no_campaign", folder, found="the folder of a single test")
    return CampaignFolders(relative_path.as_posix(), raw, processed)


def find_campaign_name(folder: Path) -> str:
    """Find the name of the campaign to which a folder belongs.

    Parameters
    ----------
    folder : path of any folder

    Returns
    -------
    Name of the campaign; empty if `find_campaign` refuses the folder, for example because it does
    not exist or is the folder of a single test.
    """
    with suppress(UsageError):
        return find_campaign(folder).name
    return ""


@dataclass(slots=True)
class RawContent:
    """Test sheets and files below the folder of exports.

    Parameters
    ----------
    sheets : path of each test sheet, keyed by the folder of the test relative to the campaign
    files : paths of files and of links to folders, relative to the folder of exports, with slashes.
        Hidden entries, names that cannot be decoded and the content of links and hidden folders are
        left out
    problems : messages about files and folders that cannot be used
    """

    sheets: dict[str, Path] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)


def list_raw(campaign: CampaignFolders) -> RawContent:
    """List the tests and files of a campaign without opening any file.

    Parameters
    ----------
    campaign : folders of the campaign; without a folder of exports, the lists are empty
    """
    content = RawContent()
    for test, folder, files, _ in _walk(campaign.raw, content.problems):
        content.files += [f"{test}/{name}" if test else name for name in files]
        if SHEET_NAME not in files:
            continue
        sheet = Path(folder, SHEET_NAME)
        if sheet.is_file():
            content.sheets[test] = sheet
        else:
            content.problems.append(str(StoreError.about("campaign.irregular_sheet", sheet)))
    return content


@dataclass(frozen=True, slots=True)
class OutcomeFiles:
    """Files that were written when a test was processed: results, summary and failure.

    Parameters
    ----------
    folder : path of the folder of results
    signature : name, size, modification time and inode of each file as text, which is equal for
        unchanged files; empty without files
    """

    folder: Path
    signature: str

    @property
    def names(self) -> set[str]:
        """Names of the files."""
        return {file_state.partition(":")[0] for file_state in self.signature.split()}


NO_OUTCOME = OutcomeFiles(Path(), "")
"""Outcome files of a test that was never processed."""


def list_processed(campaign: CampaignFolders) -> dict[str, OutcomeFiles]:
    """List the outcome files of the tests of a campaign.

    No file is opened, except to complete unfinished replacements as in `find_outcome`.

    Parameters
    ----------
    campaign : folders of the campaign; the folder of results may be missing

    Returns
    -------
    Outcome files, keyed by folder of the test; tests without such files are absent.
    """
    outcomes = {}
    for test, folder, _, hidden_names in _walk(campaign.processed, [], skipped_name=FIGURES_FOLDER):
        if hidden_names & {*TEMPORARY_FOLDERS}:
            outcome = find_outcome(campaign, test)
        else:
            outcome = OutcomeFiles(Path(folder), _compute_signature(folder))
        if outcome.signature:
            outcomes[test] = outcome
    return outcomes


def find_outcome(campaign: CampaignFolders, test: str) -> OutcomeFiles:
    """Find the outcome files of one test.

    If a killed process left a replacement of files unfinished, it is completed first, if possible.

    Parameters
    ----------
    campaign : folders of the campaign of the test
    test : folder of the test, relative to the campaign
    """
    folder = campaign.processed / test
    if is_unfinished(folder):  # a process that is still writing holds the lock
        with suppress(StoreError), lock(folder), map_errors(folder):
            finish_moves(folder)
    return OutcomeFiles(folder, _compute_signature(str(folder)))


def _compute_signature(folder: str) -> str:
    """Compute `OutcomeFiles.signature` of the files in a folder."""
    file_states = []
    for name in _OUTCOME_FILES:
        with suppress(OSError):
            status = os.stat(f"{folder}/{name}")  # noqa: PTH116  Path is slow for 10 000 files
            file_states.append(f"{name}:{status.st_size}:{status.st_mtime_ns}:{status.st_ino}")
    return " ".join(file_states)


def _walk(
    top: Path, problems: list[str], *, skipped_name: str = ""
) -> Iterator[tuple[str, str, list[str], set[str]]]:
    """Walk through folders, except hidden folders, links, and folders with the name `skipped_name`.

    Names that cannot be decoded are left out. Messages about them and about errors are added to
    `problems`.

    Yields
    ------
    The path of each folder relative to `top` with slashes, its full path, the names of its files
    and links, and the names of its hidden entries.
    """

    def note_error(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):
            problems.append(describe_system_error(error))

    for folder, subfolders, files in os.walk(top, onerror=note_error):
        links = {name for name in subfolders if os.path.islink(f"{folder}/{name}")}  # noqa: PTH114
        hidden_names = {name for name in (*subfolders, *files) if name.startswith(".")}
        bad_names = {name for name in {*subfolders, *files} - hidden_names if not _is_text(name)}
        for name in sorted(bad_names):
            printable_path = f"{folder}/{name}".encode("utf-8", "backslashreplace").decode()
            problems.append(str(StoreError.about("campaign.undecodable_name", printable_path)))
        subfolders[:] = sorted({*subfolders} - links - hidden_names - bad_names - {skipped_name})
        test = folder[len(str(top)) + 1 :].replace(os.sep, "/")
        yield test, folder, [*({*files} | links) - hidden_names - bad_names], hidden_names


def _is_text(name: str) -> bool:
    """Return whether a file name could be decoded; on Linux, a name may have any bytes."""
    return name.isascii() or not any("\ud800" <= character <= "\udfff" for character in name)


class FileStamp(NamedTuple):
    """Hash of a file, with the state of the file when the hash was taken.

    Parameters
    ----------
    size : size, bytes
    modified_ns : time of the last change of the content, ns since 1970
    changed_ns : time of the last change of content or attributes, ns since 1970
    inode : number of the file in its file system
    hashed_ns : time of the hash, ns since 1970
    sha256 : hash, hexadecimal; empty for an unreadable file
    """

    size: int
    modified_ns: int
    changed_ns: int
    inode: int
    hashed_ns: int
    sha256: str

    @property
    def is_reliable(self) -> bool:
        """Whether all later changes of the file are visible in its size, timestamps or inode.

        A change may be invisible if the file was hashed too soon after the previous change, within
        the resolution of its timestamps, or if the clock was set back.
        """
        coarsest_resolution_ns = 2_000_000_000  # FAT stores the times of files in steps of 2 s
        return max(self.modified_ns, self.changed_ns) + coarsest_resolution_ns < self.hashed_ns


def take_stamp(path: Path, old_stamp: FileStamp | None = None) -> FileStamp:
    """Read the state of a file, and hash the file unless it is unchanged.

    Parameters
    ----------
    path : path of the file
    old_stamp : previous stamp of the file; None if there is none

    Returns
    -------
    The stamp. A missing or unreadable file, a folder, a pipe or a device has an empty hash.
    """
    hashed_ns = time.time_ns()
    try:
        status = path.stat()
        state = (status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)
        if old_stamp is not None and state == old_stamp[:4] and old_stamp.is_reliable:
            return old_stamp
        if not stat.S_ISREG(status.st_mode):
            return _UNREADABLE_FILE
        with path.open("rb") as stream:
            return FileStamp(*state, hashed_ns, hashlib.file_digest(stream, "sha256").hexdigest())
    except (OSError, ValueError):  # ValueError: a name with a null character
        return _UNREADABLE_FILE


_UNREADABLE_FILE = FileStamp(-1, 0, 0, 0, 0, "")


class SourceHashes(NamedTuple):
    """SHA-256 of the inputs from which results were made; empty if they are not known.

    Parameters
    ----------
    files : role, name and SHA-256 of each export and, if an export may be from a load frame, of
        each dialect card of the lab
    sheet, protocol : SHA-256 of the text of the test sheet and of the resolved protocol
    """

    files: tuple[tuple[str, str, str], ...] = ()
    sheet: str = ""
    protocol: str = ""


UNKNOWN_SOURCES = SourceHashes()
"""Placeholder for inputs that are not known."""


@dataclass(frozen=True)
class HashedInputs:
    """Hashes and key of the present inputs of a test.

    Parameters
    ----------
    key : key of all inputs, equal to the `run` of results that were made from them
    source_hashes : hashes of the inputs; empty if the sheet or the protocol is faulty
    stamps : stamps of the test sheet and the exports, keyed by file name
    dependencies : name of the protocol, the SHA-256 of its file and of the lab's dialect cards, the
        version of labpipe, and its processing version
    facts : values of the test sheet: test, protocol, type, spool, sample, date and operator; empty
        if the sheet is faulty
    """

    key: str
    source_hashes: SourceHashes = UNKNOWN_SOURCES
    stamps: Mapping[str, FileStamp] = field(default_factory=dict)
    dependencies: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> str:
        """Write the inputs as JSON, which `parse_inputs` reads."""
        return json.dumps(vars(self))


def parse_inputs(text: str) -> HashedInputs | None:
    """Parse the JSON of `HashedInputs.to_json`.

    Parameters
    ----------
    text : text to parse, as `HashedInputs.to_json` writes it

    Returns
    -------
    The inputs; None if the text has another format, such as that of an earlier labpipe.
    """
    try:
        fields = json.loads(text)
        files, *texts = fields["source_hashes"]
        fields["source_hashes"] = SourceHashes(tuple(map(tuple, files)), *texts)
        fields["stamps"] = {name: FileStamp(*stamp) for name, stamp in fields["stamps"].items()}
        fields["dependencies"] = tuple(fields["dependencies"])
        return HashedInputs(**fields)
    except (ValueError, TypeError, AttributeError, KeyError):
        return None


class InputReader:
    """Reader of the inputs of tests, which hashes each protocol file and dialect card once."""

    def __init__(self) -> None:
        self._find_protocol = cache(find_protocol)
        self._hash_file = cache(lambda path: take_stamp(path).sha256)

    def read_inputs(self, sheet_path: Path, previous: HashedInputs | None = None) -> HashedInputs:
        """Read the inputs of a test.

        Parameters
        ----------
        sheet_path : path of the test sheet, ``test.yaml``
        previous : inputs of the test when they were last read; unchanged files are not read again

        Returns
        -------
        The inputs. If the sheet or the protocol is faulty, the key is made from the hashes of the
        sheet and of the dependencies; those of the exports are included if the sheet could be
        loaded. The hash of an unreadable file is empty.
        """
        folder = sheet_path.parent
        if previous is None:
            return self._read_new_inputs(sheet_path, {})
        stamps = {name: take_stamp(folder / name, stamp) for name, stamp in previous.stamps.items()}
        are_files_unchanged = all(
            stamps[name].sha256 == stamp.sha256 for name, stamp in previous.stamps.items()
        )
        dependencies = previous.dependencies
        current_dependencies = self._collect_dependencies(folder, *dependencies[:1])
        if are_files_unchanged and dependencies == current_dependencies:
            return previous if stamps == previous.stamps else replace(previous, stamps=stamps)
        return self._read_new_inputs(sheet_path, stamps)

    def _read_new_inputs(
        self, sheet_path: Path, previous_stamps: Mapping[str, FileStamp]
    ) -> HashedInputs:
        """Read the sheet and the protocol of a test, and hash its new and changed files."""
        # Reports need names of campaigns, but not the imports of all of processing.
        from labpipe.process.reading import fingerprint_dialect_cards
        from labpipe.process.run import make_input_key

        folder, facts, protocol_name = sheet_path.parent, dict[str, str](), ""
        stamps = {SHEET_NAME: take_stamp(sheet_path, previous_stamps.get(SHEET_NAME))}
        try:
            sheet = load_test_sheet(sheet_path)
            sheet_text = sheet_path.read_text(encoding="utf-8")
            protocol_name = sheet.protocol
            facts = {
                "test": sheet.test,
                "protocol": protocol_name,
                **{name: getattr(sheet.specimen, name) for name in ("type", "spool", "sample")},
                "date": str(sheet.date or ""),
                "operator": sheet.operator,
            }
            for name in itertools.chain(*sheet.files.values()):
                stamps[name] = take_stamp(folder / name, previous_stamps.get(name))
            protocol = resolve_protocol(sheet, sheet_path, follow_links=True)
            protocol_text = format_protocol(protocol)
            cards = fingerprint_dialect_cards(protocol)
        except (LabpipeError, OSError, ValueError):  # a faulty sheet or protocol
            dependencies = self._collect_dependencies(folder, protocol_name)
            file_hashes = [[name, stamp.sha256] for name, stamp in stamps.items()]
            key = hash_text(json.dumps(["unfit", file_hashes, *dependencies[1:]]))
            return HashedInputs(key, stamps=stamps, dependencies=dependencies, facts=facts)
        exports = [(str(role), name) for role in protocol.sources for name in sheet.files[role]]
        files = [(role, name, stamps[name].sha256) for role, name in exports]
        files += [(card.role, card.file, card.sha256) for card in cards]
        return HashedInputs(
            make_input_key([(role, sha) for role, _, sha in files], sheet_text, protocol_text),
            SourceHashes(tuple(files), hash_text(sheet_text), hash_text(protocol_text)),
            stamps,
            self._collect_dependencies(folder, protocol_name),
            facts,
        )

    def _collect_dependencies(self, sheet_folder: Path, protocol_name: str = "") -> tuple[str, ...]:
        """Collect `HashedInputs.dependencies` of a test with this protocol.

        The hash of the file of the protocol is empty if the file does not exist.
        """
        from labpipe.process.run import PROCESSING_VERSION

        is_path = any(character in protocol_name for character in "/\\.")
        search_folder = sheet_folder if is_path else Path()
        path = self._find_protocol(protocol_name, sheet_folder=search_folder)
        protocol_hash = "" if isinstance(path, Fault) else self._hash_file(path)
        versions = __version__, str(PROCESSING_VERSION)
        return protocol_name, protocol_hash, self._cards_hash, *versions

    @cached_property
    def _cards_hash(self) -> str:
        """Hash of the dialect cards of the lab; empty if there are none."""
        from labpipe.readers.load_frame.cards import list_lab_card_files

        card_hashes = [[path.name, self._hash_file(path)] for path in list_lab_card_files()]
        return hash_text(json.dumps(card_hashes)) if card_hashes else ""


def describe_changes(old_sources: SourceHashes, new_sources: SourceHashes) -> str:
    """Describe what changed since a test was processed.

    Parameters
    ----------
    old_sources, new_sources : hashes of the inputs of the stored results, and of the present inputs

    Returns
    -------
    A text such as ``file changed (force.mat), sheet changed``. If no file is known to differ,
    it is ``labpipe changed`` for equal sheets and protocols, and ``unknown change`` if the hash of
    a sheet is missing.
    """
    old_files, new_files = (
        {name: sha256 for _, name, sha256 in hashes.files} for hashes in (old_sources, new_sources)
    )
    changed_names = sorted({name for name, _ in old_files.items() ^ new_files.items()})
    reasons = []
    if changed_names and old_files and new_files:
        reasons.append(f"file changed ({', '.join(changed_names)})")
    if not old_sources.sheet or not new_sources.sheet:
        return ", ".join(reasons) or "unknown change"
    reasons += ["sheet changed"] if old_sources.sheet != new_sources.sheet else []
    reasons += ["protocol changed"] if old_sources.protocol != new_sources.protocol else []
    return ", ".join(reasons) or "labpipe changed"


def hash_text(text: str) -> str:
    """Compute the SHA-256 of a text, hexadecimal."""
    return hashlib.sha256(text.encode()).hexdigest()
