"""Errors about unusable input, their codes, and the grammar of their messages."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, Self, TypeAlias

from labpipe.messages import find_template, format_error_parts

KeyPath: TypeAlias = tuple[str | int, ...]
"""Path from the top of a YAML file to one value: keys, and item numbers counted from 0."""

At: TypeAlias = Literal["key", "value"]


class LabpipeError(Exception):
    """Bad input or usage, reported in one message without a traceback.

    The grammar of every message is *file, place: expected X, found Y. What to do.*

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
        file, place : see `format_error`
        facts : values of the fields of the template
        """
        message = format_error(file, place, **format_error_parts(name, **facts))
        return cls(message, code=find_template(name).get("code", ""))


class UsageError(LabpipeError):
    """A command was called with an unusable argument."""

    code = "bad_usage"


class ReadError(LabpipeError):
    """An export cannot be read in the format that the protocol states."""

    code = "unreadable_export"


class ProtocolError(LabpipeError):
    """A protocol or a test sheet is wrong; one message lists all its faults."""

    code = "bad_sheet"


class ProcessingError(LabpipeError):
    """A recording is readable but does not contain what the protocol requires."""


class StoreError(LabpipeError):
    """A result file cannot be written, or this version cannot read it."""

    code = "cannot_store"


CODES = MappingProxyType(
    {
        "bad_usage": "a command was called with an unusable argument",
        "bad_sheet": "test.yaml or the protocol is wrong or missing",
        "missing_export": "an export that test.yaml names is missing",
        "missing_channel": "an export has no such channel, or several that match",
        "unreadable_export": "an export is damaged, or has another format than stated",
        "cannot_process": "the recordings do not hold what the protocol asks for",
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
"""Codes of failed tests, stable from version to version, and their meaning."""


@dataclass(frozen=True, slots=True)
class Fault:
    """A fault in a YAML file, and its place.

    Parameters
    ----------
    path : path of the value
    expected, found : see `format_error`
    remedy : how to correct it; may be empty
    at : whether the key itself is at fault, or its value
    missing : the missing key, if that is the fault
    """

    path: KeyPath
    expected: str
    found: str
    remedy: str = ""
    at: At = "value"
    missing: str = ""

    @classmethod
    def of(
        cls,
        name: str,
        path: KeyPath = (),
        /,
        *,
        at: At = "value",
        missing: str = "",
        **facts: object,
    ) -> Self:
        """Make a fault from a template of a ``messages.toml``.

        Parameters
        ----------
        name : name of the template, such as ``protocol.no_key``
        path, at, missing : see the class
        facts : values of the fields of the template
        """
        return cls(path, **format_error_parts(name, **facts), at=at, missing=missing)


def format_error(file: object, place: str, *, expected: str, found: str, remedy: str) -> str:
    """Format one message: file, place: expected X, found Y. What to do.

    Parameters
    ----------
    file : path or name of the file
    place : line, cell, byte, channel or YAML key; empty for the whole file
    expected, found : expected and actual content, without a full stop
    remedy : what the person at the bench can do, a whole sentence

    Returns
    -------
    The message.

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
"""Parts of the messages of libraries and threads that run out of memory."""


def find_error_code(error: Exception) -> str:
    """Return the code of an error that ended the processing of a test, or a command.

    Parameters
    ----------
    error : error as it was raised

    Returns
    -------
    One of `CODES`; ``fault_of_labpipe`` if neither the input nor the system explains the error.
    """
    if isinstance(error, LabpipeError):
        return error.code
    message = str(error).casefold()
    may_lack_memory = isinstance(error, ImportError | RuntimeError | OSError)
    if isinstance(error, MemoryError) or (
        may_lack_memory and any(phrase in message for phrase in _MEMORY_ERROR_PHRASES)
    ):
        return "out_of_memory"
    is_of_system = isinstance(error, OSError | UnicodeEncodeError)
    return "system_refused" if is_of_system else "fault_of_labpipe"


def describe_system_error(error: Exception) -> str:
    """Describe an error of the operating system.

    Parameters
    ----------
    error : an OSError, or the UnicodeEncodeError of a name that the system cannot write

    Returns
    -------
    The message.

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


def sort_by_likeness(word: str, choices: list[str], *, limit: int = 5) -> list[str]:
    """Return the words that are most similar to a misspelt one.

    Parameters
    ----------
    word : word as written
    choices : valid words
    limit : maximum number of words

    Returns
    -------
    At most `limit` of the choices, the most similar first.

    Examples
    --------
    >>> sort_by_likeness("forse", ["time", "force"])
    ['force', 'time']
    """
    import difflib  # only needed once something is already wrong

    def likeness(candidate: str) -> float:
        return difflib.SequenceMatcher(None, word.casefold(), candidate.casefold()).ratio()

    return sorted(choices, key=likeness, reverse=True)[:limit]


def format_overrides(key: str, value: str, **more: str) -> str:
    """Format overrides of a test sheet for messages.

    Parameters
    ----------
    key : dotted, of the protocol
    value : value of the key; ``...`` if the user fills it in
    more : further values by key

    Examples
    --------
    >>> format_overrides("rig.cycles", "1")
    "'rig.cycles: {value: 1, because: ...}' under 'overrides' in test.yaml"
    """
    lines = (f"'{k}: {{value: {v}, because: ...}}'" for k, v in {key: value, **more}.items())
    return f"{' and '.join(lines)} under 'overrides' in test.yaml"
