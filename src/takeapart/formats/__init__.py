"""Files: read with limits and one line about what is wrong, written all or nothing, and known by their hashes."""
