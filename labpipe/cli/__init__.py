"""The command line: parse the arguments, call the work, print the outcome.

Only the standard library is imported here; each command imports what it needs when it runs, so
that ``labpipe --help`` answers at once.
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

_Shared = Mapping[str, Sequence[Any]]

DONE, SOME_FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

_COMPLETION = "_ARGCOMPLETE"
"""Environment variable that the script of `labpipe completion` sets."""
_NO_MEMORY = (
    "expected enough free memory, found none left. Close other programs, or process fewer files;"
    " earlier results are unchanged."
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one labpipe command.

    Parameters
    ----------
    arguments : as typed, without the program's name; those of this process if None

    Returns
    -------
    Exit status: 0 done, 1 some results failed, 2 bad input or usage, 130 interrupted.
    """
    if _COMPLETION in os.environ:  # a shell asks for completions
        from argcomplete import autocomplete

        autocomplete(parser_of_commands())  # exits
    options = parser_of_commands().parse_args(arguments)
    if arguments is not None:
        return _run(options)
    if not sys.warnoptions:  # numpy's, for developers only: `python -W default` shows
        warnings.simplefilter("ignore", RuntimeWarning)
    gc.disable()
    try:
        return _run(options, once_imported=_freeze_imported_objects)
    finally:
        _freeze_imported_objects()


def _run(options: argparse.Namespace, *, once_imported: Callable[[], None] = lambda: None) -> int:
    from labpipe.errors import (
        LabpipeError,
        describe_system_error,
        find_error_code,
    )  # not needed for --help

    # The matrices of a test are too small for more than one BLAS thread.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")  # a name that a terminal cannot show
    try:
        command = import_module(f"labpipe.cli.{options.command}")
        once_imported()
        return int(command.run(options))
    except LabpipeError as error:
        print(f"labpipe {options.command}: {error}", file=sys.stderr)
        return BAD_INPUT
    except KeyboardInterrupt:
        print("labpipe: interrupted; earlier results are unchanged", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of the pipe has closed it: discard what Python flushes at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        if (code := find_error_code(error)) == "fault_of_labpipe":
            raise
        message = _NO_MEMORY if code == "out_of_memory" else describe_system_error(error)
        print(f"labpipe {options.command}: {message}", file=sys.stderr)
        return BAD_INPUT


def _freeze_imported_objects() -> None:
    """Enable garbage collection for objects created from now on.

    Modules are a hundred thousand permanent objects: scanning them for garbage takes a sixth of
    the time of a test.
    """
    gc.freeze()
    gc.enable()


def parser_of_commands() -> argparse.ArgumentParser:
    """Build the parser of all commands from ``commands.toml``."""
    text = Path(__file__).with_name("commands.toml").read_text(encoding="utf-8")
    labpipe, shared, *commands = tomllib.loads(text).items()
    parser = argparse.ArgumentParser(
        prog="labpipe", formatter_class=argparse.RawDescriptionHelpFormatter, **labpipe[1]
    )
    parser.add_argument("--version", action="version", version=f"labpipe {__version__}")
    # The metavar is as long as the longest command, or argparse breaks its line.
    choice = parser.add_subparsers(
        dest="command", metavar="COMMAND [...]", required=True, prog="labpipe"
    )
    for name, command in commands:
        _add_command(choice, name, command, shared[1])
    return parser


def _add_command(choice: Any, name: str, entry: Mapping[str, Any], shared: _Shared) -> None:
    """Add a command, or an action of one."""
    about = entry["about"]
    description = f"{about[0].upper()}{about[1:]}."
    parser = choice.add_parser(
        name, help=about, description=description, epilog=entry.get("epilog")
    )
    _add_arguments(parser, entry.get("arguments", ()), shared)
    if "actions" in entry:
        actions = parser.add_subparsers(dest="action", metavar="ACTION ...", required=True)
        for action, action_entry in entry["actions"].items():
            _add_command(actions, action, action_entry, shared)


def _add_arguments(parser: Any, arguments: Iterable[Any], shared: _Shared) -> None:
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


def _path(text: str) -> Path:
    max_shown_chars = 60
    try:
        Path(text).resolve().exists()
    except (OSError, RuntimeError, ValueError) as error:  # name too long, loop of links
        why = getattr(error, "strerror", None) or "a link that leads back to itself"
        shown_text = text if len(text) <= max_shown_chars else f"{text[:max_shown_chars]}..."
        message = f"expected the name of a file or a folder, found {shown_text!r} ({why})"
        raise argparse.ArgumentTypeError(message) from error
    return Path(text)


def _whole(text: str, least: int = 0) -> int:
    if not text.isdecimal() or int(text) < least:
        of_least = f" of {least} or more" if least else ""
        message = f"expected a whole number{of_least}, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_TYPES: Mapping[str, Callable[[str], object]] = {
    "path": _path,
    "count": partial(_whole, least=1),
    "whole": _whole,
    "number": int,
}
