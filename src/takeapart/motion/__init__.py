"""Paths between configurations: RRT-Connect, and the shortening of the tool path."""
