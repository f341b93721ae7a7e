"""Run the command line: parse the arguments, run the command, return the exit status.

This module imports only the standard library, so that ``labpipe --help`` answers immediately. The
module of a command is imported when that command runs.
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

EXIT_OK, EXIT_SOME_FAILED, EXIT_ERROR, EXIT_INTERRUPTED = 0, 1, 2, 130
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
    Exit status: 0 done, 1 some results failed, 2 bad input or a system error such as a
    full disk, 130 interrupted.

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
        # RuntimeWarnings, mostly from NumPy, are hidden unless an option -W of Python is given.
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
    on_imported : function that is called after the module of the command is imported
    """
    # These modules are imported here, because --help does not need them.
    from labpipe.errors import LabpipeError, choose_error_code, describe_system_error
    from labpipe.messages import format_sentence

    # The matrices of a test are too small to benefit from more than one BLAS thread.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):
        # The name of a file may contain characters that the terminal cannot show.
        sys.stdout.reconfigure(errors="backslashreplace")
    try:
        command = import_module(f"labpipe.cli.{options.command}")
        on_imported()
        return int(command.run(options))
    except LabpipeError as error:
        print(f"labpipe {options.command}: {error}", file=sys.stderr)
        return EXIT_ERROR
    except KeyboardInterrupt:
        print(f"labpipe: {format_sentence('cli.interrupted')}", file=sys.stderr)
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        # The reader has closed the pipe. Python discards the remaining output at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_OK
    except Exception as error:
        code = choose_error_code(error)
        if code == "fault_of_labpipe":
            raise
        is_memory = code == "out_of_memory"
        message = format_sentence("cli.no_memory") if is_memory else describe_system_error(error)
        print(f"labpipe {options.command}: {message}", file=sys.stderr)
        return EXIT_ERROR


def _freeze_imports() -> None:
    """Enable garbage collection only for objects that are created after this call.

    Imported modules contain a hundred thousand permanent objects. Scanning them would take a sixth
    of the processing time of a test. The threshold is so high that the tens of thousands of objects
    of a figure are freed in one collection.
    """
    gc.freeze()
    gc.set_threshold(50_000)
    gc.enable()


def build_parser(command_name: str = "") -> argparse.ArgumentParser:
    """Build the parser of the command line from ``commands.toml``.

    Parameters
    ----------
    command_name : first argument; if it is the name of a command, only this command is added, which
        saves time
    """
    text = Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
    commands = tomllib.loads(text)
    texts, shared_lists = commands.pop("labpipe"), commands.pop("shared")
    parser = argparse.ArgumentParser(
        prog="labpipe", formatter_class=argparse.RawDescriptionHelpFormatter, **texts
    )
    parser.add_argument("--version", action="version", version=f"labpipe {__version__}")
    # The metavar is long, because argparse wraps the help line of a command with a longer name.
    subparsers = parser.add_subparsers(
        dest="command", metavar="COMMAND [...]", required=True, prog="labpipe"
    )
    for name in [command_name] if command_name in commands else commands:
        _add_command(subparsers, name, commands[name], shared_lists)
    return parser


def _add_command(
    subparsers: Any, name: str, entry: Mapping[str, Any], shared_lists: _SharedArguments
) -> None:
    """Add a command, or an action of a command, from its entry in ``commands.toml``."""
    help_text = entry["about"]
    description = f"{help_text[0].upper()}{help_text[1:]}."
    parser = subparsers.add_parser(
        name, help=help_text, description=description, epilog=entry.get("epilog")
    )
    _add_arguments(parser, entry.get("arguments", ()), shared_lists)
    if "actions" in entry:
        actions = parser.add_subparsers(dest="action", metavar="ACTION ...", required=True)
        for action, action_entry in entry["actions"].items():
            _add_command(actions, action, action_entry, shared_lists)


def _add_arguments(parser: Any, arguments: Iterable[Any], shared_lists: _SharedArguments) -> None:
    """Add arguments, lists of shared arguments, and mutually exclusive groups to a parser."""
    for argument in arguments:
        if isinstance(argument, str):
            _add_arguments(parser, shared_lists[argument], shared_lists)
        elif "one_of" in argument:
            _add_arguments(parser.add_mutually_exclusive_group(), argument["one_of"], shared_lists)
        else:
            options = {key: value for key, value in argument.items() if key != "name"}
            if "type" in options:
                options["type"] = _ARGUMENT_PARSERS[options["type"]]
            parser.add_argument(argument["name"], **options)


def _parse_path(text: str) -> Path:
    """Parse a path; raise an error for a name that the operating system rejects."""
    max_length = 60  # characters of the name in the message
    try:
        Path(text).resolve().exists()
    except (OSError, RuntimeError, ValueError) as error:  # a name too long, or a loop of links
        reason = getattr(error, "strerror", None) or str(error)
        if isinstance(error, RuntimeError):
            reason = "a link that leads back to itself"
        short_text = text if len(text) <= max_length else f"{text[:max_length]}..."
        message = f"expected the name of a file or a folder, found {short_text!r} ({reason})"
        raise argparse.ArgumentTypeError(message) from error
    return Path(text)


def _parse_integer(text: str, minimum: int = 0) -> int:
    """Parse an integer that is at least `minimum`."""
    if not text.isdecimal() or int(text) < minimum:
        range_text = f" of {minimum} or more" if minimum else ""
        message = f"expected a whole number{range_text}, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_ARGUMENT_PARSERS: Mapping[str, Callable[[str], object]] = {
    "path": _parse_path,
    "positive": partial(_parse_integer, minimum=1),
    "nonnegative": _parse_integer,
    "integer": int,
    "minutes": lambda text: 60.0 * _parse_integer(text, minimum=1),  # in seconds
}
"""Parser of each type of argument in ``commands.toml``."""
