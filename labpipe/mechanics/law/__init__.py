"""Moment-curvature laws as data and functions, below wire and rod."""
