"""Solver: compiled kernels on NamedTuples of arrays; no file, no print, no global state."""
