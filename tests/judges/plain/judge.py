"""The rule: an `ok` number is the plain one within 0.3 %; every other one says the true cause.

`complaints` lists what breaks it. It knows names of results and the codes of reasons, and nothing
of how labpipe finds a number.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fnmatch import fnmatch
from typing import Any

from tests.builders.reasons import codes, why
from tests.judges.plain.bench import Ran
from tests.judges.plain.definitions import Plain

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


ABOUT_INTERVALS = {"no_width", "slow_noise", "uneven_noise", "value_outside", "wide_break"}
"""Doubts about how far a number may be off, not about the number: it is plain all the same."""


def complaints(ran: Ran, expected: Expected) -> list[str]:
    """Every breach of the rule, in a sentence with its numbers."""
    found = list(_terminal(ran))
    if not ran.summary:
        return [*found, *_refused(ran, expected)]
    found += _sentences(ran)
    found += _status(ran)
    for name, plain in expected.numbers.items():
        if name in ran.results:
            found += _judged(name, ran.results[name], plain, expected, ran)
        elif plain is not None and not any(fnmatch(name, each) for each in expected.causes):
            found.append(f"{name}: not in the summary, plainly {_shown(plain)}")
    found += [
        f"{name}: {each['value']:.6g} is ok, but there is no such number"
        for name, each in ran.results.items()
        if each["status"] == "ok" and _counted(name) and name not in expected.numbers
    ]
    return found


def _counted(name: str) -> bool:
    return name.startswith(("peak_force.", "peak_displacement.", "energy."))


def _terminal(ran: Ran) -> Iterator[str]:
    for stream in (ran.out, ran.err):
        yield from (
            f"terminal: {line.strip()[:200]}"
            for line in stream.splitlines()
            if NAN.search(line) or "Warning" in line or "Traceback" in line or "Error:" in line
        )
    if ran.status not in (0, 1, 2):
        yield f"exit status {ran.status}: {ran.err.strip().splitlines()[-1:]}"


def _refused(ran: Ran, expected: Expected) -> Iterator[str]:
    said = ran.err.strip()
    if ran.status != 2:
        yield f"no summary, but exit status {ran.status}"
    if not expected.refusal or not re.search(expected.refusal, said):
        yield f"refused: {said[:300]}"


def _sentences(ran: Ran) -> Iterator[str]:
    for name, each in ran.results.items():
        if NAN.search(why(each)) or NAN.search(each["method"]):
            yield f"{name}: no sentence: {why(each)} {each['method']}"
    for note in ran.notes:
        if NAN.search(note["message"]):
            yield f"note {note['code']}: no sentence: {note['message']}"


def _status(ran: Ran) -> Iterator[str]:
    failed = any(each["status"] == "failed" for each in ran.results.values())
    if ran.status in (0, 1) and ran.status != int(failed):
        yield f"exit status {ran.status}, with {'a' if failed else 'no'} failed result"


def _judged(
    name: str, result: dict[str, Any], plain: Plain | None, expected: Expected, ran: Ran
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
    name: str, result: dict[str, Any], plain: Plain | None, expected: Expected, ran: Ran
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


def _sign_said(ran: Ran) -> bool:
    return any(SIGN.search(note["code"]) for note in ran.notes)


def _shown(plain: Plain | None) -> str:
    if plain is None:
        return "none"
    if plain.low == plain.high:
        return f"{plain.low:.6g}"
    return f"{plain.low:.6g} to {plain.high:.6g}"
