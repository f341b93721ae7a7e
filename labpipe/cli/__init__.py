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
import warnings
from collections.abc import Callable, Collection, Sequence
from importlib import import_module
from pathlib import Path

from labpipe import __version__

DONE, SOME_FAILED, BAD_INPUT, INTERRUPTED = 0, 1, 2, 130

_COMPLETION = "_ARGCOMPLETE"
"""Environment variable that the script of `labpipe completion` sets."""
_NO_MEMORY = (
    "expected enough free memory, found none left. Close other programs, or process fewer files;"
    " earlier results are unchanged."
)
_EPILOG = """\
exit status: 0 done; 1 some results failed (they are listed); 2 bad input or usage

first steps:
  labpipe demo                      process a synthetic test of each kind
  labpipe inspect take.csv          what is in this export?
  labpipe new raw/A2/A2-085-1       write the test.yaml of a test
  labpipe check raw/A2              find faults in protocols and test sheets
  labpipe process raw/A2/A2-085-1   numbers and figures
  labpipe campaign run raw/A2       process new and changed tests
  labpipe report processed/A2       means, bands and tables of many tests
  labpipe serve processed/A2        show the report in the browser, decide on tests
  labpipe examples                  copy a wire sheet and the protocols as a start
  labpipe model examples/wires.xlsx
                                    stiffness of wires from their dimensions
  labpipe bundle "19 B1" --wire examples/wires.xlsx
                                    bounds of a bundle's stiffness
  labpipe harness examples/harness-slack.yaml
                                    shape, forces and bend radii of a line between clips
"""


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

        autocomplete(_parser(_COMMANDS))  # exits
    options = _parser(sys.argv[1:] if arguments is None else arguments).parse_args(arguments)
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
    from labpipe.errors import LabpipeError, code_of, refusal  # not needed for --help

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
        if (code := code_of(error)) == "fault_of_labpipe":
            raise
        message = _NO_MEMORY if code == "out_of_memory" else refusal(error)
        print(f"labpipe {options.command}: {message}", file=sys.stderr)
        return BAD_INPUT


def _freeze_imported_objects() -> None:
    """Enable garbage collection for objects created from now on.

    Modules are a hundred thousand permanent objects: scanning them for garbage takes a sixth of
    the time of a test.
    """
    gc.freeze()
    gc.enable()


def _parser(typed: Collection[str]) -> argparse.ArgumentParser:
    """Build the parser of all commands; only a typed command gets its arguments."""
    parser = argparse.ArgumentParser(
        prog="labpipe",
        usage="labpipe [-h] [--version] COMMAND ...",
        description="From the raw exports of a wire-harness test lab to numbers and figures.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"labpipe {__version__}")
    # The metavar is as long as the longest command, or argparse breaks its line.
    commands = parser.add_subparsers(
        dest="command", metavar="COMMAND [...]", required=True, prog="labpipe"
    )
    for name, (about, add_arguments) in _COMMANDS.items():
        command = commands.add_parser(
            name, help=about, description=f"{about[0].upper()}{about[1:]}."
        )
        if name in typed:
            add_arguments(command)
    return parser


def _demo(parser: argparse.ArgumentParser) -> None:
    where = "folder for raw/demo and processed/demo (default: working folder)"
    parser.add_argument("folder", nargs="?", type=_path, default=Path(), metavar="DIR", help=where)
    full_help = "process all 99 tests of three campaigns, report and calibrate; takes minutes"
    parser.add_argument("--full", action="store_true", help=full_help)
    _figures(parser)
    _jobs(parser)


def _inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=_path, metavar="FILE", help="an export of any known format")
    parser.add_argument("--json", action="store_true", help="print JSON")


def _new(parser: argparse.ArgumentParser) -> None:
    where = "folder of a test, or of a campaign: each folder in it gets a sheet"
    parser.add_argument("folder", type=_path, metavar="DIR", help=where)
    parser.add_argument("--from", dest="sheet", type=_path, metavar="SHEET", help="campaign sheet")
    which = "name of the protocol (default: the one that fits the exports best)"
    parser.add_argument("--protocol", metavar="NAME", help=which)
    parser.add_argument("--type", help="specimen type, such as A2")
    parser.add_argument("--spool", help="spool the sample was cut from, such as A2-s1")
    parser.add_argument("--sample", help="number of the sample on its spool")
    parser.add_argument("--length", help='free length with its unit, such as "85 mm"')
    parser.add_argument("--date", help="day of the test, such as 2026-03-04")
    parser.add_argument("--operator", help="person who ran the test")
    for role in ("force", "markers", "frame"):
        parser.add_argument(f"--{role}", metavar="FILE", help=f"export for the role {role}")
    change = (
        "override a value of the protocol, such as markers.clamp=Base, or fill a column of the"
        " sheet, such as tape=PVC; may be repeated"
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=change)
    parser.add_argument("--because", help="reason for overriding protocol values")
    parser.add_argument("--overwrite", action="store_true", help="replace an existing test.yaml")


def _check(parser: argparse.ArgumentParser) -> None:
    where = "protocol, test or campaign (default: protocols/ and raw/)"
    parser.add_argument("paths", nargs="*", type=_path, metavar="PATH", help=where)
    _follow_links(parser)


def _process(parser: argparse.ArgumentParser) -> None:
    what = "test folder, campaign folder, test.yaml, or result.h5 to process again"
    parser.add_argument("tests", nargs="+", type=_path, metavar="TEST", help=what)
    parser.add_argument("--out", type=_path, metavar="DIR", help="write results to DIR/<test>")
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print the summaries as JSON")
    _follow_links(parser)
    _jobs(parser)
    _limit(parser)


def _figures(parser: argparse.ArgumentParser) -> None:
    figures = parser.add_mutually_exclusive_group()
    numbers_only = "write numbers only; existing figures are not changed"
    figures.add_argument("--no-figures", action="store_true", help=numbers_only)
    figures.add_argument("--png", action="store_true", help="also draw figures as PNG")


def _study_results(parser: argparse.ArgumentParser, default: str) -> None:
    where = f"folder of the results (default: {default})"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print JSON, in SI units")


def _follow_links(parser: argparse.ArgumentParser) -> None:
    what = "read exports that are links to files outside the test folder"
    parser.add_argument("--follow-links", action="store_true", help=what)


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


def _jobs(parser: argparse.ArgumentParser) -> None:
    what = (
        "number of tests processed at the same time, each in its own process (default: number of"
        " cores, fewer if memory is short)"
    )
    parser.add_argument("--jobs", type=_count, metavar="N", help=what)


def _limit(parser: argparse.ArgumentParser) -> None:
    what = "time limit per test of many, in minutes (default: %(default)s)"
    parser.add_argument("--limit", type=_count, default=60, metavar="MINUTES", help=what)


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        message = f"expected a whole number of 1 or more, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_LETTERHEAD = {"lab": "laboratory", "customer": "customer", "order": "order number"}


def _report(parser: argparse.ArgumentParser) -> None:
    _report_contents(parser)
    parser.add_argument("--pages", action="store_true", help="also make a page for each test")
    figures = "save every figure as a file: svg, png, pdf, or several (default: svg)"
    parser.add_argument(
        "--figures", nargs="?", const="svg", default="", metavar="FORMAT[,FORMAT...]", help=figures
    )


def _report_contents(parser: argparse.ArgumentParser) -> None:
    what = "folder with processed tests, or a result.h5"
    parser.add_argument("paths", nargs="+", type=_path, metavar="PATH", help=what)
    where = "folder of the report (default: report, beside the tests)"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    parser.add_argument(
        "--title", default="", help="title of the report (default: name of the folder)"
    )
    for name, what in _LETTERHEAD.items():
        parser.add_argument(f"--{name}", default="", metavar="TEXT", help=f"{what}, on page one")
    logo = "logo on page one, PNG or JPEG, at most 200 kB"
    parser.add_argument("--logo", type=_path, metavar="PICTURE", help=logo)
    fields = (
        "fields of the test sheets to group by, such as wire,taping (default: type, and all fields"
        " of the specimen that differ within a type)"
    )
    parser.add_argument("--by", default="", metavar="FIELD[,FIELD...]", help=fields)
    alone_help = "show only pairs of groups that differ in this field alone, such as taping"
    parser.add_argument("--compare", default="", metavar="FIELD", help=alone_help)
    sheet = "wire sheet; compares bundles with the bounds of slipping and sticking wires"
    parser.add_argument("--wire", type=_path, metavar="SHEET", help=sheet)


def _serve(parser: argparse.ArgumentParser) -> None:
    _report_contents(parser)
    parser.set_defaults(pages=False, figures="")
    which = "port on the local address; 0 for any free one (default: %(default)s)"
    parser.add_argument("--port", type=_whole, default=8765, metavar="N", help=which)
    shut = "print the address; do not open a browser"
    parser.add_argument("--no-browser", action="store_true", help=shut)


def _whole(text: str) -> int:
    if not text.isdecimal():
        message = f"expected a whole number, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_CAMPAIGN = {
    "run": "process new and changed tests only",
    "status": "show states of all tests, failures, pending tests and unknown files",
    "query": "select results of many tests by a condition",
    "replay": "clear failures and process these tests again",
    "decide": "accept or reject a test",
    "rebuild": "rebuild the catalog from the files of the tests",
    "watch": "wait for exports and report each test seconds after its recording ends",
}


def _campaign(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION ...", required=True)
    where = "campaign: raw/NAME with a folder per test, or processed/NAME"
    for name, about in _CAMPAIGN.items():
        action = actions.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        action.add_argument("folder", type=_path, metavar="DIR", help=where)
        _CAMPAIGN_ARGUMENTS.get(name, lambda _: None)(action)


def _campaign_run(parser: argparse.ArgumentParser) -> None:
    _figures(parser)
    _follow_links(parser)
    _jobs(parser)
    _limit(parser)
    who = "where tests are processed: local, or dask://HOST:PORT (default: %(default)s)"
    parser.add_argument("--executor", default="local", metavar="WHERE", help=who)


def _campaign_status(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON")


def _campaign_query(parser: argparse.ArgumentParser) -> None:
    what = "condition in SQL, such as \"name = 'peak_force.1' and type = 'A1'\" (default: all)"
    parser.add_argument("--where", default="", metavar="CONDITION", help=what)
    kinds = ("table", "csv", "json", "xlsx")
    form = "output format (default: %(default)s)"
    parser.add_argument("--out", choices=kinds, default="table", metavar="FORM", help=form)
    where = "file to write; required for xlsx (default: standard output)"
    parser.add_argument("--file", type=_path, metavar="FILE", help=where)


def _campaign_replay(parser: argparse.ArgumentParser) -> None:
    what = "clear failures of this code, such as process_died (default: all)"
    parser.add_argument("--failed", nargs="?", const="", required=True, metavar="CODE", help=what)
    _campaign_run(parser)


def _campaign_decide(parser: argparse.ArgumentParser) -> None:
    what = "name of the test, or its folder below DIR"
    parser.add_argument("test", nargs="?", default="", metavar="TEST", help=what)
    parser.add_argument("decision", nargs="?", choices=("accept", "reject"), help="the decision")
    parser.add_argument("--because", default="", metavar="REASON", help="reason for the decision")
    parser.add_argument("--by", default="", metavar="WHO", help="person who decides")
    example = 'raw/A2 A2-085-1 reject --because "slipped in the grip" --by AT'
    parser.epilog = f"such as: labpipe campaign decide {example}"
    saved = "import decisions that a report page saved, instead of TEST"
    parser.add_argument("--from", dest="saved", type=_path, metavar="FILE", help=saved)


def _campaign_watch(parser: argparse.ArgumentParser) -> None:
    drawn = "write numbers only; by default figures are drawn after the verdict"
    parser.add_argument("--no-figures", action="store_true", help=drawn)


_CAMPAIGN_ARGUMENTS = {
    "run": _campaign_run,
    "status": _campaign_status,
    "query": _campaign_query,
    "replay": _campaign_replay,
    "decide": _campaign_decide,
    "watch": _campaign_watch,
}


def _model(parser: argparse.ArgumentParser) -> None:
    what = "wire sheet, xlsx or csv: one row per wire"
    parser.add_argument("sheet", type=_path, metavar="WIRES", help=what)
    _study_results(parser, "processed/<name of the sheet>")


def _bundle(parser: argparse.ArgumentParser) -> None:
    what = 'wires, such as "10 B1 + 9 B2", or the test.yaml or processed folder of a harness bundle'
    parser.add_argument("bundle", metavar="BUNDLE", help=what)
    sheet = "wire sheet with the types of the bundle as its wires (default: %(default)s)"
    parser.add_argument(
        "--wire", type=_path, default=Path("wires.xlsx"), metavar="WIRES", help=sheet
    )
    where = "packed, symmetric or asymmetric (default: that of the test.yaml, else packed)"
    parser.add_argument("--arrangement", metavar="WORD", help=where)
    bore = (
        'inner diameter of a conduit, such as "10.7 mm"; may be repeated: the best filled is used'
    )
    parser.add_argument("--bore", action="append", default=[], metavar="LENGTH", help=bore)
    _study_results(parser, "processed/bundles/<name>")


def _harness(parser: argparse.ArgumentParser) -> None:
    what = "harness YAML: a line, its supports and its motion"
    parser.add_argument("files", nargs="+", type=_path, metavar="HARNESS", help=what)
    sheet = "wire sheet, instead of the one named in the file"
    parser.add_argument("--wire", type=_path, metavar="SHEET", help=sheet)
    _study_results(parser, "processed/harness/<name of the file>")


def _calibrate(parser: argparse.ArgumentParser) -> None:
    what = "folder with processed cantilever tests, or a result.h5"
    parser.add_argument("paths", nargs="+", type=_path, metavar="PATH", help=what)
    sheet = (
        "wire sheet with the specimen types as its wires (default: wires.xlsx or wires.csv here)"
    )
    parser.add_argument("--wire", type=_path, metavar="SHEET", help=sheet)
    plan = "calibration YAML: wire; free, fixed and prior parameters (default: all free)"
    parser.add_argument("--plan", type=_path, metavar="FILE", help=plan)
    _study_results(parser, "calibration, beside the tests")


def _simulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out",
        type=_path,
        default=Path("raw"),
        metavar="DIR",
        help="folder of the test (default: raw)",
    )
    parser.add_argument(
        "--name", default="synthetic-1", help="name of the test (default: %(default)s)"
    )
    kind_help = "kind of specimen (default: %(default)s)"
    kinds = ("wire", "taped-bundle", "conduit-bundle")
    parser.add_argument("--kind", choices=kinds, default="wire", help=kind_help)
    which = "type of a bundle: TWB-B1-19-PVC, CWB-2a ... (default: the first with 19 wires)"
    parser.add_argument("--type", default=None, metavar="TYPE", help=which)
    parser.add_argument(
        "--rate", default="10 kHz", help="sampling rate of the force (default: %(default)s)"
    )
    parser.add_argument(
        "--fps", default="50 Hz", help="frame rate of the cameras (default: %(default)s)"
    )
    cycles = "cycles of a cantilever test (default: 3); a conduit bundle is bent once"
    parser.add_argument("--cycles", type=int, default=None, help=cycles)
    parser.add_argument(
        "--seed", type=int, default=1, help="seed of the noise (default: %(default)s)"
    )


def _examples(parser: argparse.ArgumentParser) -> None:
    where = "folder for the copies (default: %(default)s)"
    parser.add_argument(
        "folder", nargs="?", type=_path, default=Path("examples"), metavar="DIR", help=where
    )


def _completion(parser: argparse.ArgumentParser) -> None:
    shells = ("bash", "zsh", "fish", "powershell")
    what = f"shell to complete in: {', '.join(shells)}"
    parser.add_argument("shell", choices=shells, metavar="SHELL", help=what)


_COMMANDS = {
    "demo": ("make, process and report synthetic tests in vendor formats", _demo),
    "inspect": ("show what an export contains: channels, rate, gaps, oddities", _inspect),
    "new": ("write test.yaml files from the exports or from a campaign sheet", _new),
    "check": ("check protocols and test sheets without processing", _check),
    "process": ("process exports into result.h5, summary.json and figures", _process),
    "campaign": ("process many tests incrementally; states, queries, decisions", _campaign),
    "report": ("summarise processed tests in a page, figures and a workbook", _report),
    "serve": ("show a report in the browser and save decisions on tests", _serve),
    "model": ("compute stiffness tables and simulation decks of wires", _model),
    "bundle": ("compute bounds of a harness bundle's bending stiffness", _bundle),
    "harness": ("compute shape, forces and bend radii of a line between clips", _harness),
    "calibrate": ("calibrate a wire model with cantilever tests", _calibrate),
    "simulate": ("write synthetic exports of a test with known truth", _simulate),
    "examples": ("copy a wire sheet, a calibration plan, harnesses, the protocols", _examples),
    "completion": ("print a script for Tab completion of commands and options", _completion),
}
"""Help text of each command, and the function that adds its arguments."""
