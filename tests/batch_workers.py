"""What workers of a batch do in tests; they import it by its name."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

from phantomnode.pipeline import one_case
from phantomnode.pipeline.one_case import DONE, Order, Outcome


def deadly(order: Order) -> Outcome:
    """Cases in a folder called bad kill their worker; others are done, later than a worker dies."""

    def attempt(order: Order, goes_on: bool) -> tuple[str, str, str]:
        if Path(order.folder).name == "bad":
            os.kill(os.getpid(), signal.SIGKILL)
        time.sleep(0.5)
        return DONE, "", ""

    one_case._attempt = attempt
    return one_case.run_order(order)
