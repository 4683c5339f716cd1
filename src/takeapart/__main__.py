"""``python -m takeapart`` is the same as ``takeapart``."""

from takeapart.cli import main

main()
