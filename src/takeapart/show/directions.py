"""Names of views. Loads nothing, so that the command line can list them."""

from __future__ import annotations

DIRECTIONS = {  # azimuth and elevation of the camera as seen from the target, degrees; front is x = 0
    "front": (180.0, 12.0),
    "back": (0.0, 12.0),
    "left": (90.0, 12.0),
    "right": (-90.0, 12.0),
    "above": (-90.0, 89.0),
    "corner": (-128.0, 24.0),
}
