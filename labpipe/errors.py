"""Define the errors of unusable input, their codes, and the form of their messages."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Self, TypeAlias

from labpipe.messages import format_error_parts, get_template

KeyPath: TypeAlias = tuple[str | int, ...]
"""Path from the top of a YAML file to one value: keys, and indices of items counted from 0."""


class LabpipeError(Exception):
    """Error of input or usage, which is reported in one message without a traceback.

    The form of every message is *file, place: expected X, found Y. What to do.*

    Parameters
    ----------
    message : message for the user
    code : one of `CODES`; empty for the code of the class
    """

    code = "cannot_process"

    def __init__(self, message: str, *, code: str = "") -> None:
        super().__init__(message)
        if code:
            self.code = code

    @classmethod
    def about(cls, name: str, file: object, place: str = "", /, **facts: object) -> Self:
        """Make an error from a template of a ``messages.toml``.

        Parameters
        ----------
        name : name of the template, such as ``readers.no_header``
        file, place : file of the error, and place in it, see `format_error`
        facts : values of the fields of the template, keyed by field
        """
        message = format_error(file, place, **format_error_parts(name, **facts))
        return cls(message, code=get_template(name).get("code", ""))


class UsageError(LabpipeError):
    """Error of an argument of a command or a function."""

    code = "bad_usage"


class ReadError(LabpipeError):
    """Error of an export that cannot be read in the format that the protocol states."""

    code = "unreadable_export"


class ProtocolError(LabpipeError):
    """Error of a YAML file with faults, all of which are in one message."""

    code = "bad_sheet"


class ProcessingError(LabpipeError):
    """Error of a recording that does not contain the data that the protocol requires."""


class StoreError(LabpipeError):
    """Error of a result file that cannot be written, or that this version cannot read."""

    code = "cannot_store"


CODES = MappingProxyType(
    {
        "bad_usage": "a command was called with an unusable argument",
        "bad_sheet": "test.yaml or the protocol is wrong or missing",
        "missing_export": "an export that test.yaml names is missing",
        "missing_channel": "an export has no such channel, or several that match",
        "unreadable_export": "an export is damaged, or has another format than stated",
        "cannot_process": "the recordings lack data that the protocol requires",
        "bad_result": "an earlier result.h5 that is to be processed again cannot be used",
        "disk_full": "the disk or the quota is full",
        "cannot_store": "the results cannot be written for another reason, such as permissions",
        "in_use": "another labpipe process writes the same results; no failure of the test",
        "system_refused": "the operating system refuses a file",
        "out_of_memory": "the test needs more memory than is free",
        "process_died": "the process of the test crashed, was killed, or ran out of memory",
        "time_limit": "the test took longer than the limit",
        "fault_of_labpipe": "labpipe itself has a fault: report it with the exports",
        "no_cluster": "the cluster or its scheduler cannot be reached; no failure of the test",
        "worker_died": "the test ran on more lost workers of a cluster than `allowed-failures`",
        "worker_without_data": "no worker of the cluster can read the files of the test",
        "newer_result": "a newer labpipe wrote the results; they are kept until they are cleared",
        "unknown": "failure.json cannot be read",
    }
)
"""Meaning of each code of a failed test. Codes are the same in all versions."""


@dataclass(frozen=True, slots=True)
class Fault:
    """Fault in a YAML file, and its place.

    Parameters
    ----------
    path : path of the key or value
    expected, found : expected and actual content, see `format_error`
    remedy : sentence on how to correct the fault; may be empty
    is_key : whether the key is at fault, not its value
    missing : name of a missing key in the block at `path`; empty if no key is missing
    """

    path: KeyPath
    expected: str
    found: str
    remedy: str = ""
    is_key: bool = False
    missing: str = ""

    @classmethod
    def of(
        cls,
        name: str,
        path: KeyPath = (),
        /,
        *,
        is_key: bool = False,
        missing: str = "",
        **facts: object,
    ) -> Self:
        """Make a fault from a template of a ``messages.toml``.

        Parameters
        ----------
        name : name of the template, such as ``protocol.no_key``
        path, is_key, missing : see the class
        facts : values of the fields of the template, keyed by field
        """
        return cls(path, **format_error_parts(name, **facts), is_key=is_key, missing=missing)


def format_error(file: object, place: str, *, expected: str, found: str, remedy: str) -> str:
    """Format a message in the form of all labpipe errors.

    Parameters
    ----------
    file : path or name of the file
    place : line, cell, byte, channel or YAML key; empty for the whole file
    expected, found : expected and actual content, without a full stop
    remedy : sentence that says what the user can do

    Returns
    -------
    The message: *file, place: expected X, found Y. What to do.*

    Examples
    --------
    >>> format_error("take.csv", "line 7", expected="a header row", found="nothing",
    ...           remedy="Export the take again.")
    'take.csv, line 7: expected a header row, found nothing. Export the take again.'
    """
    location = f"{file}, {place}" if place else f"{file}"
    return f"{location}: expected {expected}, found {found}. {remedy}"


_MEMORY_ERROR_PHRASES = (
    "failed to map segment",
    "cannot allocate memory",
    "can't start new thread",
)
"""Phrases in the messages of libraries and threads that have no memory left."""


def choose_error_code(error: Exception) -> str:
    """Choose the code of an error that ended a command or the processing of a test.

    Parameters
    ----------
    error : any error

    Returns
    -------
    One of `CODES`; ``fault_of_labpipe`` if neither the input nor the system explains the error.
    """
    if isinstance(error, LabpipeError):
        return error.code
    lacks_memory = isinstance(error, MemoryError)
    if isinstance(error, ImportError | RuntimeError | OSError):
        lacks_memory = any(phrase in str(error).casefold() for phrase in _MEMORY_ERROR_PHRASES)
    if lacks_memory:
        return "out_of_memory"
    is_system_error = isinstance(error, OSError | UnicodeEncodeError)
    return "system_refused" if is_system_error else "fault_of_labpipe"


def describe_system_error(error: Exception) -> str:
    """Describe an error of the operating system.

    Parameters
    ----------
    error : OSError, or UnicodeEncodeError of a name that the system cannot write

    Returns
    -------
    The message, in the form of `format_error`.

    Examples
    --------
    >>> describe_system_error(OSError(36, "File name too long", "xxx"))
    'xxx: expected a file that can be used, found file name too long. Check the path and the disk.'
    """
    if isinstance(error, UnicodeEncodeError):
        return format_error(
            repr(error.object)[:80],
            "",
            expected=f"names that this system can write, whose encoding is {error.encoding}",
            found=ascii(error.object[error.start : error.end])[:80],
            remedy="Choose a locale of UTF-8, such as LC_ALL=C.UTF-8, or set PYTHONUTF8=1.",
        )
    return format_error(
        getattr(error, "filename", None) or "files",
        "",
        expected="a file that can be used",
        found=(getattr(error, "strerror", None) or str(error) or type(error).__name__).lower(),
        remedy="Check the path and the disk.",
    )


def sort_by_likeness(word: str, valid_words: list[str], *, limit: int = 5) -> list[str]:
    """Sort valid words by their likeness to a misspelt word, and return the first ones.

    Parameters
    ----------
    word : misspelt word
    valid_words : words of which the misspelt word may be meant
    limit : maximum number of returned words

    Returns
    -------
    At most `limit` of the valid words, the most similar one first.

    Examples
    --------
    >>> sort_by_likeness("forse", ["time", "force"])
    ['force', 'time']
    """
    import difflib  # only needed for error messages

    def compute_likeness(valid_word: str) -> float:
        return difflib.SequenceMatcher(None, word.casefold(), valid_word.casefold()).ratio()

    return sorted(valid_words, key=compute_likeness, reverse=True)[:limit]


def format_overrides(key: str, value: str, **other_values: str) -> str:
    """Format the overrides that a message suggests for a test sheet.

    Parameters
    ----------
    key : dotted key of the protocol
    value : value of the key, as text; ``...`` if the user has to fill it in
    other_values : values of further overrides, keyed by dotted key

    Examples
    --------
    >>> format_overrides("rig.cycles", "1")
    "'rig.cycles: {value: 1, because: ...}' under 'overrides' in test.yaml"
    """
    values = {key: value, **other_values}
    overrides = (f"'{key}: {{value: {value}, because: ...}}'" for key, value in values.items())
    return f"{' and '.join(overrides)} under 'overrides' in test.yaml"
