"""The reduction of one test."""
