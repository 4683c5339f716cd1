"""``python -m takeapart`` is the same as ``takeapart``."""

from takeapart.cli.commands import main

main()
