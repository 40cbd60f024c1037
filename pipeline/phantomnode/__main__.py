"""``python -m phantomnode`` is the same as the console script."""

from phantomnode.pipeline.cli import main

main()
