"""A plan in one file for the browser, which needs nothing else."""
