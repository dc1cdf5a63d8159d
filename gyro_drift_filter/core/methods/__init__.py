"""The filter methods, one module each."""
