"""Files that come with the package."""

from __future__ import annotations

from pathlib import Path

from takeapart.formats.messages import shown
from takeapart.model.errors import InputError


def data_path(relative: str) -> Path:
    """A file or folder that comes with the package, for example ``data_path("single/01.json")``.

    The data stand in ``takeapart/data`` where the package was installed, at the top of the repository in a checkout.

    Raises:
        InputError: nothing of this name is shipped.
    """
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "data", package.parents[1] / "data"):
        found = (folder / relative).resolve()
        if found.exists() and found.is_relative_to(folder):
            return found
    raise InputError(
        "no such file comes with takeapart; its data may be missing from the installation", shown(relative)
    )
