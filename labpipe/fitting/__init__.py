"""labpipe.fitting."""
