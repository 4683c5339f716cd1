"""takeapart plans how a robot builds a product by planning how it takes the product apart."""

__version__ = "0.1.0"
