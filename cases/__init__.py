"""Bundled cases: data only, one folder an example."""
