"""Errors that a user can act on.

Every message names the bad value, where it stands, and what would be valid. A plan that does not exist is *not* an
error: it is a value, `takeapart.removal.planner.Blocked`, with a stage and a cause.
"""

from __future__ import annotations


class TakeapartError(Exception):
    """Base of all errors raised on purpose by this package; the command line turns it into one line and exit code 2."""


class InputError(TakeapartError):
    """A file or an argument is not what it must be.

    Args:
        message: what is wrong, and what would be valid.
        where: file name, or place inside a file (``single.json: parts[3].mass``); empty if there is none.
    """

    def __init__(self, message: str, where: str = "") -> None:
        self.message = message
        self.where = where
        super().__init__(f"{where}: {message}" if where else message)


class UnknownNameError(InputError):
    """A name that stands for nothing known; the message lists the names that would be valid."""

    def __init__(self, what: str, name: object, valid: list[str], where: str = "") -> None:
        self.valid = sorted(valid)
        super().__init__(f"unknown {what} {name!r}; valid: {', '.join(self.valid) or 'none'}", where)


class MissingExtraError(TakeapartError):
    """A command needs an optional dependency that is not installed."""

    def __init__(self, command: str, extra: str, missing: str) -> None:
        super().__init__(f"{command} needs the package {missing!r}; install it with: pip install 'takeapart[{extra}]'")
