"""Find the folders of a campaign, and list its tests and files without opening any file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from labpipe.errors import StoreError, UsageError, describe_system_error
from labpipe.process.output_paths import FIGURES_FOLDER, RESULT_FILE
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.replace import STAGES, finish_cut_off, is_cut_off, locked, storing
from labpipe.store.summaries import FAILURE_FILE, SUMMARY_FILE

RAW, PROCESSED = "raw", "processed"
_OUTCOME_FILES = (SUMMARY_FILE, FAILURE_FILE, RESULT_FILE)


@dataclass(frozen=True, slots=True)
class CampaignFolders:
    """A campaign: a folder of exports and a folder of results with the same name.

    Parameters
    ----------
    name : path of both folders below ``raw`` and ``processed``, with slashes
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
    folder : path of one of them, ``.../raw/NAME`` or ``.../processed/NAME``

    Raises
    ------
    UsageError
        If the folder does not exist, is below neither ``raw`` nor ``processed``, or is the folder
        of a single test.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing of that name"
        raise UsageError.about("campaign.no_campaign", folder, found=found)
    start = folder.resolve()
    top_folders = [parent for parent in (start, *start.parents) if parent.name in {RAW, PROCESSED}]
    if not top_folders:
        raise UsageError.about("campaign.outside_campaigns", folder)
    name = start.relative_to(top_folders[0])
    current, paths = (
        Path.cwd().resolve(),
        (top_folders[0].parent / top / name for top in (RAW, PROCESSED)),
    )
    raw, processed = (
        path.relative_to(current) if path.is_relative_to(current) else path for path in paths
    )
    if (raw / SHEET_NAME).is_file():
        raise UsageError.about("campaign.no_campaign", folder, found="the folder of a single test")
    return CampaignFolders(name.as_posix(), raw, processed)


def find_campaign_name(folder: Path) -> str:
    """Find the name of the campaign to which a folder belongs.

    Parameters
    ----------
    folder : path of any folder

    Returns
    -------
    Name of the campaign; empty if the folder belongs to no campaign.
    """
    with suppress(UsageError):
        return find_campaign(folder).name
    return ""


@dataclass(slots=True)
class RawContent:
    """Test sheets and files below the folder of exports.

    Parameters
    ----------
    sheets : path of each test sheet, by test; a test is named by its folder below the campaign
    files : paths of all files except hidden ones, relative to the folder of exports, with slashes
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
    """Files written when a test was processed: results, summary, failure.

    Parameters
    ----------
    folder : path of the folder of results
    signature : name, size, modification time and inode of each file as text; equal for unchanged
        files, empty without any file
    """

    folder: Path
    signature: str

    @property
    def has_results(self) -> bool:
        """Return whether the results are complete."""
        return f"{SUMMARY_FILE}:" in self.signature and f"{RESULT_FILE}:" in self.signature

    @property
    def has_failure(self) -> bool:
        """Return whether the last processing of the test failed."""
        return f"{FAILURE_FILE}:" in self.signature


def list_processed(campaign: CampaignFolders) -> dict[str, OutcomeFiles]:
    """List the outcome files of a campaign by test, without opening any file.

    Parameters
    ----------
    campaign : folders of the campaign; the folder of results may be missing

    Returns
    -------
    Outcome files by test; tests without such files are absent.
    """
    outcomes = {}
    for test, folder, files, hidden in _walk(campaign.processed, [], skipped=FIGURES_FOLDER):
        if hidden & {*STAGES}:
            outcome = find_outcome(campaign, test)
        else:
            outcome = OutcomeFiles(Path(folder), _compute_signature(folder, files))
        if outcome.signature:
            outcomes[test] = outcome
    return outcomes


def find_outcome(campaign: CampaignFolders, test: str) -> OutcomeFiles:
    """Find the outcome files of one test.

    A replacement of files that a killed process left unfinished is completed first.

    Parameters
    ----------
    campaign : folders of the campaign of the test
    test : folder of the test below the campaign
    """
    folder = campaign.processed / test
    if is_cut_off(folder):  # unless another process still writes there
        with suppress(StoreError), locked(folder), storing(folder):
            finish_cut_off(folder)
    files = [name for name in _OUTCOME_FILES if (folder / name).is_file()]
    return OutcomeFiles(folder, _compute_signature(str(folder), files))


def _compute_signature(folder: str, files: list[str]) -> str:
    parts = []
    for name in _OUTCOME_FILES:
        if name not in files:
            continue
        with suppress(OSError):
            status = os.stat(f"{folder}/{name}")  # noqa: PTH116  Path is slow for 10 000 files
            parts.append(f"{name}:{status.st_size}:{status.st_mtime_ns}:{status.st_ino}")
    return " ".join(parts)


def _walk(
    top: Path, problems: list[str], *, skipped: str = ""
) -> Iterator[tuple[str, str, list[str], set[str]]]:
    """Walk through folders, except hidden ones, links, and those with the name `skipped`.

    Yields the path of each folder below `top` with slashes, its full path, the names of its files
    and links, and the names of its hidden entries.
    """

    def note_error(error: OSError) -> None:
        if not isinstance(error, FileNotFoundError):
            problems.append(describe_system_error(error))

    for folder, subfolders, files in os.walk(top, onerror=note_error):
        links = {name for name in subfolders if os.path.islink(f"{folder}/{name}")}  # noqa: PTH114
        hidden = {name for name in (*subfolders, *files) if name.startswith(".")}
        undecodable = {name for name in {*subfolders, *files} - hidden if not _is_text(name)}
        for name in sorted(undecodable):
            printable = f"{folder}/{name}".encode("utf-8", "backslashreplace").decode()
            problems.append(str(StoreError.about("campaign.undecodable_name", printable)))
        subfolders[:] = sorted({*subfolders} - links - hidden - undecodable - {skipped})
        test = folder[len(str(top)) + 1 :].replace(os.sep, "/")
        yield test, folder, [*({*files} | links) - hidden - undecodable], hidden


def _is_text(name: str) -> bool:
    """Return whether a file name could be decoded; on Linux, a name may hold any bytes."""
    return name.isascii() or not any("\ud800" <= character <= "\udfff" for character in name)
