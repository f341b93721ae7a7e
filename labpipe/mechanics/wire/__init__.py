"""Mechanics of the wire: moment-curvature laws, and the exact large-deflection cantilever."""
