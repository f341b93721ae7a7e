"""Run the command line: parse the arguments, run the command, return the exit status.

Only the standard library is imported here, so that ``labpipe --help`` answers at once. The module
of a command is imported when it runs.
"""

from __future__ import annotations

import argparse
import gc
import io
import os
import sys
import tomllib
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from labpipe import __version__

_SharedArguments = Mapping[str, Sequence[Any]]
"""Lists of arguments that several commands share, keyed by name of the list."""

DONE, SOME_FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130
"""Exit statuses of commands."""

_COMPLETION_VARIABLE = "_ARGCOMPLETE"
"""Environment variable that the script of `labpipe completion` sets."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one labpipe command.

    Parameters
    ----------
    arguments : arguments as typed, without the name of the program; None for the arguments of this
        process

    Returns
    -------
    Exit status: 0 done, 1 some results failed, 2 bad input, 130 interrupted.

    Raises
    ------
    SystemExit
        With status 2 for bad arguments, and 0 after ``--help``, ``--version`` or completions.
    """
    if _COMPLETION_VARIABLE in os.environ:
        from argcomplete import autocomplete

        autocomplete(build_parser())  # prints the completions and exits
    typed_arguments = sys.argv[1:] if arguments is None else list(arguments)
    options = build_parser(*typed_arguments[:1]).parse_args(typed_arguments)
    if arguments is not None:
        return _run(options)
    if not sys.warnoptions:
        # Warnings of NumPy are hidden, unless `python -W default` requests them.
        warnings.simplefilter("ignore", RuntimeWarning)
    gc.disable()
    try:
        return _run(options, on_imported=_freeze_imports)
    finally:
        _freeze_imports()


def _run(options: argparse.Namespace, *, on_imported: Callable[[], None] = lambda: None) -> int:
    """Run a command and return its exit status; print the message of an expected error.

    Parameters
    ----------
    options : parsed arguments
    on_imported : function that is called when the module of the command has been imported
    """
    # These modules are imported here, because --help does not need them.
    from labpipe.errors import LabpipeError, choose_error_code, describe_system_error
    from labpipe.messages import format_sentence

    # The matrices of a test are too small for more than one BLAS thread.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # The name of a file may have characters that the terminal cannot show.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        command = import_module(f"labpipe.cli.{options.command}")
        on_imported()
        return int(command.run(options))
    except LabpipeError as error:
        print(f"labpipe {options.command}: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print(f"labpipe: {format_sentence('cli.interrupted')}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader has closed the pipe. Python flushes the remaining output at exit, to nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        code, message = choose_error_code(error), format_sentence("cli.no_memory")
        if code == "fault_of_labpipe":
            raise
        if code != "out_of_memory":
            message = describe_system_error(error)
        print(f"labpipe {options.command}: {message}", file=sys.stderr)
        return BAD_INPUT


def _freeze_imports() -> None:
    """Enable garbage collection only for objects that are created after this call.

    Imported modules contain a hundred thousand permanent objects. Scanning them would take a sixth
    of the time of a test. The threshold is so high that a figure with tens of thousands of objects
    is collected as a whole.
    """
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


def build_parser(first_word: str = "") -> argparse.ArgumentParser:
    """Build the parser of the command line from ``commands.toml``.

    Parameters
    ----------
    first_word : first word of the command line; if it is a command, the parser has only this
        command, which saves time
    """
    text = Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
    (_, texts), (_, shared), *commands = tomllib.loads(text).items()
    parser = argparse.ArgumentParser(
        prog="labpipe", formatter_class=argparse.RawDescriptionHelpFormatter, **texts
    )
    parser.add_argument("--version", action="version", version=f"labpipe {__version__}")
    # The metavar is long, because argparse wraps the line of a command with a longer name.
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND [...]", required=True, prog="labpipe"
    )
    for name, command in [entry for entry in commands if entry[0] == first_word] or commands:
        _add_command(subparsers, name, command, shared)
    return parser


def _add_command(
    subparsers: Any, name: str, entry: Mapping[str, Any], shared: _SharedArguments
) -> None:
    """Add a command, or an action of a command, from its entry in ``commands.toml``."""
    about = entry["about"]
    description = f"{about[0].upper()}{about[1:]}."
    parser = subparsers.add_parser(
        name, help=about, description=description, epilog=entry.get("epilog")
    )
    _add_arguments(parser, entry.get("arguments", ()), shared)
    if "actions" in entry:
        actions = parser.add_subparsers(dest="action", metavar="ACTION ...", required=True)
        for action, action_entry in entry["actions"].items():
            _add_command(actions, action, action_entry, shared)


def _add_arguments(parser: Any, arguments: Iterable[Any], shared: _SharedArguments) -> None:
    """Add arguments, lists of shared arguments, and groups of exclusive arguments."""
    for argument in arguments:
        if isinstance(argument, str):
            _add_arguments(parser, shared[argument], shared)
        elif "one_of" in argument:
            _add_arguments(parser.add_mutually_exclusive_group(), argument["one_of"], shared)
        else:
            options = {key: value for key, value in argument.items() if key != "name"}
            if "type" in options:
                options["type"] = _TYPES[options["type"]]
            parser.add_argument(argument["name"], **options)


def _parse_path(text: str) -> Path:
    """Parse a path; raise an error for a name that the system cannot use."""
    max_length = 60  # characters of the name in the message
    try:
        Path(text).resolve().exists()
    except (OSError, RuntimeError, ValueError) as error:  # a name too long, or a loop of links
        reason = getattr(error, "strerror", None) or "a link that leads back to itself"
        short_text = text if len(text) <= max_length else f"{text[:max_length]}..."
        message = f"expected the name of a file or a folder, found {short_text!r} ({reason})"
        raise argparse.ArgumentTypeError(message) from error
    return Path(text)


def _parse_count(text: str, minimum: int = 0) -> int:
    """Parse a whole number of at least a minimum."""
    if not text.isdecimal() or int(text) < minimum:
        range_text = f" of {minimum} or more" if minimum else ""
        message = f"expected a whole number{range_text}, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_TYPES: Mapping[str, Callable[[str], object]] = {
    "path": _parse_path,
    "count": partial(_parse_count, minimum=1),
    "whole": _parse_count,
    "number": int,
}
"""Parser of each type of argument in ``commands.toml``."""
