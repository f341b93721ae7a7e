"""Where a campaign lies, and what lies in its folders."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from labpipe.errors import StoreError, UsageError, error_text, refusal
from labpipe.process.output_paths import RESULT_FILE
from labpipe.process.run import FIGURES, SUMMARY_FILE
from labpipe.protocol.sheet_grammar import SHEET_NAME
from labpipe.store.failure_file import FAILURE_FILE
from labpipe.store.replace import STAGES, finish_cut_off, is_cut_off, locked, storing

RAW, PROCESSED = "raw", "processed"
_OUTCOME = (SUMMARY_FILE, FAILURE_FILE, RESULT_FILE)


@dataclass(frozen=True, slots=True)
class CampaignFolders:
    """A campaign: a folder of exports and a folder of results, at the same place below both.

    Parameters
    ----------
    name : the folder below ``raw`` and ``processed``, with slashes
    raw : exports and test sheets, a folder per test; need not be there any more
    processed : results, a folder per test; made when it is needed
    """

    name: str
    raw: Path
    processed: Path


def find_campaign(folder: Path) -> CampaignFolders:
    """Find both folders of a campaign by one of them.

    Parameters
    ----------
    folder : ``.../raw/NAME`` or ``.../processed/NAME``

    Raises
    ------
    UsageError
        If it is not there, lies below neither, or is the folder of a test.
    """
    if not folder.is_dir():
        found = "a file" if folder.exists() else "nothing of that name"
        raise _no_campaign(folder, "the folder of a campaign", found)
    there = folder.resolve()
    for above in (there, *there.parents):
        if above.name in {RAW, PROCESSED}:
            name = there.relative_to(above)
            raw, processed = (_as_typed(above.parent / each / name) for each in (RAW, PROCESSED))
            if (raw / SHEET_NAME).is_file():
                raise _no_campaign(folder, "the folder of a campaign", "that of a single test")
            return CampaignFolders(name.as_posix(), raw, processed)
    found = "one that lies below neither"
    raise _no_campaign(folder, "a folder below 'raw' or 'processed'", found)


def name_of_campaign(folder: Path) -> str:
    """Name the campaign whose results lie in a folder.

    Parameters
    ----------
    folder : any

    Returns
    -------
    Its name; empty where the folder is that of no campaign.
    """
    with suppress(UsageError):
        return find_campaign(folder).name
    return ""


def _as_typed(path: Path) -> Path:
    """A path as seen from the working folder, if it lies below: messages are kept in files."""
    here = Path.cwd().resolve()
    return path.relative_to(here) if path.is_relative_to(here) else path


def _no_campaign(folder: Path, expected: str, found: str) -> UsageError:
    remedy = "Put the tests into raw/NAME, a folder each; results go to processed/NAME."
    return UsageError(error_text(folder, "", expected=expected, found=found, remedy=remedy))


@dataclass(slots=True)
class RawFolder:
    """What lies below the folder of exports.

    Parameters
    ----------
    sheets : test sheet by test, which is the folder that holds it, below the campaign
    files : all files but hidden ones, below the campaign, with slashes
    refused : what the system does not let see
    """

    sheets: dict[str, Path] = field(default_factory=dict)
    files: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)


def list_raw(campaign: CampaignFolders) -> RawFolder:
    """List tests and files of a campaign, without opening any.

    Parameters
    ----------
    campaign : its folder of exports may be gone, and nothing is found then
    """
    found = RawFolder()
    for label, place, files, _ in _walk(campaign.raw, found.refused):
        found.files += [f"{label}/{name}" if label else name for name in files]
        if SHEET_NAME not in files:
            continue
        sheet = Path(place, SHEET_NAME)
        if sheet.is_file():
            found.sheets[label] = sheet
        else:
            odd, remedy = "a pipe, or a link to nowhere", "Put the test sheet there."
            found.refused.append(error_text(sheet, "", expected="a file", found=odd, remedy=remedy))
    return found


@dataclass(frozen=True, slots=True)
class OutcomeFiles:
    """Which files tell what became of a test, and how they look from outside.

    Parameters
    ----------
    folder : of the results
    marks : size, time and number of each file as text; the same for files that are unchanged
    """

    folder: Path
    marks: str

    @property
    def has_results(self) -> bool:
        """Whether there are whole results."""
        return f"{SUMMARY_FILE}:" in self.marks and f"{RESULT_FILE}:" in self.marks

    @property
    def has_failure(self) -> bool:
        """Whether the last attempt failed."""
        return f"{FAILURE_FILE}:" in self.marks


def list_processed(campaign: CampaignFolders) -> dict[str, OutcomeFiles]:
    """List the outcomes of a campaign by test, without opening any.

    Parameters
    ----------
    campaign : its folder of results may not be there yet

    Returns
    -------
    One for each folder that holds any file of an outcome.
    """
    found = {}
    for label, place, files, hidden in _walk(campaign.processed, [], skipped=FIGURES):
        is_mended = bool(hidden & {*STAGES}) and _mended(Path(place))
        there = os.listdir(place) if is_mended else files  # noqa: PTH208  as the walk gives them
        if {*_OUTCOME} & {*there}:
            found[label] = OutcomeFiles(Path(place), _marks(place, there))
    return found


def _mended(folder: Path) -> bool:
    """Bring to its end what a killed process began, unless another one is at work there."""
    if not is_cut_off(folder):
        return False
    with suppress(StoreError), locked(folder), storing(folder):
        return finish_cut_off(folder)
    return False


def look_at_outcome(campaign: CampaignFolders, test: str) -> OutcomeFiles:
    """Look at the outcome of one test.

    Parameters
    ----------
    campaign : that it belongs to
    test : its folder below the campaign
    """
    folder = campaign.processed / test
    _mended(folder)
    files = [name for name in _OUTCOME if (folder / name).is_file()]
    return OutcomeFiles(folder, _marks(str(folder), files))


def _marks(place: str, files: list[str]) -> str:
    said = []
    for name in _OUTCOME:
        if name not in files:
            continue
        with suppress(OSError):
            about = os.stat(f"{place}/{name}")  # noqa: PTH116  ten thousand of them: Path is slow
            said.append(f"{name}:{about.st_size}:{about.st_mtime_ns}:{about.st_ino}")
    return " ".join(said)


def _walk(
    top: Path, refused: list[str], *, skipped: str = ""
) -> Iterator[tuple[str, str, list[str], set[str]]]:
    """Folders below one, without hidden ones and links: files, and what is hidden."""
    left = [("", str(top))]
    while left:
        label, place = left.pop()
        try:
            with os.scandir(place) as entries:
                every = list(entries)
            seen = [each for each in every if not each.name.startswith(".")]
            refused += [_unfit_name(each.path) for each in seen if not _is_text(each.name)]
            seen = [each for each in seen if _is_text(each.name)]
            folders = {each.name for each in seen if each.is_dir(follow_symlinks=False)}
        except FileNotFoundError:
            continue
        except OSError as error:
            refused.append(refusal(error))
            continue
        files = [each.name for each in seen if each.name not in folders]
        yield label, place, files, {each.name for each in every if each.name.startswith(".")}
        left += [
            (f"{label}/{name}" if label else name, f"{place}/{name}")
            for name in sorted(folders, reverse=True)
            if name != skipped
        ]


def _is_text(name: str) -> bool:
    """Whether a name can be written in a file: those of Linux may be any bytes."""
    return name.isascii() or not any("\ud800" <= sign <= "\udfff" for sign in name)


def _unfit_name(path: str) -> str:
    shown = path.encode("utf-8", "backslashreplace").decode()
    found, remedy = "other bytes", "Rename it; it was left out."
    return error_text(shown, "", expected="a name in UTF-8", found=found, remedy=remedy)
