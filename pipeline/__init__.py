"""Pipeline: case files, preparation, runs, output and the command line."""
