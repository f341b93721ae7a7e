"""Pictures of the decks with sliders: ``python -m tests.decks.slider_pictures`` draws them anew."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib import style
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from labpipe.decks.mujoco_sliders import mujoco_plane_deck
from labpipe.law.play_fits import concave_law
from labpipe.law.plays import PlayLaw
from labpipe.law.sliders import fit_sliders, slider_moment
from labpipe.records.arrays import Floats
from labpipe.wire.end_load_path import end_load_path
from tests.builders.wire_tables import loss_card
from tests.decks.test_mujoco_sliders import LENGTH, example
from tests.judges.rod_references import tips

ROOT = Path(__file__).resolve().parents[2]
IMAGES = ROOT / "docs" / "images"
STYLE = ROOT / "labpipe" / "report" / "labpipe.mplstyle"

WIRE = "C4"
"""Of 37 strands, with much friction."""
_SHOWN, _SEEN = 6, 1.5  # sliders that can be told apart by eye, and up to where, 1/m
_FIRST, _LAST = 0.1, 10.0  # 1/m, of a harness
_FARTHEST = 0.05


def main() -> None:
    """Draw both pictures."""
    with style.context(STYLE):
        for name, drawn in (("sliders", draw_law()), ("mujoco-loop", draw_loops())):
            drawn.savefig(IMAGES / f"{name}.png", dpi=150, metadata={"Software": None})


def draw_law() -> Figure:
    """The moment as a spring and sliders upon each other; what forms of law lose."""
    page = Figure(figsize=(6.3, 2.9), layout="constrained")
    left, right = page.subplots(1, 2)
    table = example(WIRE)
    law = fit_sliders(table.curvature, table.moment, _SHOWN, first=_FIRST, last=_LAST)
    bent = np.linspace(0.0, _SEEN, 400)
    parts = law.stiffnesses[:, None] * np.minimum(bent, law.slip_curvatures[:, None])
    floors = 1e3 * np.cumsum(np.vstack([law.stiffness * bent, parts[::-1]]), axis=0)
    below = np.zeros_like(bent)
    for number, floor in enumerate(floors):
        shade = 0.6 + 0.35 * number / len(parts)
        left.fill_between(bent, below, floor, color=str(shade), edgecolor="white", linewidth=0.5)
        below = floor
    left.plot(table.curvature, 1e3 * table.moment, color="#0072b2", label=f"law of {WIRE}")
    at = law.slip_curvatures[law.slip_curvatures <= _SEEN]
    left.plot(at, 1e3 * slider_moment(law, at), "o", color="black", markersize=3.0, label="slips")
    left.annotate("spring", (0.6 * _SEEN, 0.3 * floors[0, -1]))
    left.annotate("sliders", (0.6 * _SEEN, 0.45 * (floors[0, -1] + floors[-1, -1])))
    left.set(xlim=(0.0, _SEEN), ylim=(0.0, 1.15 * floors[-1, -1]))
    left.set(xlabel="Curvature (1/m)", ylabel="Moment (N·mm)")
    left.set_title(f"(a) A spring and {_SHOWN} sliders")
    left.legend(loc="upper left")
    _losses(right, table.curvature, table.moment)
    return page


def _losses(axes: Axes, curvature: Floats, moment: Floats) -> None:
    bent = np.geomspace(_FIRST, _LAST, 600)
    wanted = np.interp(bent, curvature, moment)
    card = loss_card(curvature, moment, first=_FIRST, last=_LAST)
    curve = card.dahl.stiffness * bent - card.dahl.moment * np.expm1(-bent / card.dahl.decay)
    forms = [("constant stiffness", card.stiffness * bent), ("Dahl", curve)]
    for number in (4, 12):
        law = fit_sliders(curvature, moment, number, first=_FIRST, last=_LAST)
        forms.append((f"{number} sliders", slider_moment(law, bent)))
    for (name, moment), colour in zip(
        forms, ("#b34700", "#cc79a7", "#009e73", "black"), strict=True
    ):
        axes.plot(bent, 100.0 * (moment / wanted - 1.0), label=name, color=colour)
    axes.set(xscale="log", xlabel="Curvature (1/m)", ylabel="Error of the moment (%)")
    axes.set_yscale("symlog", linthresh=1.0)
    axes.set_yticks([-100, -10, -1, 0, 1, 10, 100], ["-100", "-10", "-1", "0", "1", "10", "100"])
    axes.set_xticks([0.1, 1.0, 10.0], ["0.1", "1", "10"])
    axes.set_title("(b) What forms of law lose")
    axes.legend(loc="lower right")


def draw_loops() -> Figure:
    """Two cycles at the tip of 85 mm: labpipe's cantilever, and the deck in MuJoCo."""
    page = Figure(figsize=(6.3, 2.9), layout="constrained")
    for axes, name, letter in zip(page.subplots(1, 2), ("A2", "C4"), "ab", strict=True):
        table = example(name)
        law = concave_law(table.curvature[1:], table.moment[1:])
        up = np.linspace(5e-4, _FARTHEST, 60)
        first = end_load_path(law, LENGTH, up).load
        top = float(first[-1])
        loads = top * np.concatenate(
            [np.linspace(0.1, 1.0, 8), *2 * [np.linspace(0.85, 0.0, 6), np.linspace(0.2, 1.0, 5)]]
        )
        dots = tips(mujoco_plane_deck(table, length=LENGTH), loads)[:, 1]
        down = np.linspace(_FARTHEST, _rest(law, up), 80)[1:]
        way = np.concatenate([up, down, down[::-1][1:], [_FARTHEST]])
        path = end_load_path(law, LENGTH, way).load
        axes.plot(
            1e3 * np.append(0.0, way), 1e3 * np.append(0.0, path), color="#0072b2", label="labpipe"
        )
        axes.plot(1e3 * dots, 1e3 * loads, "o", color="#b34700", markersize=3.0, label="MuJoCo")
        axes.set(xlabel="Tip deflection (mm)", ylabel="End load (mN)", xlim=(0, 52), ylim=(0, None))
        axes.set_title(f"({letter}) {name}, two cycles")
    page.axes[0].legend(loc="upper left")
    return page


def _rest(law: PlayLaw, up: Floats) -> float:
    """Deflection that is left when the load is gone, m."""
    back = np.linspace(_FARTHEST - 1e-4, 5e-4, 200)
    load = end_load_path(law, LENGTH, np.concatenate([up, back])).load[len(up) :]
    at = int(np.argmax(load <= 0.0))
    return float(np.interp(0.0, load[at : at - 2 : -1], back[at : at - 2 : -1]))


if __name__ == "__main__":
    main()
