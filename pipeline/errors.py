"""The one exception for a case that cannot be run."""

from __future__ import annotations

from collections.abc import Sequence


class CaseError(ValueError):
    """A case file, an override or an option is at fault.

    Attributes
    ----------
    messages : tuple of str
        Everything that was found, each naming the file, the key, what is wrong with it and what to do.
    """

    def __init__(self, messages: str | Sequence[str]) -> None:
        self.messages = (messages,) if isinstance(messages, str) else tuple(messages)
        super().__init__("\n".join(self.messages))


class OverlapError(CaseError):
    """The two sides of a contact pair are in each other at the start.

    Attributes
    ----------
    at : (float, float)
        Where they are deepest, m.
    """

    def __init__(self, message: str, at: tuple[float, float]) -> None:
        super().__init__(message)
        self.at = at
