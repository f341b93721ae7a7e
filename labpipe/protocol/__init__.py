"""Protocols and test sheets: YAML in, validated models with SI values out."""
