"""The page of the real wires: docs/explanations/real-rods.md and its pictures."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np

from tests.judges.rod_fits import Estimate, HangFit, mean_of
from tests.real_wires.pictures import draw_hangs, draw_twist
from tests.real_wires.poses import PoseStudy, draw_poses, told
from tests.real_wires.studied import Study

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "explanations" / "real-rods.md"
IMAGES = ROOT / "docs" / "images"


def publish(studies: list[Study], poses: list[PoseStudy], folder: Path) -> None:
    """Put the tables between the marks of the page, and draw the pictures."""
    text = PAGE.read_text(encoding="utf-8")
    for name, table in (("counted", counted(studies)), ("poses", told(poses))):
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        before, after = text.partition(begin)[0], text.partition(end)[2]
        text = f"{before}{begin}\n{table}\n{end}{after}"
    PAGE.write_text(text, encoding="utf-8")
    draw_hangs(studies, IMAGES / "real-hangs.png")
    draw_twist(studies[0], folder, IMAGES / "real-twist.png")
    draw_poses(poses, IMAGES / "real-poses.png")


def counted(studies: list[Study]) -> str:
    """The tables."""
    head = "| | " + " | ".join(each.wire.name for each in studies) + " |"
    rows = [f"| {name} | " + " | ".join(map(said, studies)) + " |" for name, said in _ROWS]
    return "\n".join([head, "|---" * (1 + len(studies)) + "|", *rows])


def _each(values: Iterable[float], scale: float, digits: int) -> str:
    return ", ".join(f"{scale * each:.{digits}f}" for each in values)


def _with_width(found: Estimate, scale: float, digits: int) -> str:
    return f"**{scale * found.value:.{digits}f} ± {scale * found.half_width:.{digits}f}**"


def _parts(found: Estimate) -> str:
    parts = (f"{name} {100 * size / found.value:.1f} %" for name, size, _ in found.parts)
    return ", ".join(parts)


def _misfit(fits: list[HangFit]) -> str:
    means = _each([float(each.distances.mean()) for each in fits], 1e3, 1)
    return f"{means} (largest {1e3 * max(float(each.distances.max()) for each in fits):.0f})"


def _one(value: float, scale: float, digits: int) -> str:
    return f"{scale * value:.{digits}f}"


def _mean(fits: list[HangFit]) -> str:
    return _one(float(np.mean([each.stiffness for each in fits])), 1e6, 1)


def _turns(study: Study) -> str:
    return _with_width(mean_of(study.wire.snaps), 1, 0)


_ROWS: list[tuple[str, Callable[[Study], str]]] = [
    (
        "bending stiffness, hangs 0 to 4, N mm2",
        lambda s: _each([each.stiffness for each in s.fits], 1e6, 1),
    ),
    ("**mean, 95 % interval, N mm2**", lambda s: _with_width(s.stiffness, 1e6, 0)),
    ("standard uncertainties in it", lambda s: _parts(s.stiffness)),
    (
        "slope of the free curvature, hangs 0 to 4, 1/m",
        lambda s: _each([each.natural[0] for each in s.fits], 1, 1),
    ),
    ("**mean, 95 % interval, 1/m**", lambda s: _with_width(s.slope, 1, 1)),
    ("distance left, mean of each hang, mm", lambda s: _misfit(s.fits)),
    ("the same, straight when free, mm", lambda s: _misfit(s.straight)),
    ("correlation of neighbouring points", lambda s: _each([each.alike for each in s.fits], 1, 2)),
    ("turn at which the loop snaps over, degrees, measured", _turns),
    ("**torsional over bending stiffness, 95 % interval**", lambda s: _with_width(s.torsion, 1, 2)),
    ("standard uncertainties in it", lambda s: _parts(s.torsion)),
    ("the same, straight when free", lambda s: _with_width(s.torsion_straight, 1, 2)),
    (
        "elastica of our own: bending stiffness, hangs 0 to 4, N mm2",
        lambda s: _each([each.stiffness for each in s.by_elastica], 1e6, 1),
    ),
    ("mean stiffness, straight when free, N mm2", lambda s: _mean(s.straight)),
    ("the same, two terms of free curvature, held in its plane, N mm2", lambda s: _mean(s.more)),
    ("authors' rod: stiffness, hangs 0 to 4, N mm2", lambda s: _each(s.wire.authors, 1e6, 1)),
    ("authors, with MuJoCo's cable: mean stiffness, N mm2", lambda s: _one(s.wire.cable, 1e6, 1)),
    (
        "plain elastica of 60 pieces: stiffness, hangs 0 to 4, N mm2",
        lambda s: _each(s.wire.plain, 1e6, 0),
    ),
    (
        "authors: torsional over bending stiffness, their rod, MuJoCo's cable",
        lambda s: f"{s.wire.authors_torsion:.3f}, {s.wire.cable_torsion:.3f}",
    ),
]
