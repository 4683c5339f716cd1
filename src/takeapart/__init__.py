"""takeapart plans how a robot builds a product by planning how it takes the product apart."""

from takeapart._moved import serve_old_names

__version__ = "0.1.0"

serve_old_names()
