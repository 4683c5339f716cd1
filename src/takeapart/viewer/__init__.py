"""The viewer in the browser. Needs the extra "view"."""

from takeapart.viewer.browser import Viewer

__all__ = [
    "Viewer",
]
