"""Picture of bands with the draws beside them: ``python -m tests.line_coverage.band_pictures``."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.rod.bands import bent
from labpipe.rod.response import Band
from tests.line_coverage.drawn_bands import Drawing, drawing
from tests.line_coverage.drawn_lines import KINDS, Numbers

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
STYLE = ROOT / "labpipe" / "report" / "labpipe.mplstyle"
SHOWN = 40
_KINDS = ("push", "bow")
_BLUE, _GREY = "#0072b2", "0.55"


def main(folder: Path = IMAGES) -> None:
    """Draw it."""
    made = {kind.name: drawing(kind, draws=SHOWN) for kind in KINDS if kind.name in _KINDS}
    with style.context(STYLE):
        draw(made).savefig(folder / "rod-bands.png", dpi=125, metadata={"Software": None})


def draw(made: dict[str, Drawing]) -> Figure:
    """A row for each line: held, on the way back, curvature along the line."""
    page = Figure(figsize=(7.2, 2.5 * len(made)), layout="constrained")
    grid = page.subplots(len(made), 3, squeeze=False)
    for row, (name, line) in zip(grid, made.items(), strict=True):
        held, back = line.states
        words = "without load" if name == "push" else "let go"
        _shape(row[0], held.positions, _places(line, line.held))
        row[0].set_title(f"{name}, {line.wire}: held")
        _shape(row[1], back.positions, _places(line, -1))
        row[1].set_title(f"{name}: {words}")
        _curvature(row[2], line)
        row[2].set_title(f"{name}: curvature, held")
    grid[0, 0].legend(loc="best", fontsize=7)
    return page


def _places(line: Drawing, step: int) -> Numbers:
    return np.array([path.states[step].positions for path in line.paths])


def _shape(axes: Axes, band: Band, drawn: Numbers) -> None:
    for number, each in enumerate(1e3 * drawn):
        label = "draws, each solved" if number == 0 else None
        axes.plot(each[:, 0], each[:, 2], color=_GREY, linewidth=0.4, label=label)
    value, low, high = (1e3 * each for each in (band.value, band.lower, band.upper))
    for x, z, left, down, right, up in zip(
        *(value[:, 0], value[:, 2], low[:, 0], low[:, 2], high[:, 0], high[:, 2]), strict=True
    ):
        axes.plot([left, right], [z, z], color=_BLUE, linewidth=0.9)
        axes.plot([x, x], [down, up], color=_BLUE, linewidth=0.9)
    axes.plot(value[:, 0], value[:, 2], color="black", linewidth=0.9, label="best values")
    axes.plot([], [], color=_BLUE, label="95 % band of a node")
    axes.set_aspect("equal")
    axes.set(xlabel="x (mm)", ylabel="z (mm)")


def _curvature(axes: Axes, line: Drawing) -> None:
    held = line.states[0]
    along = np.linspace(0.0, 1.0, len(held.curvature.value))
    for path in line.paths:
        most = np.linalg.norm(bent(path.states[line.held]), axis=-1).max(axis=-1)
        axes.plot(along, most, color=_GREY, linewidth=0.4)
    axes.fill_between(
        along, held.curvature.lower, held.curvature.upper, color=_BLUE, alpha=0.25, linewidth=0
    )
    axes.plot(along, held.curvature.value, color="black", linewidth=0.9)
    axes.set(xlabel="share of the length", ylabel="curvature (1/m)", ylim=(0.0, None))


if __name__ == "__main__":
    main()
