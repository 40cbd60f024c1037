"""Geometry: curves from files, level sets, background grids, cutting and doubling."""
