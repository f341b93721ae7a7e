"""Moment against curvature, measured from the shapes of a bending test."""
