"""The command line: parse arguments, call what does the work, print.

Only the standard library is imported here; each command imports what it needs when it runs, so
that ``labpipe --help`` answers in a blink.
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

_NO_FIGURES = "numbers only; figures drawn before stay as they are"
_SHOWN = 60
_COMPLETION = "_ARGCOMPLETE"
"""Set in the environment by the script of `labpipe completion`."""
_NO_MEMORY = (
    "expected data that go into the memory, found that it was used up. Close other programs, or"
    " take fewer files; earlier results are as they were."
)
_EPILOG = """\
exit status: 0 done; 1 some results failed (they are listed); 2 bad input or usage

first steps:
  labpipe demo                      see it work, on a synthetic test of each kind
  labpipe inspect take.csv          what is in this export?
  labpipe new raw/A2/A2-085-1       write the test.yaml of a test
  labpipe check raw/A2              is everything there, and spelt right?
  labpipe process raw/A2/A2-085-1   numbers and figures
  labpipe campaign run raw/A2       process what is new or changed, as often as you like
  labpipe report processed/A2       means, bands and tables of many tests
  labpipe serve processed/A2        the report in the browser, to decide on its tests
  labpipe examples                  get a wire sheet and the protocols, to start from
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
    if _COMPLETION in os.environ:  # a shell asks what may follow
        from argcomplete import autocomplete

        autocomplete(_parser(_COMMANDS))  # and ends
    options = _parser(sys.argv[1:] if arguments is None else arguments).parse_args(arguments)
    if arguments is not None:
        return _run(options)
    if not sys.warnoptions:  # numpy's are for those who change labpipe: `python -W default` shows
        warnings.simplefilter("ignore", RuntimeWarning)
    gc.disable()
    try:
        return _run(options, once_imported=_spare_the_collector)
    finally:
        _spare_the_collector()


def _run(options: argparse.Namespace, *, once_imported: Callable[[], None] = lambda: None) -> int:
    from labpipe.errors import LabpipeError, code_of, refusal  # help need not wait for it

    # The matrices of a test are small: more than one thread of BLAS only waits for the others.
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
        print("labpipe: interrupted; earlier results are as they were", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        # The reader of a pipe went away; what Python would flush at exit has nowhere to go.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return DONE
    except Exception as error:
        if (code := code_of(error)) == "fault_of_labpipe":
            raise
        said = _NO_MEMORY if code == "out_of_memory" else refusal(error)
        print(f"labpipe {options.command}: {said}", file=sys.stderr)
        return BAD_INPUT


def _spare_the_collector() -> None:
    """Let the collector work, but not on what there is by now.

    Modules are a hundred thousand objects that last: to look through them for garbage again and
    again, and once more when the process ends, takes a sixth of the time of a test.
    """
    gc.freeze()
    gc.enable()


def _parser(typed: Collection[str]) -> argparse.ArgumentParser:
    """Parser of all commands; only one that was typed has arguments."""
    parser = argparse.ArgumentParser(
        prog="labpipe",
        usage="labpipe [-h] [--version] COMMAND ...",
        description="From the raw exports of a wire-harness test lab to numbers and figures.",
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"labpipe {__version__}")
    # As long as the longest command is indented, or argparse puts that one on two lines.
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
    where = "folder that gets raw/demo and processed/demo (default: here)"
    parser.add_argument("folder", nargs="?", type=_path, default=Path(), metavar="DIR", help=where)
    whole = "make the whole campaigns, 99 tests with a report each, and calibrate: some minutes"
    parser.add_argument("--full", action="store_true", help=whole)
    _figures(parser)
    _jobs(parser)


def _inspect(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("file", type=_path, metavar="FILE", help="an export of any known format")
    parser.add_argument("--json", action="store_true", help="print JSON")


def _new(parser: argparse.ArgumentParser) -> None:
    where = "of the test, or of the campaign: a sheet for each folder in it"
    parser.add_argument("folder", type=_path, metavar="DIR", help=where)
    parser.add_argument("--from", dest="sheet", type=_path, metavar="SHEET", help="campaign sheet")
    which = "(default: the one that fits the exports best)"
    parser.add_argument("--protocol", metavar="NAME", help=which)
    parser.add_argument("--type", help="specimen type, such as A2")
    parser.add_argument("--spool", help="spool the sample was cut from, such as A2-s1")
    parser.add_argument("--sample", help="number of the sample on its spool")
    parser.add_argument("--length", help='free length with its unit, such as "85 mm"')
    parser.add_argument("--date", help="day of the test, such as 2026-03-04")
    parser.add_argument("--operator", help="who ran it")
    for role in ("force", "markers", "frame"):
        parser.add_argument(f"--{role}", metavar="FILE", help=f"export of the role {role}")
    change = (
        "override a value of the protocol, such as markers.clamp=Base, or fill a column of a"
        " campaign sheet, such as tape=PVC; can be repeated"
    )
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", help=change)
    parser.add_argument("--because", help="why the protocol's values are overridden")
    parser.add_argument("--overwrite", action="store_true", help="replace a test.yaml that exists")


def _check(parser: argparse.ArgumentParser) -> None:
    where = "protocols, tests or campaigns (default: protocols/ and raw/)"
    parser.add_argument("paths", nargs="*", type=_path, metavar="PATH", help=where)
    _follow_links(parser)


def _process(parser: argparse.ArgumentParser) -> None:
    what = "test folder, campaign folder, test.yaml, or a result.h5 to process again"
    parser.add_argument("tests", nargs="+", type=_path, metavar="TEST", help=what)
    parser.add_argument("--out", type=_path, metavar="DIR", help="write to DIR/<test> instead")
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print the summaries as JSON")
    _follow_links(parser)
    _jobs(parser)
    _limit(parser)


def _figures(parser: argparse.ArgumentParser) -> None:
    drawn = parser.add_mutually_exclusive_group()
    drawn.add_argument("--no-figures", action="store_true", help=_NO_FIGURES)
    drawn.add_argument("--png", action="store_true", help="draw figures as PNG, too")


def _follow_links(parser: argparse.ArgumentParser) -> None:
    what = "exports may be links out of the folder of their test, such as into a store"
    parser.add_argument("--follow-links", action="store_true", help=what)


def _path(text: str) -> Path:
    try:
        Path(text).resolve().exists()
    except (OSError, RuntimeError, ValueError) as error:  # too long a name, a loop of links
        why = getattr(error, "strerror", None) or "a link that leads back to itself"
        shown = text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."
        message = f"expected the name of a file or a folder, found {shown!r} ({why})"
        raise argparse.ArgumentTypeError(message) from error
    return Path(text)


def _jobs(parser: argparse.ArgumentParser) -> None:
    what = (
        "tests at a time, each in a process of its own (default: the cores, fewer where memory is"
        " short)"
    )
    parser.add_argument("--jobs", type=_count, metavar="N", help=what)


def _limit(parser: argparse.ArgumentParser) -> None:
    what = "minutes after which a test of many is given up (default: %(default)s)"
    parser.add_argument("--limit", type=_count, default=60, metavar="MINUTES", help=what)


def _count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        message = f"expected a whole number of 1 or more, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_LETTERHEAD = {"lab": "name of the laboratory", "customer": "who it is for", "order": "its number"}


def _report(parser: argparse.ArgumentParser) -> None:
    _what_is_reported(parser)
    parser.add_argument("--pages", action="store_true", help="make a page for each test, too")
    figures = "save every figure as a file: svg, png, pdf, or several of them (default: svg)"
    parser.add_argument(
        "--figures", nargs="?", const="svg", default="", metavar="FORMAT[,FORMAT...]", help=figures
    )


def _what_is_reported(parser: argparse.ArgumentParser) -> None:
    what = "folder with processed tests, or a result.h5"
    parser.add_argument("paths", nargs="+", type=_path, metavar="PATH", help=what)
    where = "folder of the report (default: report, beside the tests)"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    parser.add_argument("--title", default="", help="of the report (default: the folder's name)")
    for name, what in _LETTERHEAD.items():
        parser.add_argument(f"--{name}", default="", metavar="WORDS", help=f"{what}, for page one")
    logo = "a picture for page one, PNG or JPEG, at most 200 kB"
    parser.add_argument("--logo", type=_path, metavar="PICTURE", help=logo)
    fields = (
        "fields of the test sheets that groups are made by, such as wire,taping (default: type, "
        "and all else of the specimen that differs within a type)"
    )
    parser.add_argument("--by", default="", metavar="FIELD[,FIELD...]", help=fields)
    alone = "show only pairs of groups that differ in this field and no other, such as taping"
    parser.add_argument("--compare", default="", metavar="FIELD", help=alone)
    sheet = "wire sheet: shows where bundles lie between wires that slip and wires that stick"
    parser.add_argument("--wire", type=_path, metavar="SHEET", help=sheet)


def _serve(parser: argparse.ArgumentParser) -> None:
    _what_is_reported(parser)
    which = "of this machine's own address; 0 for any that is free (default: %(default)s)"
    parser.add_argument("--port", type=_whole, default=8765, metavar="N", help=which)
    shut = "print the address only; else it is opened in the browser"
    parser.add_argument("--no-browser", action="store_true", help=shut)


def _whole(text: str) -> int:
    if not text.isdecimal():
        message = f"expected a whole number, found {text!r}"
        raise argparse.ArgumentTypeError(message)
    return int(text)


_CAMPAIGN = {
    "run": "process what is new or changed, and nothing else",
    "status": "states of all tests, what failed, waits or is unknown",
    "query": "results of many tests that fit a condition",
    "replay": "clear failures and process their tests again",
    "decide": "accept or reject a test",
    "rebuild": "make the catalog anew from the files of the tests",
    "watch": "wait for exports, and judge each test seconds after its recording ends",
}


def _campaign(parser: argparse.ArgumentParser) -> None:
    actions = parser.add_subparsers(dest="action", metavar="ACTION ...", required=True)
    where = "the campaign: raw/NAME with a folder per test, or processed/NAME"
    for name, about in _CAMPAIGN.items():
        action = actions.add_parser(name, help=about, description=f"{about[0].upper()}{about[1:]}.")
        action.add_argument("folder", type=_path, metavar="DIR", help=where)
        _CAMPAIGN_ARGUMENTS.get(name, lambda _: None)(action)


def _campaign_run(parser: argparse.ArgumentParser) -> None:
    _figures(parser)
    _follow_links(parser)
    _jobs(parser)
    _limit(parser)
    who = "what processes the tests: local, or dask://HOST:PORT (default: %(default)s)"
    parser.add_argument("--executor", default="local", metavar="WHERE", help=who)


def _campaign_status(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--json", action="store_true", help="print JSON")


def _campaign_query(parser: argparse.ArgumentParser) -> None:
    what = "condition in SQL, such as \"name = 'peak_force.1' and type = 'A1'\" (default: all)"
    parser.add_argument("--where", default="", metavar="CONDITION", help=what)
    kinds = ("table", "csv", "json", "xlsx")
    form = "of what is printed (default: %(default)s)"
    parser.add_argument("--out", choices=kinds, default="table", metavar="FORM", help=form)
    where = "file to write, which xlsx needs (default: standard output)"
    parser.add_argument("--file", type=_path, metavar="FILE", help=where)


def _campaign_replay(parser: argparse.ArgumentParser) -> None:
    what = "clear failures of this code, such as process_died (default: all)"
    parser.add_argument("--failed", nargs="?", const="", required=True, metavar="CODE", help=what)
    _campaign_run(parser)


def _campaign_decide(parser: argparse.ArgumentParser) -> None:
    what = "name of the test, or its folder below DIR"
    parser.add_argument("test", nargs="?", default="", metavar="TEST", help=what)
    parser.add_argument("decision", nargs="?", choices=("accept", "reject"), help="what is decided")
    parser.add_argument("--because", default="", metavar="REASON", help="why")
    parser.add_argument("--by", default="", metavar="WHO", help="who decides")
    example = 'raw/A2 A2-085-1 reject --because "slipped in the grip" --by AT'
    parser.epilog = f"such as: labpipe campaign decide {example}"
    saved = "take in the decisions that the page of a report saved, in place of TEST"
    parser.add_argument("--from", dest="saved", type=_path, metavar="FILE", help=saved)


def _campaign_watch(parser: argparse.ArgumentParser) -> None:
    drawn = "numbers only; else figures are drawn once the verdict is said"
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
    where = "folder of the results (default: processed/<name of the sheet>)"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print the tables as JSON, in SI units")


def _bundle(parser: argparse.ArgumentParser) -> None:
    what = 'wires, such as "10 B1 + 9 B2", or the test.yaml or processed folder of a harness bundle'
    parser.add_argument("bundle", metavar="BUNDLE", help=what)
    sheet = "wire sheet with the types of the bundle as its wires (default: %(default)s)"
    parser.add_argument(
        "--wire", type=_path, default=Path("wires.xlsx"), metavar="WIRES", help=sheet
    )
    where = "packed, symmetric or asymmetric (default: that of the test.yaml, else packed)"
    parser.add_argument("--arrangement", metavar="WORD", help=where)
    bore = 'inner diameter of a conduit, such as "10.7 mm"; of several, the best filled is chosen'
    parser.add_argument("--bore", action="append", default=[], metavar="LENGTH", help=bore)
    where = "folder of the results (default: processed/bundles/<name>)"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print JSON, in SI units")


def _harness(parser: argparse.ArgumentParser) -> None:
    what = "harness YAML: a line, what holds it, and what moves it"
    parser.add_argument("files", nargs="+", type=_path, metavar="HARNESS", help=what)
    sheet = "wire sheet in place of the one that the file names"
    parser.add_argument("--wire", type=_path, metavar="SHEET", help=sheet)
    where = "folder of the results (default: processed/harness/<name of the file>)"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print JSON, in SI units")


def _calibrate(parser: argparse.ArgumentParser) -> None:
    what = "folder with processed cantilever tests, or a result.h5"
    parser.add_argument("paths", nargs="+", type=_path, metavar="PATH", help=what)
    sheet = (
        "wire sheet with the specimen types as its wires (default: wires.xlsx or wires.csv here)"
    )
    parser.add_argument("--wire", type=_path, metavar="SHEET", help=sheet)
    plan = "calibration YAML: which wire, what is free, fixed or has a prior (default: all free)"
    parser.add_argument("--plan", type=_path, metavar="FILE", help=plan)
    where = "folder of the results (default: calibration, beside the tests)"
    parser.add_argument("--out", type=_path, metavar="DIR", help=where)
    _figures(parser)
    parser.add_argument("--json", action="store_true", help="print JSON, in SI units")


def _simulate(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--out", type=_path, default=Path("raw"), metavar="DIR", help="(default: raw)"
    )
    parser.add_argument("--name", default="synthetic-1", help="of the test (default: %(default)s)")
    kind = "what is tested (default: %(default)s)"
    kinds = ("wire", "taped-bundle", "conduit-bundle")
    parser.add_argument("--kind", choices=kinds, default="wire", help=kind)
    which = "of a bundle: TWB-B1-19-PVC, CWB-2a ... (default: the first with 19 wires)"
    parser.add_argument("--type", default=None, metavar="TYPE", help=which)
    parser.add_argument("--rate", default="10 kHz", help="of the force (default: %(default)s)")
    parser.add_argument("--fps", default="50 Hz", help="of the cameras (default: %(default)s)")
    cycles = "of a cantilever test (default: 3); a conduit bundle is bent once"
    parser.add_argument("--cycles", type=int, default=None, help=cycles)
    parser.add_argument("--seed", type=int, default=1, help="(default: %(default)s)")


def _examples(parser: argparse.ArgumentParser) -> None:
    where = "folder that gets them (default: %(default)s)"
    parser.add_argument(
        "folder", nargs="?", type=_path, default=Path("examples"), metavar="DIR", help=where
    )


def _completion(parser: argparse.ArgumentParser) -> None:
    shells = ("bash", "zsh", "fish", "powershell")
    what = f"that is to complete: {', '.join(shells)}"
    parser.add_argument("shell", choices=shells, metavar="SHELL", help=what)


_COMMANDS = {
    "demo": ("synthetic tests in vendor formats, processed and reported", _demo),
    "inspect": ("what an export holds: channels, rate, gaps, oddities", _inspect),
    "new": ("write test.yaml files: by what lies there, or from a table", _new),
    "check": ("protocols and tests against each other and the files", _check),
    "process": ("exports to result.h5, summary.json and figures", _process),
    "campaign": ("many tests: only what changed; states, queries, decisions", _campaign),
    "report": ("processed tests to one page, figures and a workbook", _report),
    "serve": ("a report in the browser that saves decisions on tests", _serve),
    "model": ("wire dimensions to stiffness tables and simulation decks", _model),
    "bundle": ("bounds of a harness bundle's bending stiffness", _bundle),
    "harness": ("a line between clips to its shape, forces and bend radii", _harness),
    "calibrate": ("cantilever tests to a calibrated wire model", _calibrate),
    "simulate": ("synthetic exports of a test, with known truth", _simulate),
    "examples": ("copy a wire sheet, a calibration plan, harnesses, the protocols", _examples),
    "completion": ("a script that lets Tab complete commands and options", _completion),
}
"""What each command is for, and its arguments."""
