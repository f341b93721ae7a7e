"""Pictures of the real wires: measured points on the shapes of the model."""

from __future__ import annotations

from pathlib import Path

from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tests.builders.real_wires import photographed
from tests.real_wires.studied import Study

STYLE = Path(__file__).resolve().parents[2] / "labpipe" / "report" / "labpipe.mplstyle"
COLOURS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9")


def draw_hangs(studies: list[Study], path: Path) -> None:
    """Five loops of each wire with their models, and the distance left along the wire."""
    with style.context(STYLE):
        page = Figure(figsize=(6.3, 5.6), layout="constrained")
        panels = page.subplots(2, len(studies), height_ratios=[2.4, 1.0])
        for column, each in enumerate(studies):
            _loops(panels[0, column], each)
            _distances(panels[1, column], each)
        panels[0, 0].set_ylabel("Up (m)")
        panels[1, 0].set_ylabel("Model less photograph (mm)")
        page.savefig(path, dpi=110, metadata={"Software": None})


def _loops(axes: Axes, each: Study) -> None:
    for number, (hang, fit, colour) in enumerate(zip(each.hangs, each.fits, COLOURS, strict=True)):
        axes.plot(
            *hang.points[:, [0, 2]].T, ".", color=colour, markersize=3.0, label=f"Hang {number}"
        )
        axes.plot(*fit.model[:, [0, 2]].T, color=colour, linewidth=0.7)
    axes.set_aspect("equal")
    axes.set_title(f"{each.wire.name.capitalize()} wire: points of photographs, lines of the model")
    axes.set_xlabel("To the right (m)")
    axes.legend(loc="center")


def _distances(axes: Axes, each: Study) -> None:
    place = each.hangs[0].shares * each.hangs[0].length
    for fit, colour in zip(each.fits, COLOURS, strict=True):
        axes.plot(place, 1e3 * fit.distances, color=colour, linewidth=0.9)
    for fit, colour in zip(each.straight, COLOURS, strict=True):
        axes.plot(place, 1e3 * fit.distances, color=colour, linewidth=0.5, linestyle=":")
    axes.set_xlabel("Along the wire (m); dotted: straight when free")
    axes.set_ylim(bottom=0.0)


def draw_twist(each: Study, folder: Path, path: Path) -> None:
    """The twisted wire from the front: before, the last stable loop, after."""
    lax, crit = photographed(folder / "rods" / f"adapteddlo_{each.wire.name}_twist.csv")
    with style.context(STYLE):
        page = Figure(figsize=(6.3, 4.0), layout="constrained")
        front, side = page.subplots(1, 2)
        front.plot(*lax[::4].T, ".", color="0.6", markersize=3.0, label="photograph, not twisted")
        front.plot(*crit[::4].T, ".", color=COLOURS[1], markersize=3.0, label="photograph, snapped")
        front.plot(
            each.snapping[:, 0],
            each.snapping[:, 2],
            color=COLOURS[0],
            linewidth=0.9,
            label="last stable loop",
        )
        front.set_title("From the front")
        front.set_xlabel("To the right (m)")
        front.set_ylabel("Up (m)")
        page.legend(*front.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        side.plot(each.snapping[:, 1], each.snapping[:, 2], color=COLOURS[0], linewidth=0.9)
        side.set_title("Last stable loop from the side")
        side.set_xlabel("Out of the plane (m)")
        side.set_xlim(-0.15, 0.15)
        for axes in (front, side):
            axes.set_aspect("equal")
        page.savefig(path, dpi=150, metadata={"Software": None})
