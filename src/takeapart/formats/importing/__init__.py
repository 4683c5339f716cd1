"""Products from CAD: a STEP file, or meshes, become an assembly; nothing is repaired silently."""

from takeapart.formats.importing.pairs import DrawnPair
from takeapart.formats.importing.product import Floating, ImportedProduct, import_product

__all__ = ["DrawnPair", "Floating", "ImportedProduct", "import_product"]
