"""Decks with sliders, run in MuJoCo: loads are ramped, and given time to come to rest."""

from __future__ import annotations

import numpy as np

from labpipe.decks.mujoco_sliders import REST
from labpipe.records.arrays import Floats


def tips(
    deck: str,
    loads: Floats,
    towards: float | Floats = 0.0,
    *,
    ramp: int = 400,
    rest: int = REST,
) -> Floats:
    """Where the tip comes to rest under each load, shape (loads, 3).

    Parameters
    ----------
    deck : MJCF
    loads : N, one after the other
    towards : rad, direction of the loads from y to z; or of each load
    ramp, rest : steps in which a load grows, and in which it stands
    """
    import mujoco

    model = mujoco.MjModel.from_xml_string(deck)
    data = mujoco.MjData(model)
    angles = np.broadcast_to(towards, np.shape(loads))
    pulls = np.asarray(loads)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    places, before = [], np.zeros(model.nu)
    for pull in pulls[:, : model.nu]:
        for step in range(ramp + rest):
            data.ctrl[:] = before + min(1.0, (step + 1) / ramp) * (pull - before)
            mujoco.mj_step(model, data)
        before = pull
        places.append(np.array(data.sensor("tip").data))
    assert not any(warning.number for warning in data.warning)
    assert float(np.max(np.abs(data.qvel))) < 1e-3
    return np.array(places)
