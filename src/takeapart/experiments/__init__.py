"""Experiments whose results stand in the documents; each module is a command that says so there."""
