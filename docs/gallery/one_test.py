"""
One test, from its exports to numbers
=====================================

A wire is clamped at one end; a string pulls the other to the side and back. A load cell records
the force, cameras film markers on the wire. Here a virtual lab writes the exports, and labpipe
reads them.
"""

from pathlib import Path
from tempfile import mkdtemp

import labpipe
from labpipe.virtual_lab import ChosenTests, WireCampaign, simulate_campaigns

folder = Path(mkdtemp())
campaign = WireCampaign(cycles=2, fps=25.0)
simulate_campaigns([ChosenTests((campaign,), ("A2-085-1",))], folder)
sorted(path.name for path in (folder / "A2-085-1").iterdir())

# %%
# ``process`` reads the exports, joins their clocks, repairs markers and computes the results. It
# writes nothing; on the command line ``labpipe process`` does the same and keeps files.
test = labpipe.process(folder / "A2-085-1")
test.display.results[["value", "lower", "upper", "unit", "status"]]

# %%
# The shape of the wire at steps of deflection, with the fitted curves:
shapes = test.figure("wire-shapes")

# %%
# Force against displacement:
curve = test.figure("force-displacement")

# %%
# The virtual lab lost some markers on purpose. What was done about them:
test.quality[["code", "severity", "where"]]
