"""Tests of labpipe. A package, as another one called tests may be installed."""
