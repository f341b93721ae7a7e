"""Compute the shape of a specimen from marker tracks: repair, frames, curves, rings."""
