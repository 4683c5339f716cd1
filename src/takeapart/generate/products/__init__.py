"""Products that people know, drawn in code: what is shipped in ``data/products``. One module a product."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from takeapart.generate.products.gearbox import gearbox
from takeapart.model.assembly import Assembly

PRODUCTS: Mapping[str, Callable[[], Assembly]] = {"gearbox": gearbox}
