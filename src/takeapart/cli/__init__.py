"""The command line: one file per command; what they share is in `output`, the whole of it in `commands`."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from takeapart.cli.commands import main

__all__ = ["main"]


def __getattr__(name: str) -> object:
    """The entry point, which loads every command; a module with one command is had without the others."""
    if name == "main":
        from takeapart.cli.commands import main

        return main
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
