"""Products that people know, drawn in code: what is shipped in ``data/products``. One module a product."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from takeapart.generate.products.cabinet import cabinet
from takeapart.generate.products.camera import camera
from takeapart.generate.products.drone import drone
from takeapart.generate.products.gearbox import gearbox
from takeapart.generate.products.planetary import planetary
from takeapart.generate.products.pump import pump
from takeapart.model.assembly import Assembly

PRODUCTS: Mapping[str, Callable[[], Assembly]] = {
    "cabinet": cabinet,
    "camera": camera,
    "drone": drone,
    "gearbox": gearbox,
    "planetary": planetary,
    "pump": pump,
}
