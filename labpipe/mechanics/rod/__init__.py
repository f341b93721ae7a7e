"""Solve a quasi-static, geometrically exact rod under clips, grips and loads."""
