"""Bend a wire in MuJoCo and release it, with copper that hardens isotropically in part.

MuJoCo keeps the yield of a tendon constant. A callback raises that of the tendons ``growing_N`` by
the plastic displacement so far. Run ``python mujoco_growing.py MODEL.xml LOAD [LOAD ...]`` with the
text of `format_plane_deck(table, isotropic_share=0.675)` and loads at the tip in N.
"""

import sys
from pathlib import Path

import mujoco
import numpy as np


def harden(model, data):
    """Return a callback that raises the yields of the growing tendons of a model."""
    slid, limit = model.numeric("growing_slid").data, model.numeric("growing_yield").data
    names = [model.tendon(number).name for number in range(model.ntendon)]
    tendons = [n for n, name in enumerate(names) if name.startswith("growing_")]
    places = model.tendon_plasticadr[tendons]
    before, total = data.plastic[places].copy(), np.zeros(len(places))

    def raise_yields(model, data):
        total[:] += np.abs(data.plastic[places] - before)
        before[:] = data.plastic[places]
        model.tendon_springyield[tendons] = np.interp(total, slid, limit)

    return raise_yields


def bend(xml, loads, ramp=400, rest=600):
    """Return where the tip rests under each load, shape (loads, 3), m."""
    model = mujoco.MjModel.from_xml_string(xml)
    data = mujoco.MjData(model)
    mujoco.set_mjcb_control(harden(model, data))
    places, load = [], 0.0
    for wanted in loads:
        for step in range(ramp + rest):
            data.ctrl[0] = load + min(1.0, (step + 1) / ramp) * (wanted - load)
            mujoco.mj_step(model, data)
        load = wanted
        places.append(data.sensor("tip").data.copy())
    mujoco.set_mjcb_control(None)
    return np.array(places)


if __name__ == "__main__":
    tips = bend(Path(sys.argv[1]).read_text(encoding="utf-8"), list(map(float, sys.argv[2:])))
    sys.stdout.write(f"{tips}\n")
