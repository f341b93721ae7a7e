"""One test put into a lab's folder, run by ``labpipe process``, and what came out of it."""

from __future__ import annotations

import contextlib
import io
import json
import re
import sys
import traceback
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatch
from pathlib import Path
from typing import Any, TextIO

from labpipe.cli import main
from tests.builders.reasons import codes, why
from tests.judges.plain.definitions import Plain


@dataclass(frozen=True)
class RunSummary:
    """Exit status, what was said on the terminal, and summary.json (empty if there is none)."""

    status: int
    out: str
    err: str
    summary: dict[str, Any] = field(default_factory=dict)

    @property
    def results(self) -> dict[str, dict[str, Any]]:
        return {result["name"]: result for result in self.summary.get("results", [])}

    @property
    def notes(self) -> list[dict[str, str]]:
        return list(self.summary.get("quality", []))


CRASHED = -1


def process(home: Path, sheet: str, files: dict[str, bytes]) -> RunSummary:
    """Write ``test.yaml`` and `files` beside it, and process; the test is called T."""
    folder = home / "raw" / "c" / "T"
    folder.mkdir(parents=True)
    (folder / "test.yaml").write_text(sheet, encoding="utf-8")
    for name, content in files.items():
        (folder / name).write_bytes(content)
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = _run(folder)
    summary = home / "processed" / "c" / "T" / "summary.json"
    said = json.loads(summary.read_text(encoding="utf-8")) if summary.is_file() else {}
    return RunSummary(status, out.getvalue(), err.getvalue(), said)


def _run(folder: Path) -> int:
    """As at a terminal: warnings are printed, and what nobody caught is a traceback."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = _show
        try:
            return int(main(["process", str(folder), "--no-figures"]))
        except SystemExit as end:
            return int(end.code or 0)
        except Exception:  # noqa: BLE001 - what the program let through is what is judged
            traceback.print_exc()
            return CRASHED


def _show(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    sys.stderr.write(f"{category.__name__}: {message} ({Path(filename).name}, line {lineno})\n")


NEAR = 3e-3
NAN = re.compile(r"\bnan\b|\binf\b", re.IGNORECASE)
NO_BREAK = "no_break|no_failure"
SIGN = re.compile("sign|negative|reversed|down|compress")
"""In the code of a note that says that a number is negative because of how the file counts."""
Numbers = Mapping[str, Plain | None]
"""Plain number by name of the result; None for one that this test cannot have."""


@dataclass(frozen=True)
class Expected:
    """What the numbers of one test are, and which of them may be refused, and why."""

    numbers: Numbers
    causes: Mapping[str, str] = field(default_factory=dict)
    """Pattern of a result to the codes (a regular expression) that name the true cause, if it may
    be doubtful, failed or missing. A number whose name no pattern fits must be `ok`."""
    refusal: str = ""
    """A regular expression that the message has if the whole test may be refused."""
    own: bool = True
    """Whether the numbers are those of the file's own samples, not of a faultless recording: then a
    doubtful number is the plain one, too."""
    sign_free: bool = False
    """Whether the file counts downwards: a number may then have either sign, if that is said."""


ABOUT_INTERVALS = {"no_width", "slow_noise", "value_outside", "wide_break"}
"""Doubts about how far a number may be off, not about the number: it is plain all the same."""


def complaints(ran: RunSummary, expected: Expected) -> list[str]:
    """Every breach of the rule, in a sentence with its numbers."""
    found = list(_terminal(ran))
    if not ran.summary:
        return [*found, *_refused(ran, expected)]
    found += _sentences(ran)
    found += _status(ran)
    for name, plain in expected.numbers.items():
        if name in ran.results:
            found += _judged(name, ran.results[name], plain, expected, ran)
        elif plain is not None and not any(fnmatch(name, cause) for cause in expected.causes):
            found.append(f"{name}: not in the summary, plainly {_shown(plain)}")
    found += [
        f"{name}: {result['value']:.6g} is ok, but there is no such number"
        for name, result in ran.results.items()
        if result["status"] == "ok" and _counted(name) and name not in expected.numbers
    ]
    return found


def _counted(name: str) -> bool:
    return name.startswith(("peak_force.", "peak_displacement.", "energy."))


def _terminal(ran: RunSummary) -> Iterator[str]:
    for stream in (ran.out, ran.err):
        yield from (
            f"terminal: {line.strip()[:200]}"
            for line in stream.splitlines()
            if NAN.search(line) or "Warning" in line or "Traceback" in line or "Error:" in line
        )
    if ran.status not in (0, 1, 2):
        yield f"exit status {ran.status}: {ran.err.strip().splitlines()[-1:]}"


def _refused(ran: RunSummary, expected: Expected) -> Iterator[str]:
    said = ran.err.strip()
    if ran.status != 2:
        yield f"no summary, but exit status {ran.status}"
    if not expected.refusal or not re.search(expected.refusal, said):
        yield f"refused: {said[:300]}"


def _sentences(ran: RunSummary) -> Iterator[str]:
    for name, result in ran.results.items():
        if NAN.search(why(result)) or NAN.search(result["method"]):
            yield f"{name}: no sentence: {why(result)} {result['method']}"
    for note in ran.notes:
        if NAN.search(note["message"]):
            yield f"note {note['code']}: no sentence: {note['message']}"


def _status(ran: RunSummary) -> Iterator[str]:
    failed = any(result["status"] == "failed" for result in ran.results.values())
    if ran.status in (0, 1) and ran.status != int(failed):
        yield f"exit status {ran.status}, with {'a' if failed else 'no'} failed result"


def _judged(
    name: str, result: dict[str, Any], plain: Plain | None, expected: Expected, ran: RunSummary
) -> Iterator[str]:
    if result["status"] == "ok" or (result["reasons"] and set(codes(result)) <= ABOUT_INTERVALS):
        yield from _value(name, result, plain, expected, ran)
        return
    causes = [codes for pattern, codes in expected.causes.items() if fnmatch(name, pattern)]
    cause = "|".join([*causes, *([NO_BREAK] if plain is None else [])])
    told = f"{name}: {result['status']}, {why(result)[:160]}"
    if not result["reasons"]:
        yield f"{told}: no reason"
    elif not cause:
        yield f"{told}: must be ok, plainly {_shown(plain)}"
    elif not re.search(cause, " ".join(codes(result))):
        yield f"{told}: not the cause ({cause})"
    if expected.own and result["status"] == "doubtful" and plain is not None:
        yield from _value(name, result, plain, expected, ran)


def _value(
    name: str, result: dict[str, Any], plain: Plain | None, expected: Expected, ran: RunSummary
) -> Iterator[str]:
    value = float(result["value"])
    if plain is None:
        yield f"{name}: {value:.6g} is ok, but there is no such number"
        return
    turned = expected.sign_free and value * (plain.low + plain.high) < 0
    near = max(abs(plain.low), abs(plain.high)) * NEAR
    given = -value if turned else value
    if not plain.low - near <= given <= plain.high + near:
        plainly = 0.5 * (plain.low + plain.high)
        off = f" ({100 * (given / plainly - 1):+.2f} %)" if plainly else ""
        yield f"{name}: {value:.6g} is {result['status']}, plainly {_shown(plain)}{off}"
    if expected.sign_free and value < 0 and not _sign_said(ran):
        yield f"{name}: {value:.6g} is negative, and no reason is given"


def _sign_said(ran: RunSummary) -> bool:
    return any(SIGN.search(note["code"]) for note in ran.notes)


def _shown(plain: Plain | None) -> str:
    if plain is None:
        return "none"
    if plain.low == plain.high:
        return f"{plain.low:.6g}"
    return f"{plain.low:.6g} to {plain.high:.6g}"
