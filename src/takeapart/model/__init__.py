"""The data: shapes, assemblies, plans, and the checks that make them trustworthy."""
