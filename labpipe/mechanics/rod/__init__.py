"""The quasi-static, geometrically exact rod: a line between clips, grips and loads (PHYSICS 7)."""
