"""Protocols and test sheets: from YAML files to validated models with SI values."""
